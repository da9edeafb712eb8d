"""A run beside what the law makes of its first stem: hourly means, late lights, cameras that are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose_runs import (
    LAMPS,
    LAW,
    QUIET,
    STEP_S,
    TYPICAL,
    Effects,
    change_of,
    levels_of,
    run_of,
    scene_of,
    stem,
    still,
    turns,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_lab.diagnose.record import without
from flora_lab.diagnose.scene import FEATURES, KNOT_H, USUAL, Answers, Lanes, Scene, late_light
from flora_lab.effects.effect import RUN_H, Change
from flora_lab.simulator.terms import ExtendedLaw
from flora_lab.simulator.tropism import LIGHT_HALF


def lanes(*changes: Change) -> Lanes:
    return Lanes(np.repeat(TYPICAL[None], len(changes), axis=0), np.zeros((len(changes), 2)), list(changes))


def ramp(step_s: float, hours: float) -> Scene:
    """A run in which every point moves steadily."""
    base = still(turns(hours, 4.0, step_s=step_s), step_s=step_s).run
    hour = base.time_s / 3600.0
    move = hour[:, None, None] * np.linspace(0.0, 1.0, 10)[:, None] * np.array([0.3, 0.2])
    return Scene(replace(base, points_cm=base.points_cm + move), LAW)


def told_as(scene: Scene) -> np.ndarray:
    """The features of stems that are where the measured ones are, at the times at which simulated stems are told."""
    every = scene.per_window * scene.windows // len(scene._told_h)
    rows = np.arange(every, scene.steps + 1, every)
    clean = ramp(scene.run.step_s, scene.run.hours).run.points_cm[rows, None]
    return scene.of_points(clean)[0]


# What the simulator has been extended with


EXTENDED: list[tuple[Effects, Effects]] = [
    ({}, {"sag": {"amplitude": 0.7}}),
    ({"sag": {"amplitude": 0.3}}, {"sag": {"amplitude": 0.7}}),
    ({"lamp_asymmetry": {"right_to_left": 0.8}}, {"lamp_asymmetry": {"right_to_left": 0.7}}),
    ({"adaptation": {"time_constant_h": 3.0, "floor": 0.4}}, {"draught": {"drive_per_cm_h": 0.1}}),
    ({"diurnal_growth": {"amplitude": 0.3, "peak_h": 7.0}}, {"phototropic_latency": {"delay_h": 0.5}}),
]


@pytest.mark.parametrize(("before", "found"), EXTENDED)
def test_an_extended_simulator_has_its_effects_beside_what_is_found(before: Effects, found: Effects) -> None:
    light = turns(24.0, 6.0)
    both = change_of({**found, **before})
    if "sag" in before:
        both = change_of({"sag": {"amplitude": 1.0}})
    if "lamp_asymmetry" in before:
        both = change_of({"lamp_asymmetry": {"right_to_left": 0.56}})
    plain = still(light)
    extended = Scene(plain.run, ExtendedLaw(LAMPS, change_of(before).terms))
    assert extended.simulated(lanes(change_of(found))) == pytest.approx(plain.simulated(lanes(both)), abs=1e-9)
    assert np.abs(extended.simulated(lanes(change_of(found))) - plain.simulated(lanes(Change()))).max() > 0.01


# What is compared


@pytest.mark.parametrize(("step_s", "hours"), [(300.0, 12.0), (600.0, 12.0), (1200.0, 12.0), (60.0, 3.0), (420.0, 9.0)])
def test_hourly_means_of_measured_and_simulated_stems_are_of_the_same_times(step_s: float, hours: float) -> None:
    scene = ramp(step_s, hours)
    assert scene.size == len(FEATURES) * scene.windows
    assert hours - 1.5 <= scene.windows * scene.per_window * step_s / 3600.0 <= hours
    assert scene.features == pytest.approx(told_as(scene), abs=1e-9)
    assert np.diff(scene.time_h) == pytest.approx(scene.per_window * step_s / 3600.0)
    assert scene.time_h[0] == pytest.approx(0.5, abs=0.11)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 140), st.integers(1, 30)), max_size=4))
def test_gaps_are_left_out_of_measured_and_simulated_means_alike(gaps: list[tuple[int, int]]) -> None:
    whole = ramp(STEP_S, 12.0)
    hidden = np.zeros(len(whole.run), dtype=np.bool_)
    for first, rows in gaps:
        hidden[first : first + rows] = True
    scene = Scene(without(whole.run, hidden), LAW)
    assert np.isfinite(scene.features).all()
    assert len(scene.features) == len(scene.window) == len(scene.feature) == scene.size
    # a row that is told stands for two others beside it: off by a step of five minutes at most
    assert np.abs(scene.features - told_as(scene)).max(initial=0.0) < 0.3 / 12.0 + 1e-9
    if not gaps:
        assert scene.size == whole.size


def test_an_hour_of_which_little_was_measured_is_not_compared() -> None:
    whole = ramp(STEP_S, 12.0)
    for rows, is_left in ((8, True), (11, False)):
        hidden = np.zeros(len(whole.run), dtype=np.bool_)
        hidden[2 + 36 : 2 + 36 + rows] = True  # the fourth hour
        scene = Scene(without(whole.run, hidden), LAW)
        assert (3 in scene.window) == is_left
        assert scene.size == whole.size - (0 if is_left else len(FEATURES))


@pytest.mark.parametrize("rows", [3, 7, 12, 13])
def test_a_run_shorter_than_an_hour_is_one_window(rows: int) -> None:
    scene = scene_of(1, light=turns(2.0, 1.0)[: rows - 1], chance=QUIET)
    assert scene.windows == 1
    assert scene.size == len(FEATURES)
    assert scene.simulated(lanes(Change()))[0] == pytest.approx(scene.features, abs=0.6)


def test_a_run_is_what_its_own_plant_does() -> None:
    scene = scene_of(3, traits=TYPICAL, chance={})
    assert scene.simulated(lanes(Change()))[0] == pytest.approx(scene.features, abs=0.1)
    other = scene.simulated(Lanes((TYPICAL + 0.3)[None], np.zeros((1, 2)), [Change()]))[0]
    assert np.abs(other - scene.features).max() > 0.5


def test_tips_are_measured_minus_simulated_and_unknown_in_gaps() -> None:
    run = run_of(3, traits=TYPICAL, chance={})
    hidden = np.zeros(len(run), dtype=np.bool_)
    hidden[50:60] = True
    scene = Scene(without(run, hidden), LAW)
    away, told = scene.tips(TYPICAL, np.zeros(2), Change())
    assert away.shape == told.shape == (scene.steps,)
    assert np.flatnonzero(np.isnan(away)).tolist() == list(range(49, 59))
    assert np.nanmax(np.abs(away)) < 0.1 < np.abs(told).max()
    leaning, _ = scene.tips(TYPICAL, np.array([0.05, 0.0]), Change())
    assert leaning[0] - away[0] == pytest.approx(-0.05 * 6.5, rel=0.2)  # what is simulated leans more to the right


def test_plants_side_by_side_are_as_if_alone() -> None:
    scene = still(turns(12.0, 4.0))
    changes = [
        Change(),
        change_of({"camera_roll": {"angle_deg": 4.0}, "clock_offset": {"offset_h": 0.4}}),
        change_of({"sag": {"amplitude": 1.0}, "camera_scale": {"factor": 1.1}}),
    ]
    together = scene.simulated(lanes(*changes))
    for own, change in zip(together, changes, strict=True):
        assert own.tobytes() == scene.simulated(lanes(change))[0].tobytes()


# Cameras


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    """To the right."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[cos, -sin], [sin, cos]])


