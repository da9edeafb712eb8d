"""A real flora-bus over TCP with keys: who is heard, who is not, who is told why, and what is refused."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zmq

from bus_over_tcp import NetworkBus, ticks, until_heard
from flora_common.bus import BusClient
from flora_common.bus_keys import CLIENT, ClientKeys, KeyPair, client_keys, make_pair
from flora_common.messages import Health, Tick

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq was built without CURVE")


BROKEN_OFF = "breaks off: its key is not that of bus.pub here, or it has none, or it is no flora-bus"


@pytest.fixture
def net(bus: Any) -> NetworkBus:
    return NetworkBus(bus)


def until_refused(client: BusClient, *told: str, within_s: float = 20.0) -> None:
    """Poll as a loop does until the client says so why it is not let in: by one of these, where it depends on who of
    both sides is faster whether it reads what the other wants, or finds the line broken off."""
    end_s = time.monotonic() + within_s
    while not any(one in client.refusal for one in told):
        assert time.monotonic() < end_s, f"not told why: {client.refusal!r}"
        time.sleep(0.02)
        client.handle_publisher()


def drained(client: BusClient, seconds: float) -> list[Any]:
    heard = []
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        client.handle_publisher()
        heard += client.receive_all()
        time.sleep(0.02)
    return heard


def test_a_known_machine_hears_and_is_heard_and_the_rig_needs_no_keys(net: NetworkBus) -> None:
    net.start()
    near, far = net.bus.client("flora-flash"), net.client(net.keys_of("lab"))
    net.bus.hear(far, lambda _: far.connected)
    near.publish(Tick(tick=1, time_s=0.0))
    assert ticks(net.bus.hear(far, lambda heard: 1 in ticks(heard))) == [1]
    far.publish(Tick(tick=2, time_s=0.0))
    net.bus.hear(near, lambda heard: 2 in ticks(heard))
    late = net.client(client_keys(net.bus.folder / "lab-keys"), "late")
    net.bus.hear(late, lambda heard: 1 in ticks(heard) or 2 in ticks(heard))  # what the bus keeps
    assert far.refusal == ""


def no_keys(net: NetworkBus) -> ClientKeys | None:
    net.keys_of("lab")
    return None


def wrong_bus_key(net: NetworkBus) -> ClientKeys:
    own = client_keys(net.keys_of("lab")).own
    return ClientKeys(own, own.public)


def unknown_key(net: NetworkBus) -> ClientKeys:
    return client_keys(net.keys_of("lab", is_known=False))


def stolen_public_key(net: NetworkBus) -> ClientKeys:
    """Who knows the public half of a known machine is not that machine."""
    known, own = client_keys(net.keys_of("lab")), client_keys(net.keys_of("thief", is_known=False)).own
    return ClientKeys(KeyPair(known.own.public, own.secret), known.bus)


@pytest.mark.parametrize(
    ("shown", "told"),
    [
        (
            no_keys,
            (
                "speaks otherwise: it has keys, and [rig] bus_keys is not set here",
                "breaks off: it has keys, and [rig] bus_keys is not set here, or it is no flora-bus",
            ),
        ),
        (wrong_bus_key, (BROKEN_OFF,)),
        (unknown_key, ("does not know this machine: put its client.pub into authorized/ there",)),
        (stolen_public_key, (BROKEN_OFF,)),
    ],
)
def test_a_stranger_hears_nothing_says_nothing_and_is_told_why(
    net: NetworkBus, shown: Callable[[NetworkBus], ClientKeys | None], told: tuple[str, ...]
) -> None:
    keys = shown(net)
    process = net.start()
    near = net.bus.client("flora-flash")
    stranger = net.client(keys, "stranger")
    stranger.publish(Tick(tick=666, time_s=0.0))
    until_refused(stranger, *told)
    near.publish(Tick(tick=1, time_s=0.0))
    net.bus.hear(near, lambda heard: 1 in ticks(heard))
    assert drained(stranger, 1.0) == []
    assert not stranger.connected
    assert 666 not in ticks(drained(near, 0.3))
    status, _, err = net.bus.stop(process)
    assert status == 0, err


def test_a_machine_that_is_admitted_later_gets_in_without_a_restart_of_anything(net: NetworkBus) -> None:
    process = net.start()
    keys = net.keys_of("lab", is_known=False)
    far = net.client(keys)
    until_refused(far, "does not know this machine")
    net.admit("lab", keys / "client.pub")
    net.bus.hear(far, lambda _: far.connected)
    assert far.refusal == ""
    (net.authorized / "lab.pub").write_text("no key any more")  # those hold that were there before, and it is told
    again = net.client(keys, "again")
    net.bus.hear(again, lambda _: again.connected)
    near = net.bus.client()
    told = "lab.pub: not a public key"
    net.bus.hear(near, lambda heard: any(told in a.message.reason for a in heard if isinstance(a.message, Health)))
    assert process.poll() is None


def test_all_find_the_bus_again_after_it_was_killed(net: NetworkBus) -> None:
    process = net.start()
    near, far = net.bus.client("flora-flash"), net.client(net.keys_of("lab"))
    net.bus.hear(far, lambda _: far.connected)
    process.send_signal(signal.SIGKILL)
    process.wait()
    far.publish(Tick(tick=7, time_s=0.0))
    net.start()
    until_heard(net, near, far, 7)
    near.publish(Tick(tick=8, time_s=0.0))
    until_heard(net, far, near, 8)
    assert far.refusal == ""


def test_services_too_may_be_on_tcp_with_keys(net: NetworkBus) -> None:
    """The whole rig by one pair of ports: the bus is its own first customer, and needs to be known as well."""
    _, public = make_pair(net.folder, CLIENT)
    rig = net.bus.sections["rig"]
    rig |= {"bus_publish": net.address.publish, "bus_subscribe": net.address.subscribe, "health_every_s": 0.1}
    del net.bus.sections["bus"]
    process = net.start()
    time.sleep(1.0)
    assert process.poll() is None
    net.admit("this", public)
    net.bus.start_service("flora-recorder")
    far = net.client(net.folder)
    net.bus.hear(far, lambda _: far.connected)
    net.bus.wait_ready(far, "flora-bus", "flora-recorder")


def test_the_monitor_of_another_machine_hears_or_says_why_not(net: NetworkBus) -> None:
    net.start()
    near = net.bus.client("flora-flash")
    near.publish(Tick(tick=3, time_s=0.0))
    keys = net.keys_of("lab", is_known=False)

    tail = net.bus.start("flora-monitor", "tail", "tick", "--count", "1", "--config", str(net.config_of(keys)))
    assert tail.stderr.readline() == (
        f"flora-monitor: the bus at {net.address.publish} does not know this machine: "
        "put its client.pub into authorized/ there\n"
    )
    net.admit("lab", keys / "client.pub")
    out, _ = tail.communicate(timeout=20)
    assert json.loads(out)["tick"] == 3

    health = net.bus.start("flora-monitor", "health", "flora-bus", "--config", str(net.config_of(None)))
    _, err = health.communicate(timeout=20)
    assert health.returncode == 1
    assert "it has keys, and [rig] bus_keys is not set here" in err  # told by it, or guessed when it hung up at once


def test_a_service_of_another_machine_says_why_it_is_not_let_in(net: NetworkBus) -> None:
    net.start()
    net.bus.client()
    keys = net.keys_of("lab", is_known=False)
    recorder = net.bus.start("flora-recorder", "--config", str(net.config_of(keys)))
    for line in recorder.stderr:
        if "does not know this machine" in line:
            break
    net.admit("lab", keys / "client.pub")
    near = net.bus.client("flora-flash")
    net.bus.wait_ready(near, "flora-recorder")


def test_unknown_keys_are_told_in_the_log_of_the_bus(net: NetworkBus) -> None:
    process = net.start()
    keys = net.keys_of("lab", is_known=False)
    until_refused(net.client(keys), "does not know this machine")
    key = next(line.split('"')[1] for line in (keys / "client.pub").read_text().splitlines() if "public-key" in line)
    for line in process.stderr:  # every five seconds at most
        if "unknown_key" in line:
            assert key in line
            assert "127.0.0.1" in line
            return
    raise AssertionError("the log says nothing")


@pytest.mark.parametrize(
    ("rig", "own", "said"),
    [
        ({"bus_publish": "tcp://*:5571"}, {}, "bus_publish is tcp://*:5571, which other machines reach"),
        ({"bus_keys": ""}, {"network_publish": "tcp://*:5571"}, "give both, with ports of their own, or neither"),
        (
            {"bus_keys": ""},
            {"network_publish": "tcp://*:5571", "network_subscribe": "tcp://*:5571"},
            "give both, with ports of their own, or neither",
        ),
        (
            {"bus_keys": ""},
            {"network_publish": "tcp://*:5571", "network_subscribe": "tcp://*:5572"},
            "[bus] network_publish is tcp://*:5571, which other machines reach",
        ),
        ({"bus_open": True}, {}, "bus_keys and bus_open contradict each other"),
        ({}, {"network_publish": "ipc:///tmp/x"}, "`network_publish`"),
        ({"bus_keys": "/nowhere/keys"}, None, "/nowhere/keys/bus.key: is not there; `flora-bus --make-bus-keys`"),
    ],
)
def test_what_would_be_open_or_half_is_refused(
    net: NetworkBus, rig: dict[str, Any], own: dict[str, Any] | None, said: str
) -> None:
    if "bus_publish" in rig:
        del net.bus.sections["rig"]["bus_keys"]
    net.bus.sections["rig"] |= rig
    if own is not None:
        net.bus.sections["bus"] = own
    process = net.start()
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err.count("\n")) == (2, 1), err
    assert said in err


def test_a_secret_that_others_can_read_is_refused_by_the_bus_and_by_who_comes(net: NetworkBus) -> None:
    keys = net.keys_of("lab")
    (keys / "client.key").chmod(0o644)
    tail = net.bus.start("flora-monitor", "tail", "--config", str(net.config_of(keys)))
    _, err = tail.communicate(timeout=20)
    assert (tail.returncode, err) == (
        2,
        f"flora-monitor: {keys}/client.key: others than its owner can use this key; chmod 600 {keys}/client.key\n",
    )
    (net.folder / "bus.key").chmod(0o640)
    process = net.start()
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err.count("\n")) == (2, 1)
    assert "others than its owner can use this key" in err


def test_an_open_bus_is_open_where_that_is_said(net: NetworkBus) -> None:
    del net.bus.sections["rig"]["bus_keys"]
    net.bus.sections["rig"]["bus_open"] = True
    net.bus.sections["bus"]["network_publish"] = f"tcp://*:{net.ports[0]}"
    net.start()
    far = net.client(None)
    net.bus.hear(far, lambda _: far.connected)


def test_keys_for_a_bus_that_has_none_are_told(net: NetworkBus) -> None:
    keys = net.keys_of("lab")
    del net.bus.sections["rig"]["bus_keys"]
    net.start()
    far = net.client(keys)
    until_refused(far, "speaks otherwise: it has no keys, and [rig] bus_keys is set here", BROKEN_OFF)


def test_keys_are_made_where_the_configuration_looks_for_them(bus: Any) -> None:
    folder: Path = bus.folder / "keys"
    bus.sections["rig"]["bus_keys"] = str(folder)
    for flag, said in (("--make-bus-keys", "bus.key is the bus's"), ("--make-client-keys", "is this machine's")):
        process = bus.start_service("flora-bus", flag)
        out, err = process.communicate(timeout=20)
        assert (process.returncode, err) == (0, "")
        assert said in out
        again = bus.start_service("flora-bus", flag)
        _, err = again.communicate(timeout=20)
        assert (again.returncode, err.count("\n")) == (2, 1)
        assert "is there already and is not replaced" in err
    assert sorted(path.name for path in folder.iterdir()) == [
        "authorized",
        "bus.key",
        "bus.pub",
        "client.key",
        "client.pub",
    ]
    del bus.sections["rig"]["bus_keys"]
    nowhere = bus.start_service("flora-bus", "--make-client-keys")
    _, err = nowhere.communicate(timeout=20)
    assert nowhere.returncode == 2
    assert "[rig] bus_keys is not set" in err
