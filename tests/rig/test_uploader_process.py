"""flora-uploader as a process on a private bus."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path
from typing import Any

from announced_frames import announced
from flora_common.bus import Arrival
from flora_common.files import append_line, write_bytes
from flora_common.messages import Health, Stored

RUN_TOML = b"[camera]\nanchor_px = [820.0, 1100.0]\npx_per_cm = 20.0\n"


def stored_paths(heard: list[Arrival]) -> list[str]:
    return [a.message.path for a in heard if isinstance(a.message, Stored) and a.message.stage == "stored"]


def states(heard: list[Arrival]) -> list[tuple[str, str]]:
    health = [a.message for a in heard if isinstance(a.message, Health) and a.message.source == "flora-uploader"]
    return [(h.state, h.reason) for h in health]


def cpu_s(pid: int) -> float:
    """Processor time of a process so far (proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_frames_go_when_announced_and_wait_when_the_target_is_gone(bus: Any, tmp_path: Path) -> None:
    nas = tmp_path / "nas"
    nas.mkdir()
    (nas / ".flora-nas").touch()
    bus.sections["uploader"] = {"target": str(nas), "scan_every_s": 3600.0, "marker": ".flora-nas"}
    write_bytes(bus.run_dir / "run.toml", RUN_TOML)
    bus.start_service("flora-bus")
    capture = bus.client("flora-capture")
    process = bus.start_service("flora-uploader")
    bus.hear(capture, lambda heard: "run.toml" in stored_paths(heard))

    picture = os.urandom(3_000_000)
    write_bytes(bus.run_dir / "frames" / "000001.jpg", picture)
    capture.publish(announced("frames/000001.jpg", picture, 1))
    heard = bus.hear(capture, lambda heard: "frames/000001.jpg" in stored_paths(heard))
    said = next(a.message for a in heard if isinstance(a.message, Stored) and a.message.path == "frames/000001.jpg")
    assert isinstance(said, Stored)
    assert (said.sha256, said.bytes) == (hashlib.sha256(picture).hexdigest(), len(picture))
    assert (nas / "run" / "frames" / "000001.jpg").read_bytes() == picture

    nas.rename(tmp_path / "away")
    write_bytes(bus.run_dir / "frames" / "000002.jpg", picture)
    capture.publish(announced("frames/000002.jpg", picture, 2))
    bus.hear(capture, lambda heard: any(s == "degraded" and "not reachable" in why for s, why in states(heard)))
    nas.mkdir()  # an empty mount point: nothing must be written there
    bus.hear(capture, lambda heard: any("marker file" in reason for _, reason in states(heard)), deadline_s=60.0)
    assert not list(nas.iterdir())
    nas.rmdir()
    (tmp_path / "away").rename(nas)
    bus.hear(capture, lambda heard: "frames/000002.jpg" in stored_paths(heard), deadline_s=60.0)
    bus.hear(capture, lambda heard: bool(states(heard)) and str(nas) not in states(heard)[-1][1])  # no trouble there

    append_line(bus.run_dir / "track.csv", "0.000,left", header="time_s,light")
    status, _, err = bus.stop(process)  # a polite stop takes along what has grown
    assert status == 0, err
    assert (nas / "run" / "track.csv").read_text() == "time_s,light\n0.000,left\n"
    assert not list(nas.rglob("*.part"))


def test_waiting_for_a_target_costs_nothing(bus: Any, tmp_path: Path) -> None:
    bus.sections["uploader"] = {"target": str(tmp_path / "nowhere"), "scan_every_s": 0.5}
    write_bytes(bus.run_dir / "run.toml", RUN_TOML)
    for number in range(200):
        path = bus.run_dir / "frames" / f"{number:06d}.jpg"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x" * 1000)
    bus.start_service("flora-bus")
    listener = bus.client()
    process = bus.start_service("flora-uploader")
    bus.hear(listener, lambda heard: any("not reachable" in reason for _, reason in states(heard)))
    began_s, began_cpu_s = time.monotonic(), cpu_s(process.pid)
    heard = bus.hear(listener, lambda heard: time.monotonic() - began_s > 3.0)
    share = (cpu_s(process.pid) - began_cpu_s) / (time.monotonic() - began_s)
    health = [a.message for a in heard if isinstance(a.message, Health) and a.message.source == "flora-uploader"]
    print(
        f"waiting: {share:.2%} of one core, {health[-1].resident_kib / 1024:.1f} MiB, slowest {health[-1].slowest_ms}"
    )
    assert share < 0.05  # scanning sixty times as often as usual, and telling its health every 0.2 s
    assert bus.stop(process)[0] == 0


def test_switched_off_is_a_state(bus: Any) -> None:
    # A file system without blocks is never full: the disk of whoever runs these tests may be.
    bus.sections["uploader"] = {"runs_dir": "/proc"}
    bus.start_service("flora-bus")
    listener = bus.client()
    process = bus.start_service("flora-uploader")
    heard = bus.hear(listener, lambda heard: bool(states(heard)))
    assert states(heard)[-1] == ("ready", "switched off: [uploader] target is empty")
    assert bus.stop(process)[0] == 0