@pytest.mark.parametrize(("turn_deg", "scale"), [(5.0, 1.0), (-4.0, 1.0), (0.0, 1.1), (3.0, 0.9)])
def test_a_rolled_and_wrongly_scaled_camera_shows_the_same_plant(turn_deg: float, scale: float) -> None:
    light, first = turns(12.0, 4.0), stem(6.5, 0.05)
    first[:, 0] += 0.2 * np.linspace(0.0, 1.0, 10) ** 2
    plain = still(light, first_cm=first)
    shown = still(light, first_cm=scale * turned(first, turn_deg))
    change = Change(turn_deg=turn_deg, scale=scale)
    right = plain.points(lanes(Change()), every=1)[:, 0, -1]
    assert np.abs(right[:, 0]).max() > 1.0
    told = shown.points(lanes(change), every=1)[:, 0, -1]
    # stems of another size are cut into other segments, and first stems are curves within 0.1 mm of the points
    assert told == pytest.approx(scale * turned(right, turn_deg), abs=0.01 if scale == 1.0 else 0.02)
    # lengths and lean of the first stem are told as the camera shows them
    assert shown.first - plain.first == pytest.approx([np.log(scale), np.radians(turn_deg)], abs=1e-3)


def test_a_camera_that_turns_slowly_shows_the_first_stem_rightly() -> None:
    scene = still(turns(12.0, 4.0))
    right = scene.points(lanes(Change()), every=1)[:, 0, -1]
    told = scene.points(lanes(Change(drift_deg=9.0)), every=1)[:, 0, -1]
    hours = (np.arange(len(right)) + 1) * STEP_S / 3600.0
    for row in (0, 50, len(right) - 1):
        assert told[row] == pytest.approx(turned(right[row], 9.0 * hours[row] / RUN_H), abs=1e-9)


