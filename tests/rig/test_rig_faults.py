"""The fault menu: each fault strikes a running virtual rig, is told, does no harm, and passes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import cast

import pytest

from flora_common.errors import BadInput, FloraError
from flora_common.messages import Tick
from flora_twin.faults import MENU
from flora_twin.rig import faults
from flora_twin.rig.faults import FaultSchedule, check_plan, parse_fault
from flora_twin.rig.integrity import check_run
from flora_twin.rig.virtual_rig import Seen, VirtualRig


@pytest.fixture(scope="module")
def hardy_rig(lasting_virtual_rig: Callable[..., VirtualRig]) -> Iterator[VirtualRig]:
    """One rig through all the faults below; at the end nothing that it ever announced may be missing or torn."""
    # Longer than the box needs for its first picture on a busy machine, shorter than anybody wants to wait.
    rig = lasting_virtual_rig(seed=5, capture={"hang_timeout_s": 6.0}, uploader={"table_every_s": 5.0})
    rig.start()
    rig.calibrate()
    yield rig
    finish_whole(rig)


@pytest.fixture
def running(hardy_rig: VirtualRig) -> VirtualRig:
    """The rig in good health, with nothing seen yet."""
    go_on(hardy_rig, 2)
    hardy_rig.seen.missed.clear()
    hardy_rig.seen.frames.clear()
    hardy_rig.seen.outcomes.clear()
    return hardy_rig


def go_on(rig: VirtualRig, ticks: int) -> None:
    """Let so many more ticks end with confirmed lamps."""
    goal = (rig.seen.tick.tick if rig.seen.tick else 0) + ticks
    rig.run(lambda seen: seen.lamps is not None and seen.lamps.tick >= goal and seen.lamps.setup_step == 0)


def finish_whole(rig: VirtualRig) -> None:
    rig.finish()
    integrity = check_run(rig.layout.run, rig.layout.nas / rig.layout.run.path.name)
    assert integrity.whole, integrity
    assert integrity.announced > 0


def test_a_hung_camera_is_killed_and_told_and_the_beat_goes_on(running: VirtualRig) -> None:
    with faults.fault(running, "camera_hangs"):
        running.run(lambda seen: bool(seen.missed))
    assert {missed.because for missed in running.seen.missed} == {"camera_hung"}
    go_on(running, 1)
    assert running.seen.outcomes["no_frame"] == len(running.seen.missed)
    before = len(running.seen.frames)
    go_on(running, 3)
    assert len(running.seen.frames) >= before + 2


def test_torn_pictures_never_become_stems_or_files(running: VirtualRig) -> None:
    with faults.fault(running, "torn_jpeg"):
        running.run(lambda seen: bool(seen.missed))
        before = len(running.seen.frames)
        go_on(running, 1)
        assert len(running.seen.frames) == before
    assert {missed.because for missed in running.seen.missed} == {"bad_picture"}
    go_on(running, 2)
    assert len(running.seen.frames) > before


def test_a_knocked_camera_is_told_and_no_stem_is_read_beside_its_place(running: VirtualRig) -> None:
    with faults.fault(running, "camera_knocked"):
        go_on(running, 2)
        stem = running.seen.stem
        assert stem is not None
        assert stem.outcome == "bad_picture"
        assert "the camera has moved by 1.0% of the picture's width" in stem.reason
        assert not running.seen.missed
    go_on(running, 2)
    assert running.seen.stem is not None
    assert running.seen.stem.outcome == "ok"


def test_a_dead_flash_is_told_and_the_photograph_is_marked(running: VirtualRig) -> None:
    with faults.fault(running, "flash_dead"):
        go_on(running, 2)
        assert running.seen.frames[-1].flash_confirmed is False
    go_on(running, 2)
    assert running.seen.frames[-1].flash_confirmed is True


def test_a_lost_lamp_command_is_made_good_by_the_next(running: VirtualRig) -> None:
    with faults.fault(running, "lamp_command_lost"):
        go_on(running, 2)
    go_on(running, 2)


def test_a_jumping_wall_clock_keeps_beat_and_order(running: VirtualRig) -> None:
    with faults.fault(running, "clock_jumps", "-31536000"):
        go_on(running, 3)
    go_on(running, 2)
    rows = running.layout.run.read_frames()[-5:]
    assert all(b.time_s - a.time_s == pytest.approx(300.0, abs=1.0) for a, b in pairwise(rows))


def test_the_bus_comes_back(running: VirtualRig) -> None:
    with faults.fault(running, "bus_restarted"):
        go_on(running, 4)
    assert running.restarts()["flora-bus"] == 1


@pytest.mark.parametrize("name", ["nas_gone", "nas_read_only"])
def test_nothing_is_lost_without_the_nas(running: VirtualRig, name: str) -> None:
    try:
        faults.begin(running, name)
    except FloraError as problem:
        pytest.skip(str(problem))
    try:
        go_on(running, 4)
        running.run(lambda seen: seen.health["flora-uploader"].state == "degraded")
    finally:
        faults.end(running, name)
    go_on(running, 2)


def test_a_nas_that_is_written_to_all_the_time_is_left_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root needs a mount for it")
    nas, mount = tmp_path / "nas", faults._mount
    nas.mkdir()
    with ExitStack() as written:

        def and_write(*arguments: str) -> None:
            mount(*arguments)
            if "--bind" in arguments:
                written.enter_context((nas / "open").open("w"))

        monkeypatch.setattr(faults, "_mount", and_write)
        monkeypatch.setattr(faults, "_MOUNT_TRIES", 2)
        with pytest.raises(FloraError, match="cannot be mounted"):
            faults._make_read_only(nas)
    assert not nas.is_mount()


def test_a_schedule_of_faults_strikes_and_passes(virtual_rig: Callable[..., VirtualRig]) -> None:
    rig = virtual_rig(seed=6)
    rig.start()
    rig.calibrate()
    plan = [parse_fault("flash_dead@0.2h:0.2h"), parse_fault("service_killed@0.3h=flora-stem")]
    schedule = FaultSchedule(rig, plan)
    rig.run(lambda seen: seen.tick is not None and seen.tick.time_s >= 0.75 * 3600, each=schedule)
    schedule.end_all()
    assert rig.restarts() == {"flora-stem": 1}
    confirmed = [frame.flash_confirmed for frame in rig.seen.frames if frame.purpose == "run"]
    assert False in confirmed
    assert confirmed[-1] is True
    finish_whole(rig)


def test_the_whole_menu_is_tried_here() -> None:
    tried = {
        *("camera_hangs", "torn_jpeg", "camera_knocked", "flash_dead", "lamp_command_lost", "clock_jumps"),
        *("bus_restarted", "service_killed", "nas_gone", "nas_read_only"),
    }
    assert set(MENU) == tried


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nas_gone", "write NAME@HOUR"),
        ("nas_gon@3h", "did you mean `nas_gone`?"),
        ("service_killed@3h", "name a service"),
        ("nas_gone@minus", "write NAME@HOUR"),
    ],
)
def test_a_fault_that_cannot_be_is_told_in_one_line(text: str, sentence: str) -> None:
    with pytest.raises(BadInput) as told:
        parse_fault(text)
    assert sentence in str(told.value)
    assert "\n" not in str(told.value)


def test_faults_are_read_as_written() -> None:
    planned = parse_fault("nas_gone@30h:6.5h")
    assert (planned.name, planned.at_h, planned.for_h) == ("nas_gone", 30.0, 6.5)
    assert parse_fault("service_killed@12=flora-led").argument == "flora-led"


@pytest.mark.parametrize(
    "plan",
    [
        ["nas_gone@1h:2h", "nas_gone@2h:2h"],
        ["nas_gone@1h", "nas_gone@2h"],
        ["nas_read_only@2h:1h", "nas_gone@1h:6h"],
        ["camera_hangs@1h:3h", "flash_dead@1h:1h", "camera_hangs@2h"],
        ["clock_jumps@1h:3h=60", "clock_jumps@2h=3600"],
    ],
)
def test_of_two_faults_of_one_thing_at_a_time_one_would_end_the_other(plan: list[str]) -> None:
    with pytest.raises(BadInput, match=r"would begin before \w+@1h has ended"):
        check_plan([parse_fault(text) for text in plan])


def test_faults_that_follow_each_other_or_are_of_different_things_may_be() -> None:
    plan = ["nas_gone@1h:2h", "nas_read_only@3h:2h", "flash_dead@1h:9h", "clock_jumps@1h=60", "clock_jumps@2h=3600"]
    check_plan([parse_fault(text) for text in [*plan, "bus_restarted@4h", "bus_restarted@4h"]])


def test_faults_that_follow_each_other_between_two_ticks_do_so_at_one(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    monkeypatch.setattr(faults, "begin", lambda rig, name, argument: done.append(f"{name} begins"))
    monkeypatch.setattr(faults, "end", lambda rig, name: done.append(f"{name} ends"))
    plan = [parse_fault("nas_gone@1h:0.01h"), parse_fault("nas_read_only@1.02h:0.01h")]
    schedule = FaultSchedule(cast(VirtualRig, None), plan)
    for hour in (0.95, 1.05, 1.15):
        schedule(Seen(tick=Tick(tick=1, time_s=3600.0 * hour)))
    assert done == ["nas_gone begins", "nas_gone ends", "nas_read_only begins", "nas_read_only ends"]
