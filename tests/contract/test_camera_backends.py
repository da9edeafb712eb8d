"""The same checks on every camera that works here, through the real camera process."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from device_fakes import GOOD_METADATA, fake_box, grey_film, grey_run
from flora_capture.core import exposure_of
from flora_capture.wire import Answer, CameraSettings, Request, pack, read
from flora_common.runs import RunFolder
from flora_common.vision.header import picture_size

PICTURES = 3
ON_A_PI = [
    pytest.mark.pi,
    pytest.mark.skipif(importlib.util.find_spec("picamera2") is None, reason="needs a Raspberry Pi and its camera"),
]


def told(**settings: Any) -> CameraSettings:
    """The first message to a child."""
    given = {
        "width_px": 64, "height_px": 48, "exposure_us": 20_000.0, "analogue_gain": 1.0, "colour_gains": (1.9, 1.6),
        "jpeg_quality": 90, "wait_s": 10.0, **settings,
    }  # fmt: skip
    return CameraSettings(**given)


class Child:
    """A camera process, asked by hand."""

    def __init__(self, **settings: Any) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "flora_capture.child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.send(told(**settings))
        self.opened = self.answer()

    def send(self, message: msgspec.Struct) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(pack(message))
        self.process.stdin.flush()

    def answer(self) -> Answer:
        assert self.process.stdout is not None
        payload = read(self.process.stdout)  # type: ignore[arg-type]
        assert payload is not None
        return msgspec.msgpack.decode(payload, type=Answer)

    def shoot(self, number: int, index: int) -> Answer:
        self.send(Request(number, index, f"frames/{number:06d}.jpg"))
        return self.answer()

    def end(self) -> int:
        """Close its stdin, as the end of the service does; returns its exit status."""
        with self.process:
            assert self.process.stdin is not None
            self.process.stdin.close()
            return self.process.wait(10.0)


def film(path: Path) -> Path:
    return grey_film(path, PICTURES)


def old_run(path: Path) -> Path:
    run = RunFolder(grey_run(path, PICTURES))
    line = {"file": "frames/0.jpg", "metadata": GOOD_METADATA}
    run.frames_log.write_bytes(msgspec.json.encode(line) + b"\n" + b'{"file": "frames/1.jpg", "meta')
    return path


@pytest.fixture(params=["virtual", "replay", "opencv", pytest.param("picamera2", marks=ON_A_PI)])
def camera(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Child]:
    with fake_box() as box:
        sources: dict[str, Callable[[], object]] = {
            "virtual": lambda: box.address,
            "replay": lambda: old_run(tmp_path / "old"),
            "opencv": lambda: film(tmp_path / "film.avi"),
            "picamera2": lambda: "0",
        }
        child = Child(backend=request.param, source=str(sources[request.param]()))
        yield child
        assert child.end() == 0


def test_it_opens_and_takes_whole_jpegs_of_the_right_size(camera: Child) -> None:
    assert camera.opened == Answer(0)
    for index in range(PICTURES):
        answer = camera.shoot(7 + index, index)
        assert (answer.number, answer.problem) == (7 + index, "")
        assert picture_size(answer.jpeg, where="photograph") == (64, 48)
        exposure_of(answer.metadata)


def test_a_restarted_service_gets_the_picture_that_is_next(camera: Child) -> None:
    assert picture_size(camera.shoot(1, 2).jpeg, where="photograph") == (64, 48)
    assert picture_size(camera.shoot(1, 2).jpeg, where="photograph") == (64, 48)
    assert picture_size(camera.shoot(1, 0).jpeg, where="photograph") == (64, 48)


@pytest.mark.parametrize(("backend", "make"), [("replay", old_run), ("opencv", film)])
def test_pictures_come_in_order_and_their_end_is_told(
    tmp_path: Path, backend: str, make: Callable[[Path], Path]
) -> None:
    import cv2
    import numpy as np

    child = Child(backend=backend, source=str(make(tmp_path / "old.avi")))
    for index in (0, 1, 2, 1):
        picture = cv2.imdecode(np.frombuffer(child.shoot(1, index).jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert picture.mean() == pytest.approx(50 + 60 * index, abs=4)
    for index in (PICTURES, PICTURES + 7, PICTURES):
        answer = child.shoot(1, index)
        assert answer.problem == "film_ended"
        assert answer.reason.endswith(" has ended after 3 pictures")
    assert child.shoot(1, 0).problem == ""
    assert child.end() == 0


@pytest.mark.parametrize(("backend", "make"), [("replay", old_run), ("opencv", film)])
@pytest.mark.parametrize("index", [PICTURES, PICTURES + 7])
def test_a_camera_process_that_starts_behind_the_end_says_so(
    tmp_path: Path, backend: str, make: Callable[[Path], Path], index: int
) -> None:
    child = Child(backend=backend, source=str(make(tmp_path / "old.avi")))
    answer = child.shoot(1, index)
    assert (answer.problem, answer.reason.endswith(" has ended after 3 pictures")) == ("film_ended", True)
    assert child.end() == 0


def test_replay_brings_the_metadata_that_were_kept(tmp_path: Path) -> None:
    child = Child(backend="replay", source=str(old_run(tmp_path / "old")))
    assert child.shoot(1, 0).metadata == GOOD_METADATA
    assert child.shoot(2, 1).metadata == {}
    assert child.end() == 0


@pytest.mark.parametrize(
    ("backend", "source", "reason"),
    [
        ("replay", "nowhere", "nothing to replay"),
        ("opencv", "nowhere.avi", "no such video file"),
        ("opencv", "/dev/video63", "no such camera"),
        ("opencv", __file__, "not a video"),
        pytest.param(
            "picamera2",
            "0",
            "python3-picamera2",
            marks=pytest.mark.skipif(importlib.util.find_spec("picamera2") is not None, reason="picamera2 is here"),
        ),
    ],
)
def test_a_camera_that_is_not_there_is_one_clear_line(backend: str, source: str, reason: str) -> None:
    child = Child(backend=backend, source=source)
    assert child.opened.problem == "camera_gone"
    assert reason in child.opened.reason
    assert child.end() == 0


def test_the_virtual_camera_asks_for_the_locked_exposure_and_believes_little() -> None:
    with fake_box() as box:
        child = Child(backend="virtual", source=box.address)
        child.shoot(12, 0)
        assert box.requests[-1] == {
            "op": "shutter", "exposure_us": 20_000.0, "analogue_gain": 1.0, "colour_gains": [1.9, 1.6],
            "name": "frames/000012.jpg",
        }  # fmt: skip
        box.jpeg = "no bytes"  # type: ignore[assignment]
        assert child.shoot(13, 0).problem == "bad_picture"
        box.refuse.add("shutter")
        answer = child.shoot(14, 0)
        assert (answer.problem, "shutter is broken" in answer.reason) == ("camera_gone", True)
        assert child.end() == 0


def test_a_camera_process_whose_service_was_killed_as_it_started_ends_at_once(tmp_path: Path) -> None:
    """Else it would open its camera, and wait for one that does not answer for as long as it may."""
    reads, writes = os.pipe()
    os.close(reads)  # as the kernel does for a service that is killed
    command = [sys.executable, "-m", "flora_capture.child"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=writes, bufsize=0) as child:
        os.close(writes)
        assert child.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it may have ended before it is told
            child.stdin.write(pack(told(backend="virtual", source=f"ipc://{tmp_path}/nobody")))
        assert child.wait(10.0) == 0


def test_the_virtual_cameras_process_loads_neither_numpy_nor_opencv() -> None:
    code = (
        "import sys, flora_capture.child, flora_capture.backends.virtual\n"
        "print([m for m in ('numpy', 'cv2', 'rich', 'typer') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
