"""flora-stem as a process on a private bus: frames in, stems out, killed in between; and the setup run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np

from announced_frames import announced
from flora_common.bus import Arrival, BusClient
from flora_common.files import write_bytes
from flora_common.messages import Frame, FrameMissed, Health, Lamps, Setup, Stem
from flora_common.runs import CameraSection, RunFile, RunFolder, run_file_text
from flora_common.tracks import read_track

if TYPE_CHECKING:
    from conftest import PrivateBus

WIDTH, HEIGHT = 1640, 1232
CAMERA = CameraSection(anchor_px=(820.0, 1150.0), px_per_cm=45.0, width_px=WIDTH, height_px=HEIGHT)


def picture(tip_cm: tuple[float, float] | None) -> bytes:
    image = np.full((HEIGHT, WIDTH, 3), 20, dtype=np.uint8)
    if tip_cm is not None:
        tip = (round(820 + 45 * tip_cm[0]), round(1150 - 45 * tip_cm[1]))
        cv2.line(image, (820, 1149), tip, (60, 200, 60), 20)
    ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 93])
    assert ok
    return data.tobytes()


class Camera:
    """Stands in for flora-capture."""

    def __init__(self, bus: PrivateBus) -> None:
        self.bus = bus
        self.run = RunFolder(bus.run_dir)
        self.run.frames.mkdir(parents=True)
        self.run.run_toml.write_text(run_file_text(RunFile(camera=CAMERA, rig="test")))

    def frame(self, tick: int, data: bytes, *, shot: str = "") -> Frame:
        path = f"background/{shot}" if shot else f"frames/{tick:06d}.jpg"
        write_bytes(self.run.path / path, data)
        return msgspec.structs.replace(announced(path, data, tick), purpose="background" if shot else "run")

    def background(self) -> None:
        for name in ("left-1", "right-1"):
            write_bytes(self.run.background / f"{name}.jpg", picture(None))

    def stem_of(self, client: BusClient, tick: int, *, session_other_than: str = "") -> Stem:
        found: list[Stem] = []

        def said(heard: list[Arrival]) -> bool:
            found.extend(
                a.message
                for a in heard
                if isinstance(a.message, Stem) and a.message.tick == tick and a.message.session != session_other_than
            )
            return bool(found)

        self.bus.hear(client, said)
        return found[0]


def test_killed_in_the_middle_every_tick_is_answered_and_the_track_has_each_time_once(bus: PrivateBus) -> None:
    camera = Camera(bus)
    camera.background()
    bus.start_service("flora-bus")
    client = bus.client("flora-capture")
    bus.start_service("flora-stem")
    bus.wait_ready(client, "flora-stem")

    client.publish(camera.frame(1, picture((2.0, 10.0))))
    first = camera.stem_of(client, 1)
    torn = camera.frame(2, picture((2.1, 10.2)))
    (camera.run.path / torn.path).write_bytes(b"\xff\xd8\xff torn")
    client.publish(torn)
    bad = camera.stem_of(client, 2)
    client.publish(FrameMissed(tick=3, time_s=900.0, because="camera_hung", reason="killed after 25 s"))
    gone = camera.stem_of(client, 3)
    client.publish(camera.frame(4, picture((2.2, 10.4))))
    bus.processes[-1].kill()  # before, while or after it works on frame 4
    bus.processes[-1].wait()
    bus.start_service("flora-stem")
    fourth = camera.stem_of(client, 4)
    client.publish(camera.frame(5, picture((2.3, 10.6))))
    fifth = camera.stem_of(client, 5)

    outcomes = [s.outcome for s in (first, bad, gone, fourth, fifth)]
    assert outcomes == ["ok", "bad_picture", "no_frame", "ok", "ok"]
    assert abs(first.points_cm[9][1] - 10.0) < 0.5
    assert list(read_track(camera.run.track_csv).time_s) == [300.0, 1200.0, 1500.0]


def test_without_background_pictures_it_is_degraded_and_says_what_to_do(bus: PrivateBus) -> None:
    camera = Camera(bus)
    bus.start_service("flora-bus")
    client = bus.client("flora-capture")
    bus.start_service("flora-stem")
    reasons: list[str] = []

    def degraded(heard: list[Arrival]) -> bool:
        reasons.extend(
            a.message.reason for a in heard if isinstance(a.message, Health) and a.message.state == "degraded"
        )
        return bool(reasons)

    bus.hear(client, degraded)
    client.publish(camera.frame(1, picture((2.0, 10.0))))
    stem = camera.stem_of(client, 1)
    camera.background()
    client.publish(Setup(active=False))
    bus.wait_ready(client, "flora-stem")

    assert reasons[0] == "no background pictures; run flora-stem calibrate"
    assert (stem.outcome, stem.reason) == ("no_stem", reasons[0])


def test_a_run_folder_that_is_none_is_one_line_and_status_2(bus: PrivateBus) -> None:
    process = bus.start_service("flora-stem")
    _, error = process.communicate(timeout=20)

    assert process.returncode == 2
    assert "no such run folder" in error
    assert error.count("\n") == 1


def play_the_others(camera: Camera, client: BusClient, *, until: int) -> list[Setup]:
    """Lamps, flash and camera in one: answers each step with its lamps and its picture."""
    asked: list[Setup] = []

    def answered(heard: list[Arrival]) -> bool:
        for arrival in heard:
            setup = arrival.message
            if isinstance(setup, Setup) and setup.active and setup.step not in [s.step for s in asked]:
                asked.append(setup)
                client.publish(Lamps(lit=setup.lamps, commanded=setup.lamps, setup_step=setup.step))
                client.publish(camera.frame(100 + setup.step, picture(None), shot=setup.shot))
        return len(asked) == until

    camera.bus.hear(client, answered)
    return asked


def over(bus: PrivateBus, client: BusClient) -> None:
    bus.hear(client, lambda heard: any(isinstance(a.message, Setup) and not a.message.active for a in heard))


def test_the_setup_run_photographs_every_lamp_state_and_lets_the_beat_go(bus: PrivateBus) -> None:
    camera = Camera(bus)
    bus.start_service("flora-bus")
    client = bus.client("flora-capture")
    process = bus.start("flora-stem", "calibrate", "--config", str(bus.config), "--each", "1")

    asked = play_the_others(camera, client, until=4)
    out, error = process.communicate(timeout=20)
    over(bus, client)

    assert process.returncode == 0, error
    assert out == f"4 pictures of the empty setup are in {camera.run.background}\n"
    assert "setup run: 3 of 4, lamps dark, dark-1.jpg" in error
    assert [s.lamps for s in asked] == ["left", "right", "dark", "both"]
    assert len(camera.run.background_pictures()) == 4


def test_nobody_answers_and_the_beat_is_let_go_all_the_same(bus: PrivateBus) -> None:
    Camera(bus)
    bus.start_service("flora-bus")
    client = bus.client("flora-flash")
    process = bus.start("flora-stem", "calibrate", "--config", str(bus.config), "--timeout", "1")

    out, error = process.communicate(timeout=20)
    over(bus, client)

    assert (process.returncode, out) == (1, "")
    assert "step 1 (left-1.jpg): nobody lit `left` in 1 s; is flora-led running?" in error.splitlines()[-1]


def test_interrupted_by_systemd_the_beat_is_let_go(bus: PrivateBus) -> None:
    Camera(bus)
    bus.start_service("flora-bus")
    client = bus.client("flora-flash")
    process = bus.start("flora-stem", "calibrate", "--config", str(bus.config))
    bus.hear(client, lambda heard: any(isinstance(a.message, Setup) and a.message.active for a in heard))

    process.terminate()
    over(bus, client)

    assert process.wait(timeout=20) == 130


def test_with_wait_the_beat_rests_until_enter(bus: PrivateBus, tmp_path: Path) -> None:
    camera = Camera(bus)
    bus.start_service("flora-bus")
    client = bus.client("flora-capture")
    process = subprocess.Popen(
        [
            str(Path(sys.executable).parent / "flora-stem"),
            "calibrate",
            "--config",
            str(bus.config),
            "--each",
            "1",
            "--wait",
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    bus.processes.append(process)
    play_the_others(camera, client, until=4)
    assert process.stdin is not None
    assert process.stdout is not None
    assert "press Enter" in process.stdout.readline()
    assert process.poll() is None

    process.stdin.write("\n")
    process.stdin.flush()
    over(bus, client)

    assert process.wait(timeout=20) == 0
