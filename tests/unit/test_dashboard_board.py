"""What the page shows: the run's course, what is worth knowing, which photograph with which stem, and only that one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from flora_common.clock import NS
from flora_common.errors import BadRunFolder
from flora_common.messages import (
    ControllerState,
    Departure,
    DiagnosisFound,
    Frame,
    FrameMissed,
    Health,
    JobProgress,
    Lamps,
    LightCommand,
    Message,
    Setup,
    Stem,
    Stored,
    Tick,
)
from flora_common.runs import CameraSection, ObstacleSection, RunFile, RunFolder, TargetSection
from flora_common.shapes import Target
from flora_dashboard.board import Board, View, as_json
from flora_dashboard.history import History, Row
from flora_dashboard.photographs import NotThere, Photographs

TARGET = Target(-5.12, 17.9)
RUN = RunFile(
    camera=CameraSection((800.0, 1000.0), 18.0),
    plant="bean 7",
    target=TargetSection(-5.12, 17.9),
    obstacle=ObstacleSection(-6.3, 12.5),
)


@dataclass
class FixedClock:
    """Rig time that stands where it is put."""

    s: float = 1000.0

    def mono_ns(self) -> int:
        return round(self.s * NS)

    def utc_ns(self) -> int:
        return self.mono_ns()

    def observe(self, mono_ns: int, utc_ns: int) -> None: ...

    def sleep(self, rig_s: float) -> None: ...


class Shown:
    """A board, fed by hand."""

    def __init__(self, run_file: RunFile | None = RUN, without: str = "") -> None:
        self.clock = FixedClock()
        target = run_file.target_or_none() if run_file else None
        self.board = Board(
            "box1",
            "bean-01",
            run_file,
            without,
            clock=self.clock,  # type: ignore[arg-type]
            history=History(target),
            health_every_s=10.0,
            ages_are_known=True,
        )

    def hear(self, *messages: Message) -> Shown:
        for message in messages:
            stamped = msgspec.structs.replace(message, t_mono_ns=self.clock.mono_ns())
            self.board.hear(stamped, real_s=self.clock.s, is_live=True)
        return self

    def all_ready(self) -> Shown:
        names = [service.name for service in self.view().services]
        return self.hear(*(Health(source=name, state="ready") for name in names))

    def view(self, *, is_connected: bool = True) -> View:
        return self.board.view(real_s=self.clock.s, is_connected=is_connected)

    def texts(self, level: str) -> list[str]:
        return [one.text for one in self.view().concerns if one.level == level]


def frame(tick: int, **changes: Any) -> Frame:
    fields: dict[str, Any] = {
        "tick": tick,
        "time_s": 300.0 * tick,
        "path": f"frames/{tick:06}.jpg",
        "run": "bean-01",
        "sha256": f"{tick:064x}",
        "bytes": 100,
        "width_px": 1640,
        "height_px": 1232,
        "light": "left",
        "flash_confirmed": True,
        "exposure_ok": True,
    }
    return Frame(**(fields | changes))


def stem(tick: int, **changes: Any) -> Stem:
    points = tuple((-0.1 * i, 1.0 * i) for i in range(10))
    fields: dict[str, Any] = {
        "tick": tick,
        "time_s": 300.0 * tick,
        "outcome": "ok",
        "points_cm": points,
        "light": "left",
        "frame_sha256": f"{tick:064x}",
    }
    return Stem(**(fields | changes))


# The course of the run


def test_each_stem_is_a_row_and_one_that_is_told_twice_is_one() -> None:
    history = History(TARGET)
    lost = stem(3, outcome="occluded", points_cm=())
    for message in (stem(1), stem(2), stem(2), stem(1), lost):
        history.hear(message)
    assert history.since(0).rows == [
        Row(300.0, "left", "ok", -0.9, 9.0, TARGET.fitness(-0.9, 9.0)),
        Row(600.0, "left", "ok", -0.9, 9.0, TARGET.fitness(-0.9, 9.0)),
        Row(900.0, "left", "occluded"),
    ]
    assert as_json(history.since(2)) == b'{"begin":2,"rows":[[900.0,"left","occluded",null,null,null]]}'
    assert history.since(7).rows == []


def test_a_target_at_the_anchor_has_no_fitness() -> None:
    history = History(Target(0.0, 0.0))
    history.hear(stem(1))
    assert history.since(0).rows == [Row(300.0, "left", "ok", -0.9, 9.0, None)]


def test_the_oldest_rows_go_and_numbers_stay() -> None:
    history = History(None, most=40)
    for tick in range(1, 101):
        history.hear(stem(tick))
        assert history.end == tick
        assert history.end - history.begin <= 40
    kept = history.since(0)
    assert kept.begin == history.begin >= 60
    assert [row.time_s for row in kept.rows] == [300.0 * (n + 1) for n in range(kept.begin, 100)]
    assert [row.time_s for row in history.since(98).rows] == [29_700.0, 30_000.0]


def test_what_was_measured_before_the_start_is_read_from_the_track(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    for tick in (1, 2, 3):
        run.append_track(300.0 * tick, "right", stem(tick).points_cm)
    history = History(TARGET)
    history.read(run)
    history.hear(stem(3))
    history.hear(stem(4))
    assert [(row.time_s, row.light) for row in history.since(0).rows] == [
        (300.0, "right"),
        (600.0, "right"),
        (900.0, "right"),
        (1200.0, "left"),
    ]
    assert history.since(0).rows[0].fitness == TARGET.fitness(-0.9, 9.0)


def test_a_track_that_is_damaged_keeps_the_rows_before_the_damage(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    for tick in (1, 2):
        run.append_track(300.0 * tick, "right", stem(tick).points_cm)
    run.track_csv.write_text(run.track_csv.read_text() + "900.0,right,1.0\n")
    history = History(TARGET)
    with pytest.raises(BadRunFolder, match="line 4"):
        history.read(run)
    assert history.end == 2


def test_a_run_that_has_no_track_yet_begins_with_no_rows(tmp_path: Path) -> None:
    history = History(TARGET)
    history.read(RunFolder(tmp_path))
    assert history.end == 0


# A photograph and its stem


def test_a_picture_takes_the_place_of_the_one_before_when_it_is_measured() -> None:
    shown = Shown()
    assert (shown.view().photograph, shown.view().is_measured) == (None, False)
    assert shown.hear(frame(1)).view().photograph == frame(1, t_mono_ns=shown.clock.mono_ns())
    assert not shown.view().is_measured
    for message, tick, is_measured in (
        (stem(1), 1, True),
        (frame(2), 1, True),
        (frame(2), 1, True),
        (stem(2), 2, True),
    ):
        view = shown.hear(message).view()
        assert view.photograph is not None
        assert (view.photograph.tick, view.is_measured) == (tick, is_measured)


def test_a_picture_that_nobody_measures_is_shown_when_the_next_is_there() -> None:
    view = Shown().hear(frame(1), stem(1), frame(2), frame(3)).view()
    assert view.photograph is not None
    assert (view.photograph.tick, view.is_measured) == (3, False)


def test_pictures_of_the_empty_setup_are_not_shown() -> None:
    assert Shown().hear(frame(1, purpose="background")).view().photograph is None


# What is worth knowing


def test_where_all_is_well_nothing_is() -> None:
    shown = Shown().hear(Tick(tick=4, time_s=1200.0), frame(4), stem(4), Lamps(lit="left", commanded="left"))
    view = shown.all_ready().view()
    assert view.concerns == []
    assert all(service.ok for service in view.services)


@pytest.mark.parametrize(
    ("message", "level", "words"),
    [
        (
            Health(source="flora-stem", state="degraded", reason="too slow"),
            "problem",
            "flora-stem is degraded: too slow",
        ),
        (FrameMissed(tick=5, time_s=1.0, because="camera_hung", reason="no answer"), "problem", "camera hung"),
        (frame(5, exposure_ok=False, exposure_note="gain 1.2"), "problem", "gain 1.2"),
        (frame(5, flash_confirmed=False), "problem", "without a confirmed flash"),
        (stem(4, outcome="occluded", reason="a leaf"), "notice", "(occluded): a leaf"),
        (Stored(stage="refused", path="a.jpg", reason="torn"), "problem", "a.jpg was refused by the NAS: torn"),
        (Lamps(lit="left", commanded="dark", fallback=True), "problem", "by the fallback, the left lamp shines"),
        (Lamps(lit="dark", commanded="right"), "problem", "the right lamp is commanded, no lamp shines"),
        (LightCommand(light="left", blind=True, reason="no stem"), "problem", "without a stem. no stem"),
        (ControllerState(controller="a", collided=True, collided_at_s=7200.0), "problem", "obstacle at hour 2.0"),
        (ControllerState(controller="a", target_reached=True, best_fitness=0.987), "good", "Best fitness 98.7 %"),
        (ControllerState(controller="a", run_over=True, reason="21 cm high"), "notice", "The run is over: 21 cm high"),
        (
            ControllerState(controller="a", run_over=True, reason="run over: a wall"),
            "notice",
            "The run is over: a wall",
        ),
        (ControllerState(controller="a", shadow="b", shadow_ticks_left=3), "notice", "b runs in shadow, 3 ticks"),
        (Setup(active=True, step=2, steps=8), "notice", "step 2 of 8"),
        (Departure(run="bean-01", is_departed=True, sentence="9 mm to the right"), "problem", "9 mm to the right"),
        (
            JobProgress(job="0" * 16, work="evolve", stage="failed", text="no simulator"),
            "notice",
            "(evolve) failed: no simulator",
        ),
        (DiagnosisFound(run="bean-00", verdict="explained", sentence="It sags."), "notice", "bean-00: It sags."),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Message) else None,
)
def test_each_trouble_is_told_in_a_sentence(message: Message, level: str, words: str) -> None:
    shown = Shown().hear(Tick(tick=4, time_s=1200.0), frame(4), stem(4)).all_ready()
    assert shown.view().concerns == []
    (told,) = shown.hear(message).view().concerns
    assert (told.level, words.lower() in told.text.lower()) == (level, True), told.text


def test_what_is_of_another_run_or_is_over_is_not_told() -> None:
    shown = Shown().hear(Tick(tick=4, time_s=1200.0), FrameMissed(tick=3, time_s=1.0, because="camera_gone", reason=""))
    shown.hear(
        frame(4), stem(4), Departure(run="bean-00", is_departed=True), Departure(run="bean-01", is_departed=False)
    )
    assert shown.all_ready().view().concerns == []


def test_what_a_service_says_itself_is_told_once() -> None:
    shown = Shown().hear(Tick(tick=5, time_s=1500.0), frame(4), stem(5, outcome="no_frame", points_cm=())).all_ready()
    shown.hear(
        FrameMissed(tick=5, time_s=1500.0, because="camera_hung", reason="no answer"),
        LightCommand(light="left", blind=True),
        Lamps(lit="left", commanded="dark", fallback=True),
        Stored(stage="refused", path="a.jpg"),
    )
    assert len(shown.texts("problem")) == 4
    for name in ("flora-capture", "flora-controller", "flora-led", "flora-uploader"):
        shown.hear(Health(source=name, state="degraded", reason="its own words"))
    assert shown.texts("problem") == [
        f"{name} is degraded: its own words"
        for name in ("flora-capture", "flora-controller", "flora-led", "flora-uploader")
    ]


def test_silence_is_told() -> None:
    shown = Shown().hear(Tick(tick=1, time_s=300.0), frame(1), stem(1)).all_ready()
    shown.clock.s += 751.0
    problems = shown.texts("problem")
    assert "No beat for 13 min; one is due every 5 min." in problems
    assert any(text.startswith("flora-led is silent") for text in problems)
    assert shown.view(is_connected=False).concerns[0].text.startswith("No bus answers")
    assert not shown.view().last["tick"].is_fresh


def test_a_setup_run_that_fell_silent_hides_no_silence() -> None:
    shown = Shown().hear(Tick(tick=1, time_s=300.0), frame(1), stem(1), Setup(active=True, step=2, steps=8)).all_ready()
    assert any("step 2 of 8" in text for text in shown.texts("notice"))
    shown.clock.s += 751.0
    assert not any("step 2 of 8" in text for text in shown.texts("notice"))
    assert "No beat for 13 min; one is due every 5 min." in shown.texts("problem")


def test_the_worst_comes_first_and_a_run_without_its_file_before_all() -> None:
    shown = Shown(None, "no run.toml").hear(
        Tick(tick=1, time_s=300.0),
        stem(1, outcome="jumped"),
        ControllerState(controller="a", target_reached=True, collided=True),
    )
    view = shown.all_ready().view()
    assert [one.level for one in view.concerns] == ["problem", "problem", "notice", "good"]
    assert view.concerns[0].text == "no run.toml"
    assert (view.camera, view.target, view.interval_s) == (None, None, 300.0)


def test_a_view_is_one_line_of_json_with_all_that_a_page_needs() -> None:
    text = as_json(
        Shown().hear(Tick(tick=1, time_s=300.0), frame(1), stem(1), Lamps(lit="left", commanded="left")).view()
    )
    assert b"\n" not in text
    told = msgspec.json.decode(text)
    assert told["format"] == "flora-dashboard-1"
    assert told["last"]["lamps"]["message"]["lit"] == "left"
    assert told["camera"]["px_per_cm"] == 18.0
    assert told["photograph"]["tick"] == 1
    assert told["rows_end"] == 1


# Photographs


def announced(folder: Path, data: bytes = b"a photograph", path: str = "frames/1.jpg") -> Frame:
    place = folder / path
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(data)
    return frame(1, path=path, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def test_only_what_was_announced_is_given_and_only_while_it_is_that(tmp_path: Path) -> None:
    photographs = Photographs(tmp_path)
    one = announced(tmp_path)
    with pytest.raises(NotThere, match="announced"):
        photographs.read(one.sha256)
    photographs.announce(one)
    assert photographs.read(one.sha256) == b"a photograph"
    for other in (b"another file", b"longer than what was announced"):
        (tmp_path / one.path).write_bytes(other)
        with pytest.raises(NotThere, match="not the file"):
            photographs.read(one.sha256)
    (tmp_path / one.path).unlink()
    with pytest.raises(NotThere, match="cannot be read"):
        photographs.read(one.sha256)


def test_a_link_out_of_the_run_folder_is_not_followed(tmp_path: Path) -> None:
    run, photographs = tmp_path / "run", Photographs(tmp_path / "run")
    one = announced(tmp_path, path="secret.jpg")
    (run / "frames").mkdir(parents=True)
    (run / "frames" / "1.jpg").symlink_to(tmp_path / "secret.jpg")
    photographs.announce(msgspec.structs.replace(one, path="frames/1.jpg"))
    with pytest.raises(NotThere, match="does not lie in the run folder"):
        photographs.read(one.sha256)


def test_a_few_are_remembered(tmp_path: Path) -> None:
    photographs = Photographs(tmp_path)
    frames = [announced(tmp_path, f"picture {n}".encode(), f"frames/{n}.jpg") for n in range(6)]
    for one in (*frames, frames[-1]):
        photographs.announce(one)
    for one in frames[2:]:
        assert photographs.read(one.sha256)
    for one in frames[:2]:
        with pytest.raises(NotThere):
            photographs.read(one.sha256)