# Lights


def seen(light: np.ndarray) -> np.ndarray:
    """What a plant sees of levels of light (Weber-Fechner)."""
    return np.log1p(light / LIGHT_HALF)


@given(st.integers(-20, 20), st.lists(st.sampled_from(["left", "right", "dark"]), min_size=2, max_size=60))
def test_a_clock_apart_by_whole_steps_is_a_shifted_schedule(by: int, names: list) -> None:
    light = levels_of(names)
    late = late_light(light, 1 / 12, by / 12, 0.0)
    rows = np.clip(np.arange(len(light)) - by, 0, len(light) - 1)
    assert late == pytest.approx(light[rows], abs=1e-9)


@settings(deadline=None)
@given(
    st.floats(-1.5, 1.5),
    st.floats(-0.05, 0.05),
    st.lists(st.sampled_from(["left", "right", "dark"]), min_size=12, max_size=80),
)
def test_late_light_is_what_is_seen_on_the_mean_of_what_shone_then(late_h: float, per_h: float, names: list) -> None:
    light, parts = levels_of(names), 200
    late = late_light(light, 1 / 12, late_h, per_h)
    assert late.shape == light.shape
    assert late.min() >= 0.0
    assert late.max() <= 1.0 + 1e-9
    # brute force: what shone at many moments of each step
    now = (np.arange(len(light) * parts) + 0.5) / parts / 12
    then = now - late_h - per_h * now
    rows = np.clip(np.floor(then * 12).astype(int), 0, len(light) - 1)
    mean = seen(light)[rows].reshape(len(light), parts, 2).mean(axis=1)
    assert seen(late) == pytest.approx(mean, abs=3.0 / parts * seen(np.ones(1))[0])


@given(st.floats(0.0, 1.0), st.integers(10, 50))
def test_no_light_is_lost_or_made_by_being_late(late_h: float, on: int) -> None:
    """A flash that lies well within the run is seen as much, however late."""
    light = levels_of(["dark"] * on + ["left"] * 5 + ["dark"] * 30)
    late = late_light(light, 1 / 12, late_h, 0.0)
    assert seen(late).sum(axis=0) == pytest.approx(seen(light).sum(axis=0))


