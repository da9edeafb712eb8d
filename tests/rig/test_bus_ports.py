"""What comes at the ports of a real flora-bus, or keeps it from having them, ends neither it nor the rig's own bus."""

from __future__ import annotations

import contextlib
import resource
import socket
import time
from typing import Any

import pytest
import zmq

from bus_over_tcp import Line, NetworkBus, ticks, until_heard
from flora_common.bus import BusAddress
from flora_common.messages import Health, Tick

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq was built without CURVE")


@pytest.fixture
def net(bus: Any) -> NetworkBus:
    return NetworkBus(bus)


def healths(heard: list[Any]) -> list[Health]:
    return [a.message for a in heard if isinstance(a.message, Health)]


def said_to(port: int, garbage: bytes) -> socket.socket:
    """A connection over which this was said, as ZeroMQ does it: the rest when the other side has greeted, if it has."""
    connection = socket.create_connection(("127.0.0.1", port), timeout=0.1)
    with contextlib.suppress(OSError):  # it has hung up already
        connection.sendall(garbage[:64])
        with contextlib.suppress(TimeoutError):
            connection.recv(64)
        connection.sendall(garbage[64:])
    return connection


def test_a_line_that_goes_dead_without_a_word_is_tried_anew(net: NetworkBus, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flora_common.bus_connection.HEARTBEAT_MS", 200)
    net.start()
    near = net.bus.client("flora-flash")
    with Line(net.ports[0]) as publish, Line(net.ports[1]) as subscribe:
        net.address = BusAddress(publish.endpoint, subscribe.endpoint)
        far = net.client(net.keys_of("lab"))
        net.bus.hear(far, lambda _: far.connected)
        publish.go_dead()
        subscribe.go_dead()
        near.publish(Tick(tick=1, time_s=0.0))
        net.bus.hear(far, lambda heard: 1 in ticks(heard))  # by a new line, on which the bus says what it has kept
        far.publish(Tick(tick=2, time_s=0.0))
        until_heard(net, near, far, 2)


GREETING = b"\xff" + b"\0" * 8 + b"\x7f"
WITHOUT_KEYS = (
    GREETING
    + (b"\x03\0NULL" + b"\0" * 48)
    + b"\x04\x19\x05READY\x0bSocket-Type\0\0\0\x03PUB"
    + b"\x01\x09test/tick\x01\x01\x80\x00\x010"
)
"""All that a publisher says to a bus that asks for nothing, and a message."""


@pytest.mark.parametrize(
    "garbage",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: rig\r\n\r\n",
        b"\x16\x03\x01" + b"\xff" * 4096,
        b"\0" * 100_000,
        b"\x01\0\x05\0\x01test",  # ZMTP 1.0: no greeting, no keys
        GREETING + b"\x01\x02\0\0" + b"\x05\0\x01test",  # ZMTP 2.0
        WITHOUT_KEYS,
        GREETING + b"\x03\0CURVE" + b"\0" * 47 + b"\x04\xc8\x05HELLO" + b"\xff" * 194,
        GREETING + b"\x03\0CURVE" + b"\0" * 47 + b"\x06" + b"\xff" * 8 + b"\x05HELLO",  # longer than any frame may be
    ],
)
def test_garbage_at_the_ports_ends_nothing(net: NetworkBus, garbage: bytes) -> None:
    process = net.start()
    near, far = net.bus.client("flora-flash"), net.client(net.keys_of("lab"))
    net.bus.hear(far, lambda _: far.connected)
    raw = [said_to(port, garbage) for port in net.ports * 10]
    near.publish(Tick(tick=1, time_s=0.0))
    net.bus.hear(far, lambda heard: 1 in ticks(heard))
    for connection in raw:
        connection.close()
    far.publish(Tick(tick=2, time_s=0.0))
    heard = net.bus.hear(near, lambda heard: 2 in ticks(heard))
    assert {a.message.source for a in heard} <= {"flora-flash", "far", "flora-bus"}
    assert process.poll() is None


def test_the_same_bytes_are_heard_where_the_bus_is_open(net: NetworkBus) -> None:
    del net.bus.sections["rig"]["bus_keys"]
    net.start()
    near = net.bus.client()
    net.bus.hear(near, lambda _: near.connected)
    with contextlib.ExitStack() as lines:
        next_s = 0.0

        def is_heard(heard: list[Any]) -> bool:
            """Said again now and then: on a busy machine a line may be cut before its greeting was answered."""
            nonlocal next_s
            if time.monotonic() > next_s:
                lines.enter_context(said_to(net.ports[0], WITHOUT_KEYS))
                next_s = time.monotonic() + 2.0
            return any(a.parts[:2] == [b"test/tick", b"\x80"] for a in heard)

        net.bus.hear(near, is_heard)


def test_an_address_that_is_not_this_machines_yet_does_not_hold_up_the_rigs_own_bus(net: NetworkBus) -> None:
    net.bus.sections["bus"]["network_subscribe"] = f"tcp://192.0.2.7:{net.ports[1]}"
    process = net.start()
    near = net.bus.client()
    told = net.bus.hear(near, lambda heard: any("192.0.2.7" in h.reason for h in healths(heard)))
    assert {h.state for h in healths(told)} <= {"starting", "degraded"}
    assert process.poll() is None
    socket.create_server(("127.0.0.1", net.ports[0])).close()  # both or none: the other end is not listened at either


def test_the_network_is_opened_as_soon_as_it_can_be(net: NetworkBus) -> None:
    taken = socket.create_server(("127.0.0.1", net.ports[0]))
    net.start()
    near, far = net.bus.client(), net.client(net.keys_of("lab"))
    net.bus.hear(near, lambda heard: any("cannot listen" in h.reason for h in healths(heard)))
    taken.close()
    net.bus.hear(far, lambda _: far.connected)
    net.bus.hear(near, lambda heard: any(h.state == "ready" for h in healths(heard)))


def test_strangers_who_open_connections_by_the_hundred_cannot_end_the_rigs_own_bus(net: NetworkBus) -> None:
    process = net.start()
    near = net.bus.client("flora-flash")
    net.bus.hear(near, lambda _: near.connected)
    resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (200, 200))
    idle = []
    for number in range(300):
        idle.append(socket.socket())
        idle[-1].setblocking(False)
        idle[-1].connect_ex(("127.0.0.1", net.ports[number % 2]))
        time.sleep(0.02)
    net.bus.hear(near, lambda heard: any("too many connections" in h.reason for h in healths(heard)))
    late = net.bus.client("flora-led")
    net.bus.hear(late, lambda _: late.connected)
    for each in idle:
        each.close()
    far = net.client(net.keys_of("lab"))
    net.bus.hear(far, lambda _: far.connected)
    assert process.poll() is None


def test_who_does_not_say_who_it_is_is_hung_up_on(net: NetworkBus) -> None:
    net.start()
    near = net.bus.client()
    net.bus.hear(near, lambda _: near.connected)
    with socket.create_connection(("127.0.0.1", net.ports[0]), timeout=20.0) as silent:
        began_s = time.monotonic()
        while silent.recv(1000):
            pass
        assert time.monotonic() - began_s < 15.0
