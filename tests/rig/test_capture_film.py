"""flora-capture with a film or an old run in the camera's place: one that is not there, and one that ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device_fakes import grey_film, grey_run
from flora_common.messages import Flash, Frame, FrameMissed, Health
from flora_common.runs import CameraSection, RunFile, run_file_text

PICTURES = 2


@pytest.fixture
def rig(bus: Any) -> Any:
    """A private bus with a run folder."""
    bus.run_dir.mkdir()
    camera = CameraSection(anchor_px=(32.0, 40.0), px_per_cm=4.0, width_px=64, height_px=48)
    (bus.run_dir / "run.toml").write_text(run_file_text(RunFile(camera=camera)))
    return bus


def film(path: Path) -> Path:
    return grey_film(path, PICTURES)


def old_run(path: Path) -> Path:
    return grey_run(path, PICTURES)


def without_pictures(path: Path) -> Path:
    run = old_run(path)
    for picture in run.glob("frames/*.jpg"):
        picture.unlink()
    return run


def with_an_empty_table(path: Path) -> Path:
    path.mkdir()
    (path / "frames.csv").write_text("file,time_s,light\n")
    return path


def empty_file(path: Path) -> Path:
    path.touch()
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def nothing(path: Path) -> Path:
    return path


@pytest.mark.parametrize(
    ("backend", "make", "said"),
    [
        ("opencv", nothing, "[capture] source {}: the film cannot be read (No such file or directory)"),
        ("opencv", folder, "[capture] source {}: the film cannot be read (Is a directory)"),
        ("opencv", empty_file, "[capture] source {}: an empty file, not a film"),
        ("replay", nothing, "[capture] source: nothing to replay: {}: no such run folder"),
        (
            "replay",
            folder,
            "[capture] source: nothing to replay: {}/frames.csv: cannot be read (No such file or directory)",
        ),
        (
            "replay",
            with_an_empty_table,
            "[capture] source: nothing to replay: {}/frames.csv: it lists no photographs",
        ),
        (
            "replay",
            without_pictures,
            "[capture] source: nothing to replay: {}/frames.csv: none of its photographs is there",
        ),
    ],
)
def test_a_source_that_cannot_be_used_is_one_line_and_status_2(
    rig: Any, backend: str, make: Callable[[Path], Path], said: str
) -> None:
    source = make(rig.folder / "source")
    rig.sections["capture"] = {"backend": backend, "source": str(source)}
    process = rig.start_service("flora-capture")  # without a bus: it does not get as far as waiting for one
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert err == f"flora-capture: {said.format(source)}\n"


@pytest.mark.parametrize(("backend", "make"), [("opencv", film), ("replay", old_run)])
def test_the_end_is_one_lasting_state_and_every_later_tick_is_answered(
    rig: Any, backend: str, make: Callable[[Path], Path]
) -> None:
    source = make(rig.folder / "source.avi")
    rig.sections["capture"] = {"backend": backend, "source": str(source)}
    rig.sections["rig"]["health_every_s"] = 60.0  # what is heard in between are changes
    rig.start_service("flora-bus")
    client = rig.client()
    capture = rig.start_service("flora-capture", "-v")
    rig.wait_ready(client, "flora-capture")
    heard = []
    for tick in range(1, PICTURES + 5):
        client.publish(Flash(tick=tick, lit=True, confirmed=True, time_s=300.0 * tick))
        heard += rig.hear(client, lambda new, tick=tick: any(answers(a.message, tick) for a in new))
    status, _, err = rig.stop(capture)
    assert status == 0

    messages = [a.message for a in heard if a.verdict == "good"]
    assert [m.tick for m in messages if isinstance(m, Frame)] == [1, 2]
    missed = [m for m in messages if isinstance(m, FrameMissed)]
    what = "run" if backend == "replay" else "film"
    reason = f"{source}: the {what} has ended after {PICTURES} pictures"
    assert [(m.tick, m.because, m.reason) for m in missed] == [(t, "camera_gone", reason) for t in (3, 4, 5, 6)]
    health = [(m.state, m.reason) for m in messages if isinstance(m, Health) and m.source == "flora-capture"]
    assert health == [("degraded", reason)]
    assert err.count("camera_open") == 1
    assert err.count("ended after") == 1
    assert "degraded_solved" not in err


def answers(message: Any, tick: int) -> bool:
    return isinstance(message, Frame | FrameMissed) and message.tick == tick
