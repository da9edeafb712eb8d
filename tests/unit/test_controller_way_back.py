"""One that was offered and fails, flickers or leaves its range is given up, and the one before it steers again."""

from __future__ import annotations

from pathlib import Path

import pytest

from controller_rig import FIRST, LEFT_OF_IT, RIGHT_OF_IT, Rig, diverging, tip_only
from flora_common.messages import Stem
from flora_controller.shadow import MOST_SWITCHES_PER_H

RANGE = {"left_cm": -8.0, "right_cm": 8.0, "lowest_tip_cm": 6.0, "highest_tip_cm": 18.0} | {
    "shortest_cm": 6.5,
    "longest_cm": 20.0,
}
INSIDE, FAR_LEFT = -10.9, -12.0
"""Tips of 2.9 and 4.0 cm beyond that range, where 3 cm are allowed."""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def flicker(rig: Rig, first_tick: int, ticks: int) -> list[str]:
    """Tips that jump from side to side, so that whoever follows them flickers; who steered at each tick."""
    sides = (RIGHT_OF_IT, LEFT_OF_IT)
    return [rig.tick(first_tick + i, sides[i % 2])[1].controller for i in range(ticks)]


# In shadow


def test_one_that_has_no_answer_in_shadow_never_shines(rig: Rig) -> None:
    rig.offer(diverging(serial=1), shadow_ticks=3)
    rig.tick(1, 0.0)
    command, said = rig.tick(2, 4.0)
    names = [rig.tick(number, 0.0)[1].controller for number in (3, 4, 5)]

    assert rig.answers[-1].stage == "returned"
    assert "in its shadow time: the network has no answer" in rig.answers[-1].reason
    assert said.reason.startswith("gave up `diverging` in its shadow time")
    assert (command.blind, said.shadow) == (False, "")
    assert names == ["tip-follower"] * 3


def test_one_that_flickers_in_shadow_never_shines(rig: Rig) -> None:
    rig.offer(FIRST, shadow_ticks=100)
    names = flicker(rig, 1, MOST_SWITCHES_PER_H + 2)

    assert set(names) == {"tip-follower"}
    assert rig.answers[-1].stage == "returned"
    assert "it switched 11 times within an hour, at most 10 are allowed" in rig.answers[-1].reason


def test_one_whose_stem_is_outside_its_range_in_shadow_never_shines(rig: Rig) -> None:
    rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE), shadow_ticks=9)
    told = [rig.tick(number, FAR_LEFT)[1] for number in range(1, 12)]

    assert {t.controller for t in told} == {"tip-follower"}
    assert [t.shadow for t in told[:3]] == ["ranged", "ranged", ""]
    assert rig.answers[-1].stage == "returned"
    assert "in its shadow time: 3 stems in a row were outside its range" in rig.answers[-1].reason


# While it steers


def test_one_without_an_answer_is_given_up_in_the_same_tick(rig: Rig) -> None:
    rig.offer(FIRST)
    rig.offer(diverging(serial=2))
    _, good = rig.tick(1, 0.0)
    command, said = rig.tick(2, 4.0)
    _, later = rig.tick(3, 0.0)

    assert (good.controller, said.controller, later.controller) == ("diverging", "first", "first")
    assert (command.light, command.blind) == ("left", False)
    assert "gave up `diverging` while it steered: the network has no answer" in said.reason
    assert "gave up `diverging`" in later.reason
    assert (rig.answers[-1].stage, rig.answers[-1].steers) == ("returned", "first")


def test_one_that_flickers_is_given_up_in_the_tick_that_is_too_much(rig: Rig) -> None:
    rig.offer(FIRST)
    names = flicker(rig, 1, MOST_SWITCHES_PER_H + 3)

    # The first decision is no switch; the eleventh switch is one too many.
    assert names == ["first"] * (MOST_SWITCHES_PER_H + 1) + ["tip-follower"] * 2
    assert rig.answers[-1].stage == "returned"


def test_as_many_switches_over_a_longer_time_are_no_flicker(rig: Rig) -> None:
    rig.offer(FIRST)
    sides = (RIGHT_OF_IT, RIGHT_OF_IT, LEFT_OF_IT, LEFT_OF_IT)
    names = {rig.tick(number, sides[number % 4])[1].controller for number in range(1, 100)}

    assert names == {"first"}


def test_the_limit_is_the_operators(tmp_path: Path) -> None:
    rig = Rig(tmp_path, most_switches_per_h=2)
    rig.offer(FIRST)

    assert flicker(rig, 1, 5) == ["first"] * 3 + ["tip-follower"] * 2


def test_a_restart_does_not_forget_the_switches_of_the_last_hour(rig: Rig) -> None:
    rig.offer(FIRST)
    names = []
    for number in range(1, MOST_SWITCHES_PER_H + 4):
        names += flicker(rig, number, 1) if number % 2 else [rig.tick(number, LEFT_OF_IT)[1].controller]
        rig.start()

    assert names == ["first"] * (MOST_SWITCHES_PER_H + 1) + ["tip-follower"] * 2


def test_one_whose_stem_has_left_its_range_is_given_up_at_the_third_such_stem(rig: Rig) -> None:
    rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE))
    told = [rig.tick(number, x)[1] for number, x in enumerate([INSIDE, FAR_LEFT, FAR_LEFT, FAR_LEFT, INSIDE], start=1)]

    assert [t.controller for t in told] == ["ranged"] * 3 + ["tip-follower"] * 2
    said = (
        "while it steered: 3 stems in a row were outside its range, this one 4.0 cm farther left than any that it was "
    )
    said += "evolved with; at most 2 are allowed"
    assert told[3].reason == told[4].reason == f"gave up `ranged` {said}"
    assert [(a.stage, a.steers, a.reason) for a in rig.answers[-1:]] == [("returned", "tip-follower", said)]


