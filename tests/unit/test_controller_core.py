"""The decision core: blind policy, once per tick, judgement, and what a restart must not change."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.controller_file import LoadedController, load_controller
from flora_common.light_plan import read_light_plan
from flora_common.messages import LightCommand, Stem
from flora_common.messages.catalogue import Outcome
from flora_common.network import Network
from flora_common.open_loop import OpenLoopSection
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_controller.core import ControllerCore, ControllerSection, usable_points
from flora_controller.evolved import Evolved
from flora_controller.lineup import Lineup
from flora_controller.record import Record, read_record, write_record
from flora_controller.source import built_in
from flora_controller.steering import OpenLoop, Planned, Steering

GOLDEN = Path(__file__).parent.parent / "golden" / "controllers" / "good"
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)


def stem(tick: int, x_cm: float = 0.0, y_cm: float = 10.0, *, outcome: Outcome = "ok", reason: str = "") -> Stem:
    points: FloatArray = np.linspace((0.0, 0.0), (x_cm, y_cm), 10)
    found = outcome in ("ok", "jumped", "touches_edge")
    return Stem(
        tick=tick,
        time_s=tick * 300.0,
        outcome=outcome,
        points_cm=tuple((float(x), float(y)) for x, y in points) if found else (),
        reason=reason,
    )


def core(use: str | Steering = "tip-follower", *, record: Record | None = None, **changes: object) -> ControllerCore:
    section = msgspec.convert({"use": use if isinstance(use, str) else "file"} | changes, ControllerSection)
    rule = built_in(section, TARGET, OBSTACLE) if isinstance(use, str) else use
    return ControllerCore(Lineup(rule), section, target=TARGET, obstacle=OBSTACLE, record=record or Record(run="r"))


def command(made: ControllerCore, heard: Stem) -> LightCommand:
    answer = made.on_stem(heard)
    assert answer is not None
    return answer[0]


def test_each_stem_brings_a_command_and_a_state_of_its_tick() -> None:
    answer = core().on_stem(stem(7, x_cm=1.0))

    assert answer is not None
    light, said = answer
    assert (light.tick, light.light, light.blind, said.tick, said.decisions) == (7, "left", False, 7, 1)
    assert said.controller == "tip-follower"
    assert said.tip_cm == (1.0, 10.0)
    assert said.fitness == said.best_fitness == pytest.approx(TARGET.fitness(1.0, 10.0))


@pytest.mark.parametrize("outcome", ["no_stem", "jumped", "occluded", "touches_edge", "bad_picture", "no_frame"])
def test_without_a_good_stem_the_last_light_is_held_and_then_the_schedule_runs(outcome: Outcome) -> None:
    made = core(blind_hold_ticks=3)
    assert command(made, stem(1, x_cm=-9.0)).light == "right"

    blind = [command(made, stem(tick, outcome=outcome, reason="why")) for tick in range(2, 7)]

    assert [c.light for c in blind] == ["right", "right", "right", "left", "left"]
    assert all(c.blind for c in blind)
    assert blind[0].reason == f"blind for 1 tick ({outcome}: why): the last light is held"
    assert blind[3].reason == f"blind for 4 ticks ({outcome}: why): open-loop schedule, every 6 h in turn"


def test_a_stem_that_is_found_again_ends_the_blindness() -> None:
    made = core(blind_hold_ticks=1)
    for tick in (1, 2, 3):
        command(made, stem(tick, outcome="no_stem"))

    seeing = command(made, stem(4, x_cm=-9.0))
    answer = made.on_stem(stem(5, outcome="no_stem"))

    assert (seeing.light, seeing.blind) == ("right", False)
    assert answer is not None
    assert (answer[0].light, answer[1].blind_ticks) == ("right", 1)


def test_blind_from_the_very_first_tick_means_the_schedule() -> None:
    first = command(core(), stem(1, outcome="no_stem"))

    assert (first.light, first.blind) == ("left", True)
    assert "open-loop schedule" in first.reason


def test_the_open_loop_needs_no_stem() -> None:
    light = command(core("open-loop"), stem(100, outcome="no_frame"))

    assert (light.light, light.blind) == ("right", False)


def test_a_light_plan_that_is_over_says_nothing_of_the_rule_after_it(tmp_path: Path) -> None:
    path = tmp_path / "short.lights.toml"
    path.write_text('schedule = "6h"\nhours = 0.5\n')
    made = core(Planned(read_light_plan(path)))
    for tick, is_over in ((4, False), (5, False), (6, True), (9, True)):  # five minutes apart
        answer = made.on_stem(stem(tick))
        assert answer is not None
        assert answer[1].run_over == is_over
    assert "the light plan's 0.5 h have passed" in answer[1].reason
    made.use(Lineup(OpenLoop(OpenLoopSection())))
    after = made.on_stem(stem(10))
    assert after is not None
    assert not after[1].run_over


def test_points_that_are_not_ten_are_no_stem() -> None:
    short = msgspec.structs.replace(stem(1), points_cm=((0.0, 0.0), (0.0, 9.0)))

    assert usable_points(short) is None
    assert command(core(), short).blind


def test_the_same_tick_again_is_answered_with_the_same_words_and_counts_once() -> None:
    made = core()
    first = made.on_stem(stem(1, x_cm=-9.0))

    again = made.on_stem(stem(1, x_cm=9.0))

    assert again == first
    assert made.record.decisions == 1


@pytest.mark.parametrize("tick", [0, 4])
def test_a_stem_of_an_earlier_tick_or_of_none_is_not_answered(tick: int) -> None:
    made = core()
    made.on_stem(stem(5))

    assert made.on_stem(stem(tick)) is None


def test_switches_and_decisions_are_counted() -> None:
    made = core()
    for tick, x in enumerate([-9.0, 9.0, 9.0, -9.0], start=1):
        answer = made.on_stem(stem(tick, x_cm=x))

    assert answer is not None
    assert (answer[1].switches, answer[1].decisions) == (2, 4)


def test_a_collision_is_remembered_with_its_time_and_ends_the_run_but_not_the_steering() -> None:
    made = core()
    made.on_stem(stem(1, x_cm=0.0, y_cm=10.0))
    made.on_stem(stem(2, x_cm=-6.0, y_cm=12.0))
    answer = made.on_stem(stem(3, x_cm=3.0, y_cm=12.0))

    assert answer is not None
    light, said = answer
    assert (said.collided, said.collided_at_s, said.clearance_cm, said.run_over) == (True, 600.0, 0.0, True)
    assert said.reason == "run over: the stem touched the obstacle at 0.2 h"
    assert (light.light, light.blind) == ("left", False)


def test_the_smallest_clearance_so_far_is_told() -> None:
    made = core()
    told = [made.on_stem(stem(tick, x_cm=x, y_cm=12.5)) for tick, x in enumerate([0.0, -1.8, 5.0], start=1)]

    clearances = [answer[1].clearance_cm for answer in told if answer]
    assert clearances[0] is not None
    assert clearances[1] == pytest.approx(1.0)
    assert clearances[0] > 2.0
    assert clearances[2] == clearances[1]


def test_the_height_of_the_paper_ends_the_run() -> None:
    made = core(stop_height_cm=21.0)

    below, above, sunk = (made.on_stem(stem(t, y_cm=y)) for t, y in ((1, 20.9), (2, 21.0), (3, 20.0)))

    assert below is not None
    assert above is not None
    assert sunk is not None
    assert [a[1].run_over for a in (below, above, sunk)] == [False, True, True]
    assert above[1].reason == "run over: the tip reached 21 cm at 0.2 h"


def test_the_target_counts_as_reached_from_then_on_and_the_best_fitness_stays() -> None:
    made = core()
    for tick, (x, y) in enumerate([(-5.0, 17.0), (5.0, 17.0)], start=1):
        answer = made.on_stem(stem(tick, x, y))

    assert answer is not None
    said = answer[1]
    assert said.target_reached
    assert said.fitness is not None
    assert said.best_fitness == pytest.approx(TARGET.fitness(-5.0, 17.0))
    assert said.fitness < 0.6


def test_a_note_is_told_with_the_state() -> None:
    answer = core().on_stem(stem(1), note="refused: x")

    assert answer is not None
    assert answer[1].reason == "refused: x"


# What a kill must not change


def test_going_on_from_the_record_is_as_if_never_killed(tmp_path: Path) -> None:
    file = tmp_path / "controller.json"
    whole, killed = core("waypoint"), core("waypoint")
    heights = np.linspace(8.0, 16.0, 40)
    for tick, y in enumerate(heights, start=1):
        heard = stem(tick, x_cm=0.4 * y, y_cm=float(y), outcome="no_stem" if tick % 7 == 0 else "ok")
        expected = whole.on_stem(heard)
        killed.on_stem(heard)
        write_record(file, killed.record)
        killed = core("waypoint", record=read_record(file, run="r")[0])
        assert killed.on_stem(heard) == expected
    assert killed.record == whole.record


def test_another_run_starts_anew(tmp_path: Path) -> None:
    made = core()
    made.on_stem(stem(1, x_cm=-6.0, y_cm=12.0))
    write_record(tmp_path / "controller.json", made.record)

    record, dropped = read_record(tmp_path / "controller.json", run="another")

    assert (record, dropped) == (Record(run="another"), "another run; starting anew")


@pytest.mark.parametrize(
    "damage", [b"", b"{", b"\xff", b'{"run": "r", "tick": "x"}', b'{"run": "r", "version": 9}', b"[" * 9999]
)
def test_a_damaged_record_is_dropped_and_told(tmp_path: Path, damage: bytes) -> None:
    file = tmp_path / "controller.json"
    file.write_bytes(damage)

    record, dropped = read_record(file, run="r")

    assert record == Record(run="r")
    assert "starting anew" in dropped


def test_another_controller_keeps_what_the_plant_did_and_drops_what_the_other_one_did() -> None:
    made = core("waypoint")
    made.on_stem(stem(1, x_cm=-6.0, y_cm=12.0))
    made.on_stem(stem(2, x_cm=3.0, y_cm=12.0))

    made.use(Lineup(built_in(ControllerSection(use="tip-follower"), TARGET, OBSTACLE)))

    record = made.record
    assert (record.decisions, record.switches, record.best_fitness, record.memory) == (0, 0, None, {})
    assert (record.tick, record.collided_at_s, record.light) == (2, 300.0, "right")


def test_a_run_under_the_name_of_the_one_before_is_steered_and_judged_by_itself() -> None:
    def again(tick: int) -> Stem:
        return msgspec.structs.replace(stem(tick, y_cm=3.0), time_s=300.0 * (tick - 3))

    before = core("waypoint")
    before.on_stem(stem(1, x_cm=-6.0, y_cm=12.0))
    before.on_stem(stem(2, x_cm=-5.1, y_cm=18.0))
    made, fresh = core("waypoint", record=before.record), core("waypoint")
    assert made.record.collided_at_s is not None

    for tick in (3, 4):
        assert made.on_stem(again(tick)) == fresh.on_stem(again(tick))

    assert made.record == fresh.record


# Networks


def evolved(**changes: object) -> Evolved:
    loaded = load_controller(GOLDEN / "tip_only.controller.json")
    if changes:
        loaded = LoadedController(loaded.file, changes["network"], loaded.sha256, loaded.data)  # type: ignore[arg-type]
    return Evolved(loaded, TARGET, OBSTACLE, "tip_only.controller.json")


def test_a_network_steers_by_the_papers_rule() -> None:
    made = core(evolved())

    # output = sigmoid(target_x - tip_x): at most 0.5 where the tip is right of the target
    right_of_it, left_of_it = command(made, stem(1, x_cm=-5.0)), command(made, stem(2, x_cm=-5.3))

    assert right_of_it.light == "left"
    assert left_of_it.light == "right"
    assert right_of_it.output == pytest.approx(1 / (1 + math.exp(5 * 0.12)))
    assert not right_of_it.blind


def test_a_network_with_nothing_behind_it_steers_on_outside_its_range() -> None:
    narrow = StemRange(
        left_cm=-1.0, right_cm=1.0, lowest_tip_cm=9.0, highest_tip_cm=11.0, shortest_cm=9.0, longest_cm=11.0
    )
    loaded = evolved().loaded
    ranged = LoadedController(
        msgspec.structs.replace(loaded.file, stem_range=narrow), loaded.network, loaded.sha256, loaded.data
    )
    made = core(Evolved(ranged, TARGET, OBSTACLE, "tip_only.controller.json"))

    assert [command(made, stem(tick, x_cm=9.0)).light for tick in range(1, 9)] == ["left"] * 8
    assert made.failures == []


def test_exactly_one_half_is_left() -> None:
    assert command(core(evolved()), stem(1, x_cm=-5.12)).light == "left"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("place", range(20))
def test_a_stem_that_is_no_number_never_reaches_the_lamps(bad: float, place: int) -> None:
    loaded = load_controller(GOLDEN / "neat_export.controller.json")
    made = core(Evolved(loaded, TARGET, OBSTACLE, "x"))
    flat = [0.1 * i for i in range(20)]
    flat[place] = bad
    points = tuple(zip(flat[::2], flat[1::2], strict=True))
    heard = Stem(tick=1, time_s=0.0, outcome="ok", points_cm=points)

    if abs(bad) == 1e308:  # the bus refuses it; the core must not rely on that
        decision = made.steering.decide(_view(points), {})
        assert decision.light is None
        assert "no answer" in decision.reason
    else:
        assert usable_points(heard) is None
        assert command(made, heard).blind


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
@pytest.mark.parametrize("field", ["x_cm", "y_cm", "left", "bottom"])
def test_a_task_that_is_no_number_never_reaches_the_lamps(bad: float, field: str) -> None:
    loaded = load_controller(GOLDEN / "neat_export.controller.json")
    target = Target(**({"x_cm": 1.0, "y_cm": 2.0} | ({field: bad} if field.endswith("cm") else {})))
    obstacle = Obstacle(bad if field == "left" else 1.0, bad if field == "bottom" else 2.0)

    decision = Evolved(loaded, target, obstacle, "x").decide(_view(tuple((0.0, float(i)) for i in range(10))), {})

    assert decision.light is None


class _Poisoned(Network):
    """A network whose memory went wrong after it was checked."""

    def activate(self, values: object) -> tuple[float, ...]:
        return (math.nan,)


def test_an_output_that_is_no_number_is_no_decision() -> None:
    good = load_controller(GOLDEN / "tip_only.controller.json").network
    made = core(evolved(network=_Poisoned(good.inputs, good.outputs, good.nodes)))

    light = command(made, stem(1))

    assert light.blind
    assert "the network has no answer: its output is nan" in light.reason


def _view(points: tuple[tuple[float, float], ...]) -> object:
    from flora_controller.steering import View

    return View(0.0, np.array(points), None)
