"""Nonsense at the door: malformed frames end no service, cost no memory, and every one is counted.

A quick run by default; `make fuzz` sends a million (FLORA_FUZZ=1000000).

flora-capture replays a small run in place of a camera. flora-twin is on no bus.
"""

from __future__ import annotations

import os
import random
import signal
import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from device_fakes import tiny_jpeg
from flora_bus.broker import well_formed
from flora_common.bus import Arrival, BusClient
from flora_common.clock import SystemClock
from flora_common.errors import BadMessage
from flora_common.files import write_bytes
from flora_common.messages import CATALOGUE, MAX_PAYLOAD_BYTES, Health, decode, encode
from flora_common.recording import UNREADABLE
from flora_common.recording_reader import RecordingReader
from flora_common.runs import CameraSection, LampsSection, RunFile, RunFolder, TargetSection, run_file_text

FRAMES = int(os.environ.get("FLORA_FUZZ", "20000"))
BATCH = 300
"""On the way at once: below half of the high-water mark, so that ZeroMQ drops nothing and the counts must be exact."""

GROWTH_KIB = 10 * 1024
DEADLINE_S = 60.0
GOLDEN = Path(__file__).parents[1] / "golden" / "messages" / "v1"

SERVICES: dict[str, tuple[str, ...]] = {
    "flora-recorder": ("",),
    "flora-controller": ("stem", "setup", "controller_offer", "controller_chunk"),
    "flora-led": ("light", "setup", "tick"),
    "flora-stem": ("frame", "setup"),
    "flora-uploader": ("frame",),
    "flora-capture": ("flash", "frame", "lamps"),
    "flora-flash": ("tick", "flash", "frame", "lamps", "setup"),
}
"""Which services are started, and what they hear: topics after ``<rig>/`` that begin with one of these."""

SECTIONS: dict[str, dict[str, object]] = {
    "recorder": {"flush_s": 1.0},
    "flash": {"backend": "none"},
    "led": {"backend": "neopixel", "pin": "NEOPIXEL"},
}

NONSENSE = (
    b"",
    b"\xc1",
    b"\x80",
    b"\x90",
    b"\xc0",
    b"\xdd\xff\xff\xff\xff",  # array of 4 G
    b"\xdf\xff\xff\xff\xff",  # map of 4 G
    b"\xdb\xff\xff\xff\xff",  # string of 4 G
    b"\xc6\xff\xff\xff\xff",  # bytes of 4 G
    b"\x81\xa6schema\xdb\xff\xff\xff\xffx",
    b"\x91" * 20_000,  # deep nesting
    b"\x81\xa1a" * 8_000,
    b"\x81\xa6source\xa2\xff\xfe",  # not UTF-8
    b"x" * (MAX_PAYLOAD_BYTES + 1),
    b"x" * 500_000,
)