def test_the_one_before_decides_the_very_tick(rig: Rig) -> None:
    rig.offer(tip_only(serial=1, stem_range=RANGE))
    for number in (1, 2):
        rig.tick(number, FAR_LEFT)
    command, said = rig.tick(3, FAR_LEFT)

    assert (command.light, command.blind, said.controller, said.decisions) == ("right", False, "tip-follower", 1)


def test_a_wrong_reading_or_two_change_nothing(rig: Rig) -> None:
    rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE))
    tips = [INSIDE, FAR_LEFT, INSIDE, FAR_LEFT, FAR_LEFT] * 4
    assert {rig.tick(number, x)[1].controller for number, x in enumerate(tips, start=1)} == {"ranged"}


def test_a_tick_without_a_stem_is_neither_inside_nor_outside(rig: Rig) -> None:
    rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE))
    tips = [FAR_LEFT, None, None, FAR_LEFT, None, FAR_LEFT]
    names = [rig.tick(number, x)[1].controller for number, x in enumerate(tips, start=1)]

    assert names == ["ranged"] * 5 + ["tip-follower"]


def test_margin_and_patience_are_the_operators(tmp_path: Path) -> None:
    rig = Rig(tmp_path, range_margin_cm=4.5, most_ticks_outside=4)
    rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE))

    assert {rig.tick(number, FAR_LEFT)[1].controller for number in range(1, 9)} == {"ranged"}
    assert [rig.tick(number, -13.0)[1].controller for number in range(9, 15)] == ["ranged"] * 4 + ["tip-follower"] * 2


def test_a_file_without_a_range_is_not_judged_by_it(rig: Rig) -> None:
    rig.offer(FIRST)
    assert {rig.tick(number, 40.0)[1].controller for number in range(1, 9)} == {"first"}


def test_growing_past_the_end_of_the_run_is_no_leaving(tmp_path: Path) -> None:
    for stop_height_cm, name in ((25.0, "ranged"), (40.0, "tip-follower")):
        rig = Rig(tmp_path / name, stop_height_cm=stop_height_cm)
        rig.offer(tip_only(serial=1, name="ranged", stem_range=RANGE))
        told = [rig.tick(number, 0.0, 26.0)[1] for number in range(1, 5)]
        assert told[-1].controller == name
        assert told[-1].run_over == (name == "ranged")
    assert "8.0 cm higher than any that it was evolved with" in told[-1].reason


def test_where_each_that_was_offered_is_outside_its_range_the_configured_one_steers_at_last(rig: Rig) -> None:
    for serial in (1, 2):
        rig.offer(tip_only(serial=serial, name=f"ranged {serial}", stem_range=RANGE))
    names = [rig.tick(number, FAR_LEFT)[1].controller for number in range(1, 7)]

    # the one behind begins to count when it is asked, in the tick in which the other one is given up
    assert names == ["ranged 2"] * 2 + ["ranged 1"] * 2 + ["tip-follower"] * 2


def test_a_restart_does_not_forget_the_stems_outside_nor_who_was_given_up(rig: Rig) -> None:
    ranged = tip_only(serial=1, name="ranged", stem_range=RANGE)
    rig.offer(ranged)
    names = []
    for number in range(1, 5):
        names.append(rig.tick(number, FAR_LEFT)[1].controller)
        rig.start()
    again = rig.offer(ranged)

    assert names == ["ranged"] * 2 + ["tip-follower"] * 2
    assert again.stage == "refused"
    assert "this rig gave it up before, while it steered: 3 stems in a row were outside its range" in again.reason
    assert rig.offer(tip_only(serial=2, stem_range=RANGE)).stage == "steering"


def test_a_controller_that_was_given_up_does_not_come_back_by_itself(rig: Rig) -> None:
    bad = diverging(serial=1)
    rig.offer(bad)
    rig.tick(1, 4.0)
    rig.start()

    again = rig.offer(bad)
    _, said = rig.tick(2, 0.0)
    signed_anew = rig.offer(diverging(serial=2))

    assert (again.stage, said.controller) == ("refused", "tip-follower")
    assert "this rig gave it up before" in again.reason
    assert "sign it again to try it again" in again.reason
    assert "gave up `diverging`" in said.reason
    assert signed_anew.stage == "steering"
    assert rig.succession.note == ""


def test_where_all_that_was_offered_fails_the_configured_one_steers(rig: Rig) -> None:
    rig.offer(diverging(serial=1))
    rig.offer(diverging(serial=2))
    command, said = rig.tick(1, 4.0)

    assert said.controller == "tip-follower"
    assert not command.blind
    assert [a.stage for a in rig.answers][-2:] == ["returned", "returned"]


def test_the_configured_controller_is_never_given_up(rig: Rig) -> None:
    assert set(flicker(rig, 1, 40)) == {"tip-follower"}


def test_a_blind_tick_is_nobodys_failure(rig: Rig) -> None:
    rig.offer(FIRST)
    blind = Stem(tick=1, time_s=300.0, outcome="no_stem")
    rig.core.on_stem(blind)

    assert rig.core.failures == []
    assert rig.tick(2)[1].controller == "first"