def test_what_the_record_tells_of_after_the_last_step_is_seen_too() -> None:
    """The last hour of a run is not compared, but a plant whose clock is late has seen its lamps."""
    scene = still(np.concatenate([turns(24.0, 30.0, "left"), turns(1.0, 30.0, "right")]))
    assert scene.steps == 24 * 12
    assert (scene.light[:, 0] == 1.0).all()
    ahead = scene.shone(Change(late_h=-0.5))
    assert ahead.shape == scene.light.shape
    assert ahead[:-6, 0].min() == pytest.approx(1.0)
    assert ahead[-6:, 1].min() == pytest.approx(1.0)
    assert scene.lamps_known_until_h(Change(late_h=-0.5)) == pytest.approx(24.5)
    assert scene.lamps_known_until_h(Change(late_per_h=-0.25)) == pytest.approx(20.0)
    assert scene.lamps_known_until_h(Change()) == pytest.approx(25.0)


def test_a_run_up_to_some_time_compares_nothing_that_is_later() -> None:
    scene = still(turns(24.0, 4.0))
    cut = scene.up_to(20.5)
    assert cut.time_h[cut.window].max() == pytest.approx(19.5)
    told = scene.simulated(lanes(Change()))
    assert np.array_equal(cut.simulated(lanes(Change()))[0], told[0, scene.time_h[scene.window] < 20.0])
    assert np.array_equal(cut.features, scene.features[: cut.size])
    assert cut.size == len(cut.rows) == len(cut.feature) == cut.is_told.sum()
    assert np.isnan(cut.tips(TYPICAL, np.zeros(2), Change())[0][round(20.5 * 12) :]).all()
    assert scene.up_to(np.inf).size == scene.size > cut.size


def test_a_clock_that_is_right_changes_no_bit() -> None:
    light = turns(6.0, 1.0)
    assert late_light(light, 1 / 12, 0.0, 0.0) is light


# How runs answer chance


def answers(scene: Scene) -> Answers:
    return scene.answers(TYPICAL, Change())


def test_answers_have_a_column_for_every_knot() -> None:
    scene = scene_of(2, hours=12.0)
    told = answers(scene)
    for name, knot_h in KNOT_H.items():
        knots = round(scene.steps * scene.step_h / knot_h)
        assert told.to[name].shape == (scene.size, knots)
        assert told.at_h[name].shape == (knots,)
        assert np.diff(told.at_h[name]) == pytest.approx(knot_h)
    assert told.length_cm.shape == told.at_h["bias"].shape
    assert (np.diff(told.length_cm) >= 0.0).all()
    assert told.length_cm[0] == pytest.approx(6.5, rel=0.2)


def test_nothing_is_answered_before_it_happens() -> None:
    scene = scene_of(2, hours=12.0)
    told = answers(scene)
    for name, answer in told.to.items():
        for knot, at_h in enumerate(told.at_h[name]):
            before = scene.time_h[scene.window] < at_h - 0.5 * KNOT_H[name] - 0.5
            assert not answer[before, knot].any()
            if at_h < 10.0:
                assert np.abs(answer[:, knot]).max() > 0.0


@pytest.mark.parametrize(("name", "size"), [("bias", 0.005), ("gradient", 0.005), ("growth", 0.05), ("gain", 0.05)])
def test_answers_tell_what_a_small_push_does(name: str, size: float) -> None:
    scene = scene_of(2, hours=12.0)
    told = answers(scene)
    rng = np.random.default_rng(1)
    knots = size * rng.standard_normal(len(told.at_h[name]))
    course = np.repeat(knots, round(KNOT_H[name] / scene.step_h))[: scene.steps, None]
    drives = {name: USUAL[name] + course}
    base, pushed = (scene.of_points(scene.points(lanes(Change()), d))[0] for d in ({}, drives))
    moved = pushed - base
    assert np.abs(moved).max() > 0.005
    assert np.abs(moved - told.to[name] @ knots).max() < 0.1 * np.abs(moved).max()


@pytest.mark.parametrize("lean_deg", [0.0, 30.0, -60.0])
def test_a_leaning_tip_swings_sideways_by_a_part(lean_deg: float) -> None:
    scene = still(turns(3.0, 1.0), first_cm=stem(10.0, np.radians(lean_deg)))
    assert scene.sideways == pytest.approx(np.cos(np.radians(lean_deg)) ** 2)