class Nonsense:
    """Frames from a seed: mutated valid messages, wrong part counts, length bombs, strange topics."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.good = {spec.kind: (GOLDEN / f"{spec.kind}.msgpack").read_bytes() for spec in CATALOGUE.values()}
        self.kinds = list(CATALOGUE)
        self.seq: Counter[str] = Counter()

    def valid(self) -> list[bytes]:
        kind = self.draw.choice(self.kinds)
        message: Any = msgspec.msgpack.decode(self.good[kind], type=CATALOGUE[kind].type)
        self.seq[kind] += 1
        return encode("test", msgspec.structs.replace(message, source="fuzzer", seq=self.seq[kind], tick=1))

    def frames(self) -> list[bytes]:
        draw = self.draw
        way = draw.random()
        topic, payload, seconds = self.valid()
        if way < 0.15:
            return [topic, payload, seconds]
        if way < 0.45:
            return [topic, self.flipped(payload), seconds]
        if way < 0.6:
            return [topic, payload[: draw.randrange(len(payload))], seconds]
        if way < 0.7:
            return [topic, draw.choice(NONSENSE), seconds]
        if way < 0.78:
            return [topic, self.with_odd_number(payload), seconds]
        if way < 0.84:
            return [self.strange_topic(), payload, seconds]
        if way < 0.9:
            return [b"test/" + bytes(draw.choices(b"abcdefghij_", k=draw.randrange(1, 12))), payload, seconds]
        if way < 0.97:
            return [topic, payload, seconds, b"more"][: draw.randrange(1, 3)]
        return [topic, payload, seconds] + [draw.randbytes(3)] * draw.randrange(1, 40)

    def flipped(self, payload: bytes) -> bytes:
        data = bytearray(payload)
        for _ in range(self.draw.randrange(1, 4)):
            data[self.draw.randrange(len(data))] = self.draw.randrange(256)
        return bytes(data)

    def with_odd_number(self, payload: bytes) -> bytes:
        """NaN, infinities and huge numbers in place of a number."""
        fields = msgspec.msgpack.decode(payload)
        numbers = [name for name, value in fields.items() if isinstance(value, int | float)]
        odd = (float("nan"), float("inf"), -float("inf"), 1e308, -1.0, 2**63, -(2**62))
        fields[self.draw.choice(numbers)] = self.draw.choice(odd)
        return msgspec.msgpack.encode(fields)

    def strange_topic(self) -> bytes:
        strange = (
            b"",
            b"/",
            b"test/",
            b"test",
            b"\xff\xfe/tick",
            b"test/tick\x00",
            b"TEST/tick",
            b"~hello/x",
            b"a" * 300,
        )
        return self.draw.choice((*strange, self.draw.randbytes(self.draw.randrange(1, 60))))


class Expected:
    """What each side must count, by the same pure functions that they use."""

    def __init__(self) -> None:
        self.malformed = 0
        self.forwarded = 0
        self.bad = 0

    def add(self, parts: list[bytes]) -> None:
        if not well_formed(parts):
            self.malformed += 1
            return
        self.forwarded += 1
        if not parts[0].startswith(b"test/"):
            return
        try:
            decode(parts)
        except BadMessage:
            self.bad += 1


class Tap:
    """Hears all that the bus passes on, keeps the last health of each service, counts topics, and tells who is done."""

    def __init__(self, bus: Any) -> None:
        self.client: BusClient = bus.client("fuzz-tap")
        self.passed_on: Counter[str] = Counter()
        self.prefixes = {name: tuple(f"test/{kind}".encode() for kind in kinds) for name, kinds in SERVICES.items()}
        self.health: dict[str, Health] = {}
        self.processes = bus.processes

    def hear(self, wait_ms: int = 0) -> None:
        self.client.subscriber.poll(wait_ms)
        arrivals: list[Arrival] = self.client.receive_all(10_000)
        for arrival in arrivals:
            for service, prefixes in self.prefixes.items():
                self.passed_on[service] += arrival.parts[0].startswith(prefixes)
            message = arrival.message
            if arrival.verdict == "good" and isinstance(message, Health) and message.source.startswith("flora-"):
                self.health[message.source] = message

    def until(self, condition: Any, what: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            dead = [p.args for p in self.processes if p.poll() is not None]
            assert not dead, f"ended: {dead}: {[p.stderr.read()[-2000:] for p in self.processes if p.args in dead]}"
            assert time.monotonic() < end_s, f"{what} did not come in {DEADLINE_S} s: {self.health}"
            self.hear(20)


def taken(health: Health) -> int:
    """All that a service took notice of."""
    return health.received + health.bad + health.unknown + health.duplicates


def make_run(bus: Any) -> None:
    bus.run_dir.mkdir()
    run = RunFile(
        camera=CameraSection(anchor_px=(820.0, 1100.0), px_per_cm=30.0),
        rig="test",
        lamps=LampsSection(),
        target=TargetSection(x_cm=-5.0, y_cm=18.0),
    )
    (bus.run_dir / "run.toml").write_text(run_file_text(run), encoding="utf-8")


def make_replay(bus: Any) -> Path:
    """A run of three tiny photographs, in place of a camera."""
    folder = RunFolder(bus.folder / "replayed")
    for number in range(3):
        write_bytes(folder.frames / f"{number}.jpg", tiny_jpeg())
        folder.append_frame(f"frames/{number}.jpg", 300.0 * number, "left")
    return folder.path


def batches(nonsense: Nonsense, count: int) -> Iterator[list[list[bytes]]]:
    for start in range(0, count, BATCH):
        yield [nonsense.frames() for _ in range(min(BATCH, count - start))]


def test_nonsense_ends_no_service_and_is_counted(bus: Any) -> None:
    make_run(bus)
    bus.sections["rig"]["health_every_s"] = 0.1
    bus.sections |= SECTIONS | {"uploader": {"target": str(bus.folder / "nas")}}
    bus.sections["capture"] = {"backend": "replay", "source": str(make_replay(bus))}
    bus.start_service("flora-bus")
    tap = Tap(bus)
    for service in SERVICES:
        bus.start_service(service, env={"BLINKA_OS_AGNOSTIC": "1"})
    tap.until(lambda: set(SERVICES) | {"flora-bus"} <= set(tap.health), "health of all")

    # Quiet: what services have taken notice of does not change over six of their health messages: under load what
    # another one has passed on is still on its way to them.
    quiet: dict[str, tuple[int, int]] = {}
    for service, kinds in SERVICES.items():
        if kinds == ("",):
            continue
        last = taken(tap.health[service])
        since = tap.health[service].seq

        def is_quiet(service: str = service) -> bool:
            nonlocal last, since
            health = tap.health[service]
            if taken(health) != last:
                last, since = taken(health), health.seq
            return health.seq >= since + 6

        tap.until(is_quiet, f"quiet {service}")
        quiet[service] = (taken(tap.health[service]), tap.passed_on[service])
    before = dict(tap.health)

    sender = zmq.Context.instance().socket(zmq.XPUB)
    sender.setsockopt(zmq.XPUB_NODROP, 1)
    sender.connect(bus.address.publish)
    assert sender.poll(5000)
    expected = Expected()
    sent = 0
    for batch in batches(Nonsense(seed=2018), FRAMES):
        for parts in batch:
            sender.send_multipart(parts)
            expected.add(parts)
        sent += len(batch)
        bus_seen = before["flora-bus"].bad + expected.malformed
        tap.until(lambda seen=bus_seen: tap.health["flora-bus"].bad >= seen, "the bus's count of malformed frames")
        # The next batch goes out when everybody has taken notice of this one.
        for service, (had, passed) in quiet.items():
            target = lambda s=service, h=had, p=passed: h + tap.passed_on[s] - p  # noqa: E731
            tap.until(lambda s=service, t=target: taken(tap.health[s]) >= t(), f"{service}'s count")
        recorded = before["flora-recorder"].bad + before["flora-recorder"].unknown + expected.bad
        tap.until(
            lambda r=recorded: tap.health["flora-recorder"].bad + tap.health["flora-recorder"].unknown >= r,
            "the recorder's count",
        )
    after = dict(tap.health)

    assert sent == FRAMES == expected.malformed + expected.forwarded
    assert after["flora-bus"].bad - before["flora-bus"].bad == expected.malformed
    recorder = after["flora-recorder"]
    assert recorder.bad + recorder.unknown == expected.bad
    for service, (had, passed) in quiet.items():
        assert taken(after[service]) - had == tap.passed_on[service] - passed, service
    growth = {name: after[name].resident_kib - before[name].resident_kib for name in before}
    assert max(growth.values()) < GROWTH_KIB, growth
    assert all(process.poll() is None for process in bus.processes)
    sender.close(linger=0)

    recorder_process = next(p for p in bus.processes if str(p.args).find("flora-recorder") > 0)
    status, _, err = bus.stop(recorder_process)
    assert status == 0, err
    unreadable = 0
    for path in (bus.run_dir / "bus").glob("*.mcap"):
        reader = RecordingReader(path)
        unreadable += sum(recorded.topic == f"test/{UNREADABLE}" for recorded in reader)
        assert reader.problem == ""
    assert unreadable == expected.bad


# A process of its own, which ends without closing: libzmq aborts now and then where a socket is closed while its
# connection goes down in the middle of a message (session_base.cpp, clean_pipes).
HUGE_FRAME = """
import os, sys, zmq
huge = zmq.Context.instance().socket(zmq.XPUB)
huge.connect(sys.argv[1])
assert huge.poll(5000)
huge.send_multipart([b"test/tick", bytes(100_000_000), b"0"])
assert huge.poll(10_000)  # the bus has ended the connection: our one subscriber is gone
print("ended", flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("hostile", ["huge_frame", "no_zmtp", "half_a_greeting", "silent"])
def test_hostile_connections_do_not_disturb_the_others(bus: Any, hostile: str) -> None:
    process = bus.start_service("flora-bus")
    client = bus.client()
    resident = lambda: int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * 4  # noqa: E731
    before = resident()
    path = bus.address.publish.removeprefix("ipc://")
    raw = None
    if hostile == "huge_frame":
        script = bus.folder / "huge.py"
        script.write_text(HUGE_FRAME)
        assert bus.start(str(script), bus.address.publish).stdout.readline() == "ended\n"
    else:
        raw = socket.socket(socket.AF_UNIX)
        raw.connect(path)
        if hostile == "no_zmtp":
            raw.sendall(random.Random(1).randbytes(65_536))
        elif hostile == "half_a_greeting":
            raw.sendall(b"\xff\x00\x00\x00\x00\x00\x00\x00\x01\x7f\x03")
    for number in range(20):
        client.publisher.send_multipart([b"test/setup", b"\x80" * (number + 1), struct.pack("<I", number)])
    bus.hear(client, lambda heard: sum(a.parts[0] == b"test/setup" for a in heard) == 20)
    assert resident() - before < GROWTH_KIB
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5) == 0
    if raw is not None:
        raw.close()


