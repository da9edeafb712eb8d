"""Sequence numbers, freshness and the client itself, with no broker process."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from fake_clock import FakeClock
from flora_bus.broker import MAX_KEPT, MAX_KEPT_BYTES, Broker, LastValues, well_formed
from flora_common import bus as bus_module
from flora_common.bus import OUTBOX_LIMIT, Arrival, BusAddress, BusClient, Freshness, SequenceCheck, late_after_s
from flora_common.clock import NS
from flora_common.errors import BadMessage
from flora_common.messages import DiagnosisFound, Health, LightCommand, Stem, Tick, encode


def tick(seq: int, session: str = "00000001", source: str = "flora-flash") -> Tick:
    return Tick(time_s=0.0, seq=seq, session=session, source=source)


def test_gaps_and_repeats_are_found() -> None:
    check = SequenceCheck()
    found = [check.check("box1", "tick", tick(seq)) for seq in (5, 6, 9, 9, 7, 10)]
    assert found == [0, 0, 2, -1, -1, 0]


def test_a_restart_of_the_source_is_no_gap() -> None:
    check = SequenceCheck()
    assert check.check("box1", "tick", tick(100)) == 0
    assert check.check("box1", "tick", tick(1, session="00000002")) == 0
    assert check.check("box1", "tick", tick(3, session="00000002")) == 1


def test_rigs_topics_and_sources_are_counted_apart() -> None:
    check = SequenceCheck()
    for key in (("a", "tick", "x"), ("b", "tick", "x"), ("a", "health", "x"), ("a", "tick", "y")):
        assert check.check(key[0], key[1], tick(7, source=key[2])) == 0


def test_a_flood_of_sources_takes_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_module, "MAX_STREAMS", 10)
    check = SequenceCheck()
    for number in range(1000):
        check.check("box1", "tick", tick(1, source=f"s{number}"))
    assert len(check._last) == 10


def test_freshness_comes_from_the_catalogues_period() -> None:
    clock = FakeClock()
    inbox = Freshness(clock, tick_s=300.0)
    assert not inbox.fresh(Stem)
    assert inbox.last(Stem) is None
    assert inbox.age_s(Stem) is None
    stem = Stem(time_s=0.0, outcome="ok")
    inbox.hear("stem", stem)
    inbox.hear("health", Health(state="ready"))
    clock.advance(25.0)
    assert inbox.fresh(Health)
    clock.advance(0.1)
    assert not inbox.fresh(Health)
    clock.advance(750.0 - 25.1)
    assert inbox.fresh(Stem)
    clock.advance(0.1)
    assert not inbox.fresh(Stem)
    assert inbox.last(Stem) is stem
    assert inbox.age_s(Stem) == pytest.approx(750.1)


def test_what_the_bus_has_kept_since_yesterday_is_not_fresh() -> None:
    clock = FakeClock(mono_ns=90_000 * NS)
    inbox = Freshness(clock, tick_s=300.0)
    inbox.hear("stem", Stem(time_s=0.0, outcome="ok", t_mono_ns=3_600 * NS))
    assert inbox.age_s(Stem) == pytest.approx(86_400.0)
    assert not inbox.fresh(Stem)
    inbox.hear("stem", Stem(time_s=0.0, outcome="ok", t_mono_ns=99_999 * NS))  # from the future: heard just now
    assert inbox.age_s(Stem) == 0.0


def test_topics_without_a_period_are_never_late() -> None:
    assert late_after_s("none", 300.0) is None
    assert late_after_s("tick", 100.0) == 250.0
    assert late_after_s("10 s", 100.0) == 25.0


class Wire:
    """A broker and clients in one process, moved on by hand."""

    def __init__(self, name: str, transport: str = "inproc://") -> None:
        self.address = BusAddress(f"{transport}{name}-pub", f"{transport}{name}-sub")
        self.broker: Broker | None = Broker(self.address)
        self.clients: list[BusClient] = []

    def client(self, source: str, *types: type) -> BusClient:
        client = BusClient(self.address, rig="box1", source=source, clock=FakeClock(5, 10**18))
        client.subscribe(*types)
        client.connect()
        self.clients.append(client)
        return client

    def turn(self, client: BusClient) -> list[object]:
        """Everything that is on its way to one client."""
        heard: list[object] = []
        quiet = 0
        while quiet < 3:
            client.handle_publisher()
            if self.broker is not None:
                self.broker.pass_on()
                self.broker.serve_subscriptions()
            got = client.receive_all()
            heard += got
            quiet = 0 if got or client.subscriber.poll(5) else quiet + 1
        return heard

    def close(self) -> None:
        for client in self.clients:
            client.close()
        if self.broker is not None:
            self.broker.close()


@pytest.fixture
def wire(request: pytest.FixtureRequest) -> Iterator[Wire]:
    made = Wire(request.node.name)
    yield made
    made.close()


def test_a_bus_that_has_gone_is_noticed_and_one_that_has_come_back(tmp_path: Path) -> None:
    """ZeroMQ goes on as if it were there, and keeps what is said for it."""
    wire = Wire("bus", f"ipc://{tmp_path}/")
    client = wire.client("flora-flash", Tick)
    assert not client.is_far

    def until(connected: bool) -> None:
        give_up_s = time.monotonic() + 10.0
        while client.connected is not connected:
            assert time.monotonic() < give_up_s
            wire.turn(client)

    try:
        for _ in range(2):
            until(True)
            assert wire.broker is not None
            wire.broker.close()
            wire.broker = None
            until(False)
            wire.broker = Broker(wire.address)
        until(True)
        client.publish(Tick(tick=7, time_s=1.0))
        heard: list[object] = []
        give_up_s = time.monotonic() + 10.0
        while not heard and time.monotonic() < give_up_s:
            # A new bus that is asked and told at once may say it twice: the second is known as a repeat.
            heard += [a.message for a in wire.turn(client) if isinstance(a, Arrival) and a.verdict == "good"]
        assert [message.tick for message in heard if isinstance(message, Tick)] == [7]
        client.close()
        client.close()
        assert not client.connected
    finally:
        wire.close()


@pytest.mark.parametrize("is_folder", [True, False])
def test_sockets_that_this_user_may_not_open_are_not_taken_for_no_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_folder: bool
) -> None:
    really = os.stat

    def refusing(path: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if is_folder and tmp_path in Path(path).parents:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return really(path, *arguments, **options)

    address = BusAddress(f"ipc://{tmp_path}/publish", f"ipc://{tmp_path}/subscribe")
    client = BusClient(address, rig="test", source="flora-monitor", clock=FakeClock())
    try:
        assert client.hindrance == ""  # nobody is there
        for name in ("publish", "subscribe"):
            (tmp_path / name).touch()
        monkeypatch.setattr(os, "stat", refusing)
        monkeypatch.setattr(os, "access", lambda path, mode: False)
        assert client.hindrance.startswith(f"ipc://{tmp_path}/publish may not be opened by this user: use sudo, or")
    finally:
        client.close()


def test_what_is_said_while_a_subscription_is_on_its_way_is_heard_once(wire: Wire) -> None:
    """The bus passes it on and then, asked for what it has kept, says it again."""
    a = wire.client("flora-flash")
    wire.turn(a)
    b = wire.client("b", Tick)
    a.publish(Tick(tick=7, time_s=1.0))
    assert wire.broker is not None
    wire.broker.pass_on()
    wire.broker.serve_subscriptions()
    arrivals = [heard for heard in wire.turn(b) if isinstance(heard, Arrival)]
    assert [arrival.verdict for arrival in arrivals] == ["good", "repeated"]
    assert b.counters.received == b.counters.duplicates == 1


def test_connected_only_when_the_bus_has_answered(wire: Wire) -> None:
    client = wire.client("a", Tick)
    assert not client.connected
    wire.turn(client)
    assert client.connected


def test_what_is_published_arrives_with_the_envelope_filled_in(wire: Wire) -> None:
    a, b = wire.client("flora-flash"), wire.client("b", Tick)
    wire.turn(a)
    wire.turn(b)
    a.publish(Tick(time_s=1.0, tick=3))
    a.publish(Tick(time_s=2.0, tick=4))
    first, second = wire.turn(b)
    message = first.message  # type: ignore[attr-defined]
    assert (message.source, message.session, message.seq, message.schema) == ("flora-flash", a.session, 1, 1)
    assert (message.t_mono_ns, message.t_utc_ns, message.tick) == (5, 10**18, 3)
    assert second.message.seq == 2  # type: ignore[attr-defined]
    assert (b.counters.received, a.counters.sent) == (2, 2)


def test_the_lab_tells_no_rigs_time(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    """It says things of a rig, and runs on another machine, or beside a virtual one whose time is another."""
    seen: list[int] = []
    hearer = wire.client("flora-led", Tick, DiagnosisFound)
    monkeypatch.setattr(hearer._clock, "observe", lambda mono_ns, _: seen.append(mono_ns))
    speakers = {name: wire.client(name) for name in ("flora-lab", "flora-flash")}
    for client in (*speakers.values(), hearer):
        wire.turn(client)
    speakers["flora-lab"].publish(DiagnosisFound(run="bean", verdict="nothing_wrong"))
    speakers["flora-flash"].publish(Tick(tick=1, time_s=0.0))
    assert len(wire.turn(hearer)) == 2
    assert len(seen) == 1


def test_late_joiner_is_handed_the_last_value_and_others_know_the_repeat(wire: Wire) -> None:
    a, early = wire.client("flora-flash"), wire.client("early", Tick)
    wire.turn(a)
    wire.turn(early)
    for number in (1, 2, 3):
        a.publish(Tick(time_s=1.0, tick=number))
    assert len(wire.turn(early)) == 3
    late = wire.client("late", Tick)
    (kept,) = wire.turn(late)
    assert kept.message.tick == 3  # type: ignore[attr-defined]
    (repeat,) = wire.turn(early)
    assert repeat.verdict == "repeated"  # type: ignore[attr-defined]
    assert early.counters.duplicates == 1


def test_what_is_said_before_there_is_a_bus_is_not_lost(wire: Wire) -> None:
    a = wire.client("flora-flash")
    for number in (1, 2, 3):
        a.publish(Tick(time_s=1.0, tick=number))
    b = wire.client("b", Tick)
    heard = wire.turn(b)
    wire.turn(a)
    heard += wire.turn(b)
    assert [h.message.tick for h in heard] == [1, 2, 3]  # type: ignore[attr-defined]


def test_a_full_outbox_drops_the_oldest_and_counts() -> None:
    client = BusClient(BusAddress("inproc://nobody-a", "inproc://nobody-b"), rig="box1", source="a", clock=FakeClock())
    for _ in range(OUTBOX_LIMIT + 7):
        client.publish(Tick(time_s=0.0))
    assert client.counters.dropped == 7
    client.close()


def test_a_message_that_others_would_refuse_does_not_travel(wire: Wire) -> None:
    a = wire.client("flora-led")
    with pytest.raises(BadMessage, match="light"):
        a.publish(LightCommand(light="left", output=float("nan")))
    assert a.counters.sent == 0
    a.publish(LightCommand(light="left"))
    assert a._out.seq["light"] == 1  # no hole in the numbers


def test_verdicts_of_what_cannot_be_read(wire: Wire) -> None:
    client = wire.client("a", Tick)
    client.subscriber.setsockopt(zmq.SUBSCRIBE, b"")
    wire.turn(client)
    for parts in ([b"box1/tick", b"\xc1", b"0"], [b"box1/nosuch", b"\x80", b"0"]):
        client.publisher.send_multipart(parts)
    bad, unknown = wire.turn(client)
    assert (bad.verdict, unknown.verdict) == ("bad", "unknown")  # type: ignore[attr-defined]
    assert "; known: controller, " in unknown.reason  # type: ignore[attr-defined]
    assert (client.counters.bad, client.counters.unknown, client.counters.received) == (1, 1, 0)


def test_somebody_elses_hello_is_no_message(wire: Wire) -> None:
    everything = wire.client("monitor")
    everything.subscriber.setsockopt(zmq.SUBSCRIBE, b"")
    wire.turn(everything)
    other = wire.client("other")
    wire.turn(other)
    assert wire.turn(everything) == []
    assert everything.counters.bad == everything.counters.unknown == 0


def parts_of(kind: str, rig: str = "box1", *, source: str = "flora-led", size: int = 0) -> list[bytes]:
    message = Health(state="ready", source=source) if kind == "health" else Tick(time_s=0.0, source=source)
    topic, payload, seconds = encode(rig, message)
    if size:
        payload = msgspec.msgpack.encode(msgspec.msgpack.decode(payload) | {"more": "x" * size})
    return [topic, payload, seconds]


def test_last_values_are_kept_per_topic_and_health_per_source() -> None:
    values = LastValues()
    values.keep(parts_of("tick", source="one"))
    values.keep(parts_of("tick", source="two"))
    values.keep(parts_of("health", source="one"))
    values.keep(parts_of("health", source="two"))
    values.keep([b"box1/nosuch", b"\x80", b"0"])
    values.keep([b"box1/health", b"\xc1", b"0"])
    assert len(values.matching(b"")) == 3
    assert len(values.matching(b"box1/h")) == 2
    assert values.matching(b"box2/") == []


def test_last_values_are_bounded_in_number_and_bytes_and_the_oldest_goes() -> None:
    values = LastValues()
    for number in range(MAX_KEPT + 100):
        values.keep(parts_of("tick", rig=f"r{number}"))
    assert len(values.matching(b"")) == MAX_KEPT
    assert values.matching(b"r0/") == []
    assert len(values.matching(f"r{MAX_KEPT + 99}/".encode())) == 1
    for number in range(MAX_KEPT_BYTES // 30_000 + 50):
        values.keep(parts_of("health", source=f"s{number}", size=30_000))
    assert sum(len(parts[1]) for parts in values.matching(b"")) <= MAX_KEPT_BYTES


@pytest.mark.parametrize(
    ("parts", "good"),
    [
        ([b"box1/tick", b"\x80", b"0"], True),
        ([b"box1/tick", b"\x80", b"0", b"more"], True),
        ([b"box1/tick", b"\x80", b"0" * 60, b"more"], True),
        ([b"box1/tick", b"\x80", b"0" * 60, b"more!"], False),
        ([b"box1/tick", b"\x80", b"0" * 400_000], False),
        ([b"box1/tick", b"\x80"], False),
        ([b"box1/tick", b"", b"0"], False),
        ([b"box1/tick", b"x" * 32769, b"0"], False),
        ([b"tick", b"\x80", b"0"], False),
        ([b"\xff\xfe/tick", b"\x80", b"0"], False),
        ([b"~hello/1234", b"\x80", b"0"], False),
        ([b"box1/tick\n", b"\x80", b"0"], False),
    ],
)
def test_form_that_the_bus_asks_for(parts: list[bytes], good: bool) -> None:
    assert well_formed(parts) is good
