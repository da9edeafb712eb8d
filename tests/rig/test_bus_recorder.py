"""flora-recorder as a process: what it hears is in its files, whatever happens to it or to the disk."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from flora_common.bus import Arrival
from flora_common.errors import BadInput
from flora_common.messages import Health, Recording, Stem, Tick
from flora_common.recording import UNREADABLE
from flora_common.recording_reader import RecordingReader


def last_recording(heard: list[Arrival]) -> Recording | None:
    said = [a.message for a in heard if isinstance(a.message, Recording)]
    return said[-1] if said else None


def read(path: Path) -> list[Any]:
    reader = RecordingReader(path)
    recorded = list(reader)
    assert reader.problem == ""
    return recorded


def ticks_in(path: Path) -> list[int]:
    return [msgspec.msgpack.decode(r.payload)["tick"] for r in read(path) if r.topic == "test/tick"]


def stems_in(path: Path) -> list[int]:
    try:
        return [r.sequence for r in RecordingReader(path) if r.topic == "test/stem"]
    except BadInput:
        return []  # renamed since it was listed, or nothing in it yet


def is_health_of_recorder(arrival: Arrival) -> bool:
    return isinstance(arrival.message, Health) and arrival.message.source == "flora-recorder"


@pytest.fixture
def recording_bus(bus: Any) -> Any:
    bus.sections["recorder"] = {"flush_s": 0.1}
    bus.start_service("flora-bus")
    return bus


def test_a_recording_names_the_run_that_a_link_leads_to(recording_bus: Any) -> None:
    bus = recording_bus
    bus.run_dir.with_name("bean-07").mkdir()
    bus.run_dir.symlink_to("bean-07")
    recorder = bus.start_service("flora-recorder")
    bus.wait_ready(bus.client(), "flora-recorder")
    bus.stop(recorder)
    reader = RecordingReader(next((bus.run_dir / "bus").glob("*.mcap")))
    assert len(list(reader)) > 0
    assert reader.metadata["run"] == "bean-07"


def test_records_everything_of_its_rig_and_closes_on_sigterm(recording_bus: Any) -> None:
    bus = recording_bus
    recorder = bus.start_service("flora-recorder")
    client = bus.client()
    bus.wait_ready(client, "flora-recorder")
    for tick in range(1, 6):
        client.publish(Tick(tick=tick, time_s=300.0 * tick))
        client.publish(Stem(tick=tick, time_s=300.0 * tick, outcome="ok", points_cm=((0.0, 0.0), (1.5, 9.0))))
    client.publisher.send_multipart([b"test/tick", b"\xc1", b"0"])
    client.publisher.send_multipart([b"test/nosuch", b"\x80", b"0"])
    client.publisher.send_multipart([b"other/tick", b"\x80", b"0"])
    bus.hear(client, lambda heard: (r := last_recording(heard)) is not None and r.bad == 2)
    status, _, err = bus.stop(recorder)
    assert status == 0, err
    heard = bus.hear(client, lambda heard: (r := last_recording(heard)) is not None and r.closed)
    said = last_recording(heard)
    assert said is not None
    path = bus.run_dir / said.path
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert path.stat().st_size == said.bytes
    recorded = read(path)
    assert len(recorded) == said.messages
    assert ticks_in(path) == [1, 2, 3, 4, 5]
    unreadable = [msgspec.msgpack.decode(r.payload) for r in recorded if r.topic == f"test/{UNREADABLE}"]
    assert [u["frames"] for u in unreadable] == [[b"test/tick", b"\xc1", b"0"], [b"test/nosuch", b"\x80", b"0"]]
    assert not [r for r in recorded if r.topic.startswith("other/")]


def test_killed_recorder_loses_nothing_that_was_flushed(recording_bus: Any) -> None:
    bus = recording_bus
    recorder = bus.start_service("flora-recorder")
    client = bus.client()
    bus.wait_ready(client, "flora-recorder")
    client.publish(Tick(tick=1, time_s=300.0))
    before = bus.hear(client, lambda heard: (r := last_recording(heard)) is not None and r.messages > 1)
    bus.hear(client, lambda heard: sum(isinstance(a.message, Recording) for a in heard) >= 2)
    recorder.send_signal(signal.SIGKILL)
    recorder.wait()
    folder = bus.run_dir / "bus"
    assert [p.suffix for p in folder.iterdir()] == [".open"]
    again = bus.start_service("flora-recorder")
    bus.wait_ready(client, "flora-recorder")
    bus.hear(client, lambda heard: last_recording(heard) is not None)
    bus.stop(again)
    first, second = sorted(folder.glob("*.mcap"))
    said = last_recording(before)
    assert said is not None
    assert len(read(first)) >= said.messages
    assert 1 in ticks_in(first)
    assert ticks_in(second) == [1]  # kept by the bus, so each file starts with what holds
    assert not list(folder.glob("*.open"))


def test_rotates_by_size(recording_bus: Any) -> None:
    bus = recording_bus
    bus.sections["recorder"] |= {"rotate_mib": 0.01}
    recorder = bus.start_service("flora-recorder")
    client = bus.client()
    bus.wait_ready(client, "flora-recorder")
    closed: set[str] = set()
    tick = 0
    while len(closed) < 2:
        for _ in range(50):
            tick += 1
            client.publish(Stem(tick=tick, time_s=1.0, outcome="no_stem", reason=os.urandom(100).hex()))
        # Its next health paces us: while it closes files, its queue must not fill up.
        for arrival in bus.hear(client, lambda heard: any(is_health_of_recorder(a) for a in heard)):
            if isinstance(arrival.message, Recording) and arrival.message.closed:
                closed.add(arrival.message.path)
    folder = bus.run_dir / "bus"
    bus.hear(client, lambda _: tick in [seq for path in folder.glob("*.mcap*") for seq in stems_in(path)])
    bus.stop(recorder)
    files = sorted(folder.glob("*.mcap"))
    assert len(files) >= 3
    assert [seq for path in files for seq in stems_in(path)] == list(range(1, tick + 1))


def test_a_folder_that_is_deleted_is_told_and_recording_goes_on_in_a_new_file(recording_bus: Any) -> None:
    bus = recording_bus
    recorder = bus.start_service("flora-recorder")
    client = bus.client()
    bus.wait_ready(client, "flora-recorder")
    first = last_recording(bus.hear(client, lambda heard: last_recording(heard) is not None))
    assert first is not None
    shutil.rmtree(bus.run_dir / "bus")
    heard = bus.hear(
        client, lambda heard: any(is_health_of_recorder(a) and a.message.state == "degraded" for a in heard)
    )
    reason = next(a.message.reason for a in heard if is_health_of_recorder(a) and a.message.state == "degraded")
    assert f"{bus.run_dir / first.path}.open was deleted or moved while it was written" in reason
    bus.hear(client, lambda heard: (r := last_recording(heard)) is not None and r.path != first.path)
    bus.wait_ready(client, "flora-recorder")
    client.publish(Tick(tick=7, time_s=1.0))
    bus.hear(client, lambda heard: any(getattr(a.message, "tick", 0) == 7 for a in heard))
    status, _, err = bus.stop(recorder)
    assert status == 0
    assert err.count("was deleted or moved") == 1
    (path,) = (bus.run_dir / "bus").glob("*.mcap")
    assert ticks_in(path) == [7]


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        while True:
            file.write(b"\0" * 4096)


def test_full_disk_degrades_and_recovers(recording_bus: Any, tmp_path: Path) -> None:
    bus = recording_bus
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", str(small)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"needs to mount a tmpfs: {mounted.stderr.decode().strip()}")
    try:
        bus.sections["rig"]["run_dir"] = str(small / "run")
        recorder = bus.start_service("flora-recorder")
        client = bus.client()
        bus.wait_ready(client, "flora-recorder")
        filler = small / "filler"
        with pytest.raises(OSError, match="No space left"):
            fill(filler)
        for tick in range(1, 200):
            client.publish(Stem(tick=tick, time_s=1.0, outcome="no_stem", reason=os.urandom(100).hex()))
        is_degraded = lambda a: getattr(a.message, "state", "") == "degraded"  # noqa: E731
        heard = bus.hear(client, lambda heard: any(is_degraded(a) for a in heard))
        reason = next(a.message.reason for a in heard if is_degraded(a))
        assert "no room on the disk" in reason
        assert recorder.poll() is None
        filler.unlink()
        bus.wait_ready(client, "flora-recorder")
        status, _, err = bus.stop(recorder)
        assert status == 0
        assert "degraded_solved" in err
        (path,) = (small / "run" / "bus").glob("*.mcap")
        assert [r.sequence for r in read(path) if r.topic == "test/stem"] == list(range(1, 200))
    finally:
        bus.close()
        subprocess.run(["umount", "-l", str(small)], check=True)