def test_frames_that_a_bus_would_refuse_end_no_service_either(bus: Any) -> None:
    """A subscriber straight at a hostile publisher in the bus's place."""
    hostile = zmq.Context.instance().socket(zmq.XPUB)
    listening = zmq.Context.instance().socket(zmq.XSUB)
    hostile.setsockopt(zmq.XPUB_NODROP, 1)
    hostile.bind(bus.address.subscribe)
    listening.bind(bus.address.publish)
    listening.send(b"\x01")
    client = BusClient(bus.address, rig="test", source="fuzz", clock=SystemClock())
    client.subscribe_prefixes(b"")
    client.connect()
    while hostile.recv()[1:7] != b"~hello":
        pass
    nonsense, sent = Nonsense(seed=7), 0
    for batch in batches(nonsense, 3000):
        for parts in batch:
            hostile.send_multipart(parts)
            sent += not parts[0].startswith(b"~hello/")
        counters = client.counters
        while sum((counters.received, counters.bad, counters.unknown, counters.duplicates)) < sent:
            assert client.subscriber.poll(5000), f"{counters} of {sent}"
            client.receive_all()
    assert sum((counters.received, counters.bad, counters.unknown, counters.duplicates)) == sent
    assert counters.bad > 0
    assert counters.unknown > 0
    assert counters.received > 0
    client.close()
    hostile.close(linger=0)
    listening.close(linger=0)
