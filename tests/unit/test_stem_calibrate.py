"""The setup run: one step after the other, a picture each, and the beat always let go."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from flora_common.messages import Frame, FrameMissed, Lamps, Message, Setup
from flora_common.runs import CameraSection, RunFile, RunFolder, run_file_text
from flora_stem.calibrate import SetupRun, SetupRunFailed, Step, plan, set_aside
from flora_stem.main import main


def frame(tick: int, shot: str) -> Frame:
    return Frame(
        tick=tick,
        time_s=0.0,
        path=f"background/{shot}",
        run="run",
        sha256="0" * 64,
        bytes=1,
        width_px=1,
        height_px=1,
        light="left",
        flash_confirmed=True,
        exposure_ok=True,
        purpose="background",
    )


def missed(tick: int, shot: str) -> FrameMissed:
    return FrameMissed(tick=tick, time_s=0.0, because="camera_hung", reason="killed", purpose="background", shot=shot)


class Asked:
    def __init__(self, each: int = 1) -> None:
        self.said: list[Message] = []
        self.steps = plan(each)
        self.run = SetupRun(self.steps, timeout_s=50.0, say=self.said.append)

    @property
    def last(self) -> Setup:
        assert isinstance(self.said[-1], Setup)
        return self.said[-1]


def test_the_plan_is_every_lamp_state_so_many_times() -> None:
    steps = plan(2)

    assert [s.number for s in steps] == list(range(1, 9))
    assert steps[0] == Step(1, "left", "left-1.jpg")
    assert {s.lamps for s in steps} == {"left", "right", "dark", "both"}
    assert len({s.shot for s in steps}) == 8


def test_each_picture_brings_the_next_step_and_the_end_lets_the_beat_go() -> None:
    asked = Asked()
    asked.run.begin(0.0)
    for tick, step in enumerate(asked.steps, start=1):
        assert asked.run.step == step
        assert asked.last == Setup(active=True, step=step.number, steps=4, lamps=step.lamps, shot=step.shot)
        asked.run.hear(frame(tick, step.shot), 1.0)
    assert asked.run.step is None

    asked.run.end()

    assert asked.last == Setup(active=False)


def test_pictures_of_other_steps_of_the_run_and_of_earlier_setup_runs_do_not_count() -> None:
    asked = Asked()
    asked.run.hear(frame(9, "left-1.jpg"), 0.0)  # kept by the bus from an earlier setup run
    asked.run.begin(0.0)

    asked.run.hear(frame(9, "left-1.jpg"), 1.0)
    asked.run.hear(frame(10, "right-1.jpg"), 1.0)
    asked.run.hear(missed(11, "dark-1.jpg"), 1.0)
    assert asked.run.step == asked.steps[0]
    asked.run.hear(frame(12, "left-1.jpg"), 1.0)
    assert asked.run.step == asked.steps[1]


def test_a_missed_picture_is_asked_for_once_more_and_then_given_up() -> None:
    asked = Asked()
    asked.run.begin(0.0)
    asked.run.hear(missed(1, "left-1.jpg"), 1.0)
    assert len(asked.said) == 2

    with pytest.raises(SetupRunFailed, match=r"no photograph for left-1.jpg \(camera_hung\): killed"):
        asked.run.hear(missed(2, "left-1.jpg"), 2.0)


def test_a_step_that_takes_too_long_says_who_is_to_be_looked_at() -> None:
    asked = Asked()
    asked.run.begin(0.0)
    asked.run.check(49.0)
    with pytest.raises(SetupRunFailed, match=r"nobody lit `left` in 50 s; is flora-led running\?"):
        asked.run.check(51.0)

    asked.run.hear(Lamps(lit="left", commanded="left", setup_step=1), 51.0)
    with pytest.raises(SetupRunFailed, match="no photograph came in 50 s; is flora-flash and flora-capture running"):
        asked.run.check(51.0)


def test_what_was_asked_is_said_again_before_others_take_it_for_over() -> None:
    asked = Asked()
    asked.run.begin(0.0)
    asked.run.check(14.0)
    assert len(asked.said) == 1

    asked.run.check(16.0)
    assert asked.said[1] == asked.said[0]
    for tick, step in enumerate(asked.steps, start=1):
        asked.run.hear(frame(tick, step.shot), 20.0)
    asked.run.check(36.0)  # waiting for the plant
    assert asked.last.active


@pytest.fixture
def config(tmp_path: Path) -> Path:
    run = RunFolder(tmp_path / "run")
    run.background.mkdir(parents=True)
    run.run_toml.write_text(run_file_text(RunFile(camera=CameraSection(anchor_px=(1.0, 1.0), px_per_cm=1.0))))
    (run.background / "left-1.jpg").write_bytes(b"x")
    path = tmp_path / "flora.toml"
    path.write_text(
        f'[rig]\nrun_dir = "{run.path}"\nbus_publish = "ipc://{tmp_path}/p"\nbus_subscribe = "ipc://{tmp_path}/s"\n'
    )
    return path


def test_pictures_that_are_there_are_not_photographed_again_unasked(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "--config", str(config)]) == 2

    said = capsys.readouterr().err
    assert "already holds 1 picture; --again sets them aside and takes new ones" in said
    assert said.count("\n") == 1


@pytest.fixture
def read_only(config: Path) -> Iterator[Path]:
    """The configuration of a run folder on a disk that cannot be written."""
    run = config.parent / "run"
    content = {path.relative_to(run): path.read_bytes() for path in run.rglob("*") if path.is_file()}
    mounted = subprocess.run(["mount", "-t", "tmpfs", "tmpfs", str(run)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"needs to mount a tmpfs: {mounted.stderr.decode().strip()}")
    try:
        for path, data in content.items():
            (run / path).parent.mkdir(exist_ok=True)
            (run / path).write_bytes(data)
        subprocess.run(["mount", "-o", "remount,ro", str(run)], check=True)
        yield config
    finally:
        subprocess.run(["umount", "-l", str(run)], check=True)


def test_pictures_on_a_read_only_disk_cannot_be_set_aside(read_only: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--again", "--config", str(read_only)]) == 1

    said = capsys.readouterr().err
    assert said == (
        f"flora-stem calibrate: {read_only.parent}/run/background: the earlier pictures cannot be set aside "
        "(Read-only file system); see that the folder can be written\n"
    )


@pytest.mark.parametrize("call", ["mkdir", "rename"])
def test_pictures_that_cannot_be_set_aside_are_one_line_and_status_1(
    config: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, call, refuse)
        assert main(["calibrate", "--again", "--config", str(config)]) == 1

    said = capsys.readouterr().err
    assert "the earlier pictures cannot be set aside (Permission denied)" in said
    assert said.count("\n") == 1
    assert (config.parent / "run" / "background" / "left-1.jpg").read_bytes() == b"x"


@pytest.mark.parametrize(
    ("option", "values", "told"),
    [
        ("--each", ["0", "51", "x", "1.5"], "must be 1 to 50"),
        ("--timeout", ["0", "3601", "inf", "nan", "x"], "must be above 0, 3600 s at most"),
    ],
)
def test_numbers_that_make_no_sense(
    option: str, values: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for value in values:
        assert main(["calibrate", option, value]) == 2
        said = f"flora-stem calibrate: argument {option}: {told} (see flora-stem calibrate --help)\n"
        assert capsys.readouterr().err == said


def test_earlier_pictures_are_set_aside_and_none_is_lost(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    assert set_aside(run) is None
    for number in (1, 2):
        (run.background).mkdir(exist_ok=True)
        (run.background / "left-1.jpg").write_bytes(b"%d" % number)
        assert set_aside(run) == run.background / f"before-{number}"

    assert run.background_pictures() == []
    assert [(run.background / f"before-{n}" / "left-1.jpg").read_bytes() for n in (1, 2)] == [b"1", b"2"]
