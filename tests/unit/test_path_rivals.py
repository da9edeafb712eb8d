"""Another apex that has been as likely as the stem's end for some time."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.vision.path import apex_error, rivals
from flora_common.vision.path.guide import Way
from flora_common.vision.path.rivals import AT_FIRST, Rivals

SCALE = 20.0
TIP = np.array([100.0, 100.0])
HOOK = TIP + SCALE * np.array([-0.8, 0.3])


def way(tip_px: FloatArray, sure: float) -> Way:
    return Way(tip_px, sure, np.stack([np.array([100.0, 300.0]), tip_px]), np.full(2, 0.9))


def seen(before: Rivals | None, here: float, elsewhere: float, time_s: float) -> Rivals:
    return rivals.after(before, [way(TIP, here), way(HOOK, elsewhere)], TIP, time_s, SCALE)


@pytest.mark.parametrize(("elsewhere", "strong"), [(0.05, False), (0.11, False), (0.13, True), (0.4, True)])
def test_a_first_picture_is_judged_by_itself(elsewhere: float, strong: bool) -> None:
    assert seen(None, 0.3, elsewhere, 0.0).are_strong is strong


def test_one_picture_is_no_rival_and_an_hour_of_them_is() -> None:
    state = seen(None, 0.35, 0.05, 0.0)
    state = seen(state, 0.2, 0.35, 300.0)
    assert not state.are_strong
    for k in range(2, 14):
        state = seen(state, 0.2, 0.35, 300.0 * k)
    assert state.are_strong
    for k in range(14, 32):
        state = seen(state, 0.35, 0.05, 300.0 * k)
    assert not state.are_strong


@pytest.mark.parametrize("every_s", [300.0, 900.0, 3600.0])
def test_what_is_known_after_four_hours_hangs_little_on_how_often_pictures_came(every_s: float) -> None:
    state = seen(None, 0.35, 0.05, 0.0)
    for k in range(1, round(4 * 3600.0 / every_s) + 1):
        state = seen(state, 0.2, 0.3, every_s * k)
    assert (state.here, state.elsewhere) == pytest.approx((0.203, 0.295), abs=0.003)


def test_an_apex_near_the_end_is_the_same_and_none_at_all_counts_as_none() -> None:
    both = rivals.after(None, [way(TIP, 0.2), way(TIP + 0.55 * SCALE, 0.3)], TIP, 0.0, SCALE)
    # the second lies 0.78 cm away, along the diagonal
    assert (both.here, both.elsewhere) == (0.2, AT_FIRST * 0.3)
    near = rivals.after(None, [way(TIP, 0.2), way(TIP + 0.3 * SCALE, 0.3)], TIP, 0.0, SCALE)
    assert (near.here, near.elsewhere) == (0.3, 0.0)
    assert rivals.after(None, [], TIP, 0.0, SCALE) == Rivals(0.0, 0.0, 0.0, 0.0)


def test_the_tip_is_as_uncertain_as_a_place_that_is_either() -> None:
    state = seen(None, 0.3, 0.3 / AT_FIRST, 0.0)
    assert state.away_cm == pytest.approx(math.hypot(0.8, 0.3))
    assert state.tip_error_cm == pytest.approx(0.5 * state.away_cm)
    assert seen(None, 0.3, 0.1, 0.0).tip_error_cm == 0.0
    for k in range(1, 60):
        state = rivals.after(state, [way(TIP, 0.3)], TIP, 300.0 * k, SCALE)
    assert state.tip_error_cm == 0.0
    assert state.away_cm == pytest.approx(math.hypot(0.8, 0.3))  # of what there was


def test_a_way_that_leads_level_to_another_plant_is_no_rival() -> None:
    level = np.array([[100.0, 300.0], [60.0, 298.0], [30.0, 295.0], [28.0, 200.0]])
    beside = Way(level[-1], 0.4, level, np.full(4, 0.9))
    assert rivals.after(None, [beside, way(TIP, 0.3)], TIP, 0.0, SCALE).elsewhere == 0.0


def test_a_time_that_goes_back_changes_nothing() -> None:
    state = seen(None, 0.35, 0.05, 600.0)
    assert seen(state, 0.0, 0.9, 300.0).elsewhere == state.elsewhere


def test_the_top_of_a_hook_round_which_the_stem_goes_is_no_rival() -> None:
    round_it = np.array(
        [[100.0, 300.0], [100.0, 120.0], [110.0, 105.0], [125.0, 105.0], [133.0, 120.0], [133.0, 132.0]]
    )
    stem = Way(round_it[-1], 0.3, round_it, np.full(6, 0.9))
    faint = Way(round_it[-1], 0.3, round_it, np.array([0.9, 0.9, 0.9, 0.2, 0.2, 0.2]))
    top, known = way(round_it[2], 0.3), Rivals(0.0, 0.3, 0.0, 0.0)

    def later(before: Rivals | None, along: Way, tip_px: FloatArray) -> Rivals:
        return rivals.after(before, [along, top], tip_px, 36_000.0, SCALE)

    assert not later(known, stem, round_it[-1]).are_strong
    assert later(known, faint, round_it[-1]).are_strong
    assert later(known, stem, round_it[2]).are_strong  # where the top is followed, the end is a rival
    assert later(None, stem, round_it[-1]).are_strong  # nothing but this picture tells


HIDDEN, PLAIN = np.array([0.4, 0.3, 0.2, 0.1]), np.array([0.02, 0.01, 0.0, 0.0])


def looked(before: Rivals | None, off: FloatArray | None, time_s: float) -> Rivals:
    return rivals.after(before, [replace(way(TIP, 0.4), off=off)], TIP, time_s, SCALE)


def test_an_end_that_leaves_may_hide_is_hidden_until_it_has_looked_otherwise_for_some_time() -> None:
    state = looked(None, HIDDEN, 0.0)
    assert state.off == pytest.approx(HIDDEN)
    assert state.are_hidden
    assert state.tip_error_cm == pytest.approx(apex_error.error_cm(HIDDEN))
    for k in range(1, 12):
        state = looked(state, HIDDEN, 300.0 * k)
    assert state.off == pytest.approx(HIDDEN)
    state = looked(state, PLAIN, 3600.0)
    assert state.are_hidden
    for k in range(13, 24):
        state = looked(state, PLAIN, 300.0 * k)
    assert not state.are_hidden
    assert 0.0 < state.tip_error_cm < apex_error.error_cm(HIDDEN)
    assert not looked(None, PLAIN, 0.0).are_hidden


def test_the_first_looks_count_alike() -> None:
    """Else the first one would be most of the mean for an hour, however it came to look."""
    state = looked(None, PLAIN, 0.0)
    for k in range(1, 4):
        state = looked(state, HIDDEN, 60.0 * k)
    assert state.looks == 4
    assert state.off == pytest.approx(0.25 * PLAIN + 0.75 * HIDDEN)


def test_what_was_not_looked_at_or_lies_elsewhere_changes_nothing() -> None:
    assert looked(None, None, 0.0).off == (0.0,) * len(HIDDEN)
    state = looked(None, HIDDEN, 0.0)
    assert looked(state, None, 3600.0).off == state.off
    elsewhere = replace(way(HOOK, 0.4), off=PLAIN)
    assert rivals.after(state, [elsewhere, replace(way(TIP, 0.2), off=HIDDEN)], TIP, 3600.0, SCALE).are_hidden


def test_of_two_reasons_the_greater_error_counts() -> None:
    both = [replace(way(TIP, 0.3), off=HIDDEN), way(HOOK, 0.3 / AT_FIRST)]
    state = rivals.after(None, both, TIP, 0.0, SCALE)
    assert state.tip_error_cm == pytest.approx(max(0.5 * state.away_cm, apex_error.error_cm(HIDDEN)))
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(state), type=Rivals) == state
