"""Worlds with hidden effects: the same from the same seed, like plants, and each effect does what it says."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from discovery.worlds import other, rod
from discovery.worlds.case import ALL_EFFECTS, Hidden, believed_lamps, draw_case, named_mm
from discovery.worlds.effects import CATALOGUE, INSEPARABLE, ratio
from discovery.worlds.kernel import CLOSED_LOOP
from discovery.worlds.outside import ON_REQUEST, OUTSIDE, RHYTHMIC
from discovery.worlds.record import recorded
from discovery.worlds.scene import ROW_S, Scene
from discovery.worlds.schedules import draw_schedule
from discovery.worlds.writing import write_case
from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.geometry import polyline_length, resample_by_height
from flora_common.runs import RunFolder
from flora_common.tracks import Track, read_track

ROOT = Path(__file__).resolve().parents[2]
ROWS_PER_H = 12
FORMS = (0, 1)


def quiet(form: int, hours: float = 36.0, effect: str = "", dwell_h: float = 6.0, **parameters: float) -> Scene:
    """The typical plant without chance, under regular turns that begin on the left, with an effect."""
    laws, plant = rod.laws_and_plant() if form == 0 else other.laws_and_plant(np.random.default_rng(4))
    hour = np.arange(round((hours + 4.0) * ROWS_PER_H)) / ROWS_PER_H
    scene = Scene(plant, laws, (hour // dwell_h).astype(np.int64) % 2, hours, camera_cm=75.0 if form else 0.0)
    steps = np.arange(len(scene.series) + 1)
    scene.temperature_c = 22.0 + 3.0 * np.cos(2.0 * np.pi * (steps / 24.0 - 15.0) / 24.0)
    if effect:
        ALL_EFFECTS[effect].apply(scene, parameters, np.random.default_rng(5))
    return scene


def tip(track: Track) -> FloatArray:
    return track.points_cm[:, 9]


def swing_cm(track: Track, since_h: float = 12.0) -> float:
    """How far the tip goes from side to side."""
    return float(np.ptp(tip(track)[round(since_h * ROWS_PER_H) :, 0]))


def test_a_case_follows_from_its_seed() -> None:
    def small(seed: int, kind: str = "single") -> list[FloatArray]:
        case = draw_case(seed, 1, kind, 2, 2, hours=6.0, held_out=1)
        return [run.track.points_cm for run in (*case.reference, *case.measured, *case.held_out)]

    again = [np.array_equal(a, b) for a, b in zip(small(7), small(7), strict=True)]
    assert all(again)
    assert not np.array_equal(small(7)[0], small(8)[0])
    # The same seed without an effect has the same healthy plants.
    assert np.array_equal(small(7)[0], small(7, "none")[0])


@pytest.mark.parametrize(
    ("form", "effect", "value", "lamps", "ends_cm"),
    [
        (0, "clock_skew", -0.0115070, "long random six", [-2.709838, -0.188910, -2.390154, -1.729857]),
        (1, "draught", 0.1270478, "long six random", [3.251979, -0.929485, 3.242396, -0.871794]),
    ],
)
def test_a_seed_draws_what_it_always_drew(
    form: int, effect: str, value: float, lamps: str, ends_cm: list[float]
) -> None:
    """Results that were kept tell of these very plants."""
    case = draw_case(7, form, "single", 3, 1, hours=3.0, held_out=1)
    (hidden,) = case.hidden
    assert hidden.name == effect
    assert list(hidden.parameters.values()) == pytest.approx([value], abs=1e-7)
    assert [run.schedule.split("_")[0] for run in case.measured] == lamps.split()
    ends = [run.track.points_cm[-1, 9, 0] for run in (*case.measured, *case.held_out)]
    assert ends == pytest.approx(ends_cm, abs=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_other_plants_of_a_world_share_its_reference_and_nothing_else(form: int) -> None:
    cases = [draw_case(7, form, "single", 3, 2, effect="sag", hours=3.0, held_out=1, number=n) for n in range(3)]
    first = cases[0]
    for case in cases[1:]:
        for there, here in zip(first.reference, case.reference, strict=True):
            assert np.array_equal(there.track.points_cm, here.track.points_cm)
            assert (there.file, there.track.light) == (here.file, here.track.light)
        for there, here in zip((*first.measured, *first.held_out), (*case.measured, *case.held_out), strict=True):
            assert there.file == here.file
            assert not (there.track.points_cm[:, 1:] == here.track.points_cm[:, 1:]).any()
    runs = [run for case in cases for run in (*case.measured, *case.held_out)]
    assert len({run.track.points_cm.tobytes() for run in runs}) == len(runs)
    assert len({case.hidden[0].parameters["amplitude"] for case in cases}) == 3


def test_numbers_of_a_world_have_their_own_lamps_and_oracle() -> None:
    orders = {
        tuple(run.schedule for run in draw_case(7, 0, "none", 3, 1, hours=1.0, held_out=1, number=n).measured)
        for n in range(12)
    }
    assert len(orders) > 2
    # What knowing the effect is worth is told of the case's own held-out plants.
    case = draw_case(2, 0, "single", 1, 1, effect="draught", hours=48.0, number=3)
    assert case.oracle["own"]["run"]["extended_mm"] < 0.5 * case.oracle["own"]["run"]["base_mm"]


@pytest.mark.parametrize("form", FORMS)
def test_stems_grow_and_swing_like_beans(form: int) -> None:
    track = recorded(quiet(form, 72.0))
    start, end = tip(track)[0], tip(track)[-1]
    assert 6.0 < start[1] < 7.0
    assert 17.0 < end[1] < 25.0
    assert 4.0 < swing_cm(track) < 20.0
    at_15_cm = int(np.argmax(tip(track)[:, 1] > 14.0))
    switch = at_15_cm - at_15_cm % 72 + 72
    two_hours_cm = abs(tip(track)[switch + 27, 0] - tip(track)[switch, 0])  # a quarter of an hour of it is latency
    assert two_hours_cm > 2.0


@pytest.mark.parametrize("form", FORMS)
def test_plants_differ_and_are_measured_with_errors(form: int) -> None:
    case = draw_case(3, form, "none", 1, 4, hours=24.0, held_out=1)
    heights = [run.track.points_cm[-1, 9, 1] for run in case.reference]
    assert 0.3 < np.std(heights) < 3.0
    steps_cm = np.diff(case.measured[0].track.points_cm[:, 1, 0])  # near the soil hardly anything but errors moves
    assert 0.02 < np.std(steps_cm) / np.sqrt(2.0) < 0.08


def test_a_plane_plant_stays_in_the_plane_and_the_other_does_not() -> None:
    assert np.abs(quiet(0).grow()[0][..., 2]).max() == 0.0
    assert np.abs(quiet(1).grow()[0][..., 2]).max() > 0.05


def test_light_of_a_row_shone_over_the_interval_before_it() -> None:
    scene = quiet(0, 13.0)
    lights = recorded(scene).light
    assert lights[0] == lights[72] == "left"
    assert lights[73] == "right"
    assert [tuple(scene.lamp_codes()[i : i + 2]) for i in (142, 144)] == [(0, 0), (1, 1)]


def test_a_closed_loop_holds_the_tip_at_its_target() -> None:
    scene = quiet(0, 30.0)
    scene.schedule = draw_schedule(np.random.default_rng(1), "closed_loop", 30.0)
    scene.target_x_cm = 1.5
    track = recorded(scene)
    assert (scene.schedule == CLOSED_LOOP).all()
    assert set(track.light) == {"left", "right"}
    assert np.abs(tip(track)[ROWS_PER_H * 10 :, 0] - 1.5).max() < 0.5


def test_points_are_at_even_heights_as_tracks_have_them() -> None:
    scene = quiet(0, 30.0)
    lines, used, _ = scene.grow()
    points = recorded(scene).points_cm
    for row in (0, 100, 250, 360):
        assert points[row] == pytest.approx(resample_by_height(lines[row, : used[row], :2], 10), abs=1e-9)


def less_swing(before: Track, after: Track) -> bool:
    return swing_cm(after) < 0.95 * swing_cm(before)


def more_swing(before: Track, after: Track) -> bool:
    return swing_cm(after) > 1.05 * swing_cm(before)


def to_the_right(before: Track, after: Track) -> bool:
    return bool((tip(after) - tip(before))[ROWS_PER_H * 6 :, 0].mean() > 0.1)


def to_the_left(before: Track, after: Track) -> bool:
    return bool((tip(after) - tip(before))[ROWS_PER_H * 6 :, 0].mean() < -0.1)


def later(before: Track, after: Track) -> bool:
    """After the second switch the tip follows half an hour later."""
    late = [tip(track)[12 * ROWS_PER_H : 16 * ROWS_PER_H, 0] for track in (before, after)]
    lags = [float(np.sum((late[1][lag:] - late[0][: len(late[0]) - lag]) ** 2) / (48 - lag)) for lag in range(13)]
    return abs(int(np.argmin(lags)) - 6) <= 1


def turns(before: Track, after: Track) -> bool:
    """The tip moves by 0.6 cm about its path, with a period of an hour and a half."""
    both = (tip(after) - tip(before))[12 * ROWS_PER_H :]
    moved = both[:, 0]
    power = np.abs(np.fft.rfft(moved - moved.mean())) ** 2
    period_h = len(moved) / ROWS_PER_H / int(np.argmax(power))
    return abs(period_h - 1.5) < 0.15 and abs(np.sqrt(2.0 * both.var(axis=0).sum()) - 0.6) < 0.1


def grows_at_noon(before: Track, after: Track) -> bool:
    """More is grown from 9 to 15 h and less from 21 to 27 h."""
    noon, night = (
        (tip(after) - tip(before))[to * ROWS_PER_H, 1] - (tip(after) - tip(before))[at * ROWS_PER_H, 1]
        for at, to in ((9, 15), (21, 27))
    )
    return bool(noon > 0.1 > -0.05 > night)


def less_at_noon(before: Track, after: Track) -> bool:
    """After six hours under one lamp, at 12 h, the tip leans less."""
    return bool(abs(tip(after)[144, 0]) < 0.7 * abs(tip(before)[144, 0]))


DIRECTIONS: list[tuple[str, dict[str, float], Callable[[Track, Track], bool]]] = [
    ("circumnutation", {"period_h": 1.5, "amplitude_cm": 0.6}, turns),
    ("phototropic_latency", {"delay_h": 0.5}, later),
    ("adaptation", {"time_constant_h": 1.0, "floor": 0.4}, less_swing),
    ("lamp_asymmetry", {"right_to_left": 1.6}, to_the_right),
    ("lamp_ageing", {"loss": 0.8}, less_swing),
    ("diurnal_growth", {"amplitude": 0.6, "peak_h": 12.0}, grows_at_noon),
    ("temperature_growth", {"per_degree": 0.1}, grows_at_noon),
    ("growth_rate", {"factor": 1.5}, lambda a, b: bool(tip(b)[-1, 1] > tip(a)[-1, 1] + 2.0)),
    ("stiffening", {"factor": 0.7}, less_swing),
    ("gravitropism", {"factor": 1.6}, less_swing),
    ("proprioception", {"factor": 1.6}, less_swing),
    ("phototropic_gain", {"factor": 1.4}, more_swing),
    ("sag", {"amplitude": 0.8}, more_swing),
    ("draught", {"drive_per_cm_h": 0.1}, to_the_right),
    ("camera_roll", {"angle_deg": 3.0}, to_the_left),
    ("camera_drift", {"angle_deg": 8.0}, to_the_left),
    ("camera_scale", {"factor": 1.1}, lambda a, b: bool(np.allclose(b.points_cm, 1.1 * a.points_cm))),
    ("clock_offset", {"offset_h": 0.5}, lambda a, b: a.light[6:] == b.light[:-6] and same_points(a, b)),
    ("clock_skew", {"per_hour": 0.02}, lambda a, b: a.light == b.light and later_at_the_end(a, b)),
    ("frame_gaps", {"share": 0.2}, lambda a, b: len(b.time_s) < 0.8 * len(a.time_s) and b.time_s[0] == 0.0),
    ("wall", {"x_cm": 1.5}, lambda a, b: bool(tip(a)[:, 0].max() > 2.5 and b.points_cm[..., 0].max() < 1.7)),
    ("growth_stop", {"time_h": 15.0}, lambda a, b: bool(tip(b)[-1, 1] < tip(a)[-1, 1] - 2.0)),
    ("gain_rhythm", {"amplitude": 0.9, "peak_h": 0.0}, less_at_noon),
    ("slow_near_lamp", {"half_cm": 2.0}, less_swing),
    ("kick", {"time_h": 20.0, "bend_per_cm": 0.08}, to_the_right),
    ("shadow", {"side": -1.0, "from_h": 0.0, "for_h": 10.0, "left_over": 0.0}, to_the_right),
    ("tip_broken", {"time_h": 15.0, "growth_left": 0.4, "zone_left": 0.5}, less_swing),
    ("light_history", {"per_side": -0.8, "memory_h": 4.0}, lambda a, b: bool(tip(b)[72, 1] > tip(a)[72, 1] + 0.1)),
    ("growth_bursts", {"period_h": 6.0, "share": 0.3}, lambda a, b: pauses(b) > 3 * pauses(a)),
    ("rhythm", {"growth_amplitude": 0.8, "period_h": 6.0, "peak_h": 2.0, "in_step": 1.0}, lambda _, b: by_turns(b)),
]  # fmt: skip


def by_turns(track: Track, period_h: float = 6.0, peak_h: float = 2.0) -> bool:
    """Whether the stem grows three times as fast about the peaks of a rhythm as half a period later."""
    length_cm = polyline_length(track.points_cm)
    turn = np.cos(2.0 * np.pi * (np.arange(len(length_cm) - 1) / ROWS_PER_H - peak_h) / period_h)
    grown = np.diff(length_cm)
    return bool(grown[turn > 0.8].mean() > 3.0 * grown[turn < -0.8].mean())


def later_at_the_end(before: Track, after: Track) -> bool:
    """Lamps and plant agree at first; after 30 h the plant lags by 0.6 h."""
    switch = 30 * ROWS_PER_H
    moved = [abs(tip(track)[switch + 12, 0] - tip(track)[switch, 0]) for track in (before, after)]
    early = np.abs(tip(before)[:60] - tip(after)[:60]).max()
    return bool(moved[1] < 0.6 * moved[0] and early < 0.5)


def same_points(before: Track, after: Track) -> bool:
    return bool((before.points_cm == after.points_cm).all())


def pauses(track: Track) -> int:
    """Quarters of hours in which the tip stands still."""
    return int((np.linalg.norm(np.diff(tip(track)[::3], axis=0), axis=1) < 0.01).sum())


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("effect", "parameters", "seen"), DIRECTIONS, ids=[row[0] for row in DIRECTIONS])
def test_each_effect_does_what_it_says(
    form: int, effect: str, parameters: dict[str, float], seen: Callable[[Track, Track], bool]
) -> None:
    rng = np.random.default_rng(1) if effect in {"frame_gaps", "tip_misdetection"} else None
    with_it = recorded(quiet(form, effect=effect, **parameters), None, rng)
    assert seen(recorded(quiet(form)), with_it)


def test_a_missed_tip_is_somewhere_else_and_nothing_more() -> None:
    with_it = recorded(quiet(0, effect="tip_misdetection", share=0.1), None, np.random.default_rng(1))
    off = np.abs(with_it.points_cm - recorded(quiet(0)).points_cm).max(axis=(0, 2))
    assert off[:9].max() == 0.0
    assert off[9] > 0.5


def test_each_effect_has_a_test_of_its_direction() -> None:
    assert {row[0] for row in DIRECTIONS} | {"tip_misdetection"} == set(ALL_EFFECTS)


def test_strengths_lie_about_the_typical_one_in_both_directions() -> None:
    rng = np.random.default_rng(2)
    draw = ratio("factor", 0.7, 0.4, 1.8)
    logs = np.log([draw(rng)["factor"] for _ in range(300)]) / np.log(1.0 / 0.7)
    assert np.abs(logs).min() >= 0.6
    assert np.abs(logs).max() <= 1.7
    assert 0.3 < (logs > 0).mean() < 0.7


@pytest.mark.parametrize("name", [*CATALOGUE, *OUTSIDE, *ON_REQUEST])
def test_every_effect_can_be_drawn_and_gives_finite_points(name: str) -> None:
    kind = "single" if name in CATALOGUE else "outside"
    case = draw_case(5, 1, kind, 1, 1, effect=name, hours=3.0, held_out=1)
    assert case.hidden[0].name == name
    assert all(np.isfinite(value) for value in case.hidden[0].parameters.values())
    assert np.isfinite(case.measured[0].track.points_cm).all()


@pytest.mark.parametrize("of", RHYTHMIC)
def test_rhythms_that_are_not_in_step_have_another_time_in_each_run(of: str) -> None:
    parameters = {f"{of}_amplitude": 0.04 if of == "bias" else 0.8, "period_h": 5.0, "peak_h": 1.0, "in_step": 1.0}
    together = [rhythmic(seed, parameters) for seed in (1, 2)]
    apart = [rhythmic(seed, {**parameters, "in_step": 0.0}) for seed in (1, 2)]
    assert np.array_equal(*together)
    assert np.abs(together[0] - quiet(0).series).max() > 0.03
    assert not np.array_equal(*apart)


def rhythmic(seed: int, parameters: dict[str, float]) -> FloatArray:
    scene = quiet(0)
    ALL_EFFECTS["rhythm"].apply(scene, parameters, np.random.default_rng(seed))
    return scene.series


def test_cases_that_were_drawn_before_there_were_rhythms_are_what_they_were() -> None:
    names = [draw_case(seed, 0, "outside", 1, 1, hours=1.0, held_out=1).hidden[0].name for seed in range(6)]
    assert names == ["wall", "tip_broken", "wall", "wall", "light_history", "tip_broken"]


def test_pairs_are_two_effects_that_can_be_told_apart() -> None:
    for seed in range(40):
        names = frozenset(h.name for h in draw_case(seed, 0, "pair", 1, 1, hours=1.0, held_out=1).hidden)
        assert len(names) == 2
        assert names not in INSEPARABLE


def test_knowing_the_effect_and_the_plant_mends_free_runs() -> None:
    oracle = draw_case(2, 0, "single", 1, 1, effect="draught", hours=48.0).oracle["own"]["run"]
    assert oracle["extended_mm"] < 0.5 * oracle["base_mm"]


def test_what_is_named_is_worth_what_it_mends_about_the_own_plants() -> None:
    case = draw_case(2, 0, "pair", 1, 1, hours=24.0, held_out=1)
    own = case.oracle["own"]
    assert named_mm(case, case.hidden) == {when: own[when]["extended_mm"] for when in own}
    assert named_mm(case, ()) == {when: own[when]["base_mm"] for when in own}
    assert named_mm(case, [Hidden("memory", {})]) == named_mm(case, ())  # of a simulator, not of a plant
    half = named_mm(case, case.hidden[:1])
    assert half not in (named_mm(case, ()), named_mm(case, case.hidden))


def test_effects_cost_more_the_longer_a_run_goes_on() -> None:
    own = draw_case(2, 0, "single", 1, 1, effect="draught", hours=30.0, held_out=1).oracle["own"]
    assert set(own) == {"run", "end", "1h", "6h", "24h"}
    costs = [own[when]["base_mm"] - own[when]["extended_mm"] for when in ("1h", "6h", "24h")]
    assert 0.0 < costs[0] < costs[1] < costs[2]


@pytest.mark.parametrize("ahead_h", [-1.0, 0.0, 1.0])
def test_of_the_lamps_nobody_knows_more_than_the_record_and_how_late_it_tells_them(ahead_h: float) -> None:
    scene = quiet(0, hours=20.0)
    scene.schedule = draw_schedule(np.random.default_rng(3), "random_dwell", scene.hours)
    scene.record.offset_h = ahead_h
    believed = believed_lamps(recorded(scene), len(scene.schedule), ahead_h)
    rows, ahead = 20 * ROWS_PER_H, round(ahead_h * ROWS_PER_H)
    told = slice(max(ahead - 1, 0), rows + ahead)  # the first row tells the interval before it
    assert (believed[told] == scene.schedule[told]).all()
    assert (believed[: told.start] == believed[told.start]).all()
    assert (believed[told.stop :] == believed[told.stop - 1]).all()


def test_a_written_case_reads_back(tmp_path: Path) -> None:
    case = draw_case(11, 0, "pair", 2, 3, hours=5.0, held_out=1, number=2)
    write_case(case, tmp_path / "case")
    told = json.loads((tmp_path / "case" / "truth.json").read_text())
    assert [effect["effect"] for effect in told["effects"]] == [hidden.name for hidden in case.hidden]
    assert [effect["parameters"] for effect in told["effects"]] == [hidden.parameters for hidden in case.hidden]
    assert (told["form"], told["kind"], told["number"], told["schedules"]["reference"]) == (
        0,
        "pair",
        2,
        ["six_hour"] * 2 + ["closed_loop"],
    )
    for group, runs in (("reference", case.reference), ("measured", case.measured), ("held_out", case.held_out)):
        folders = sorted((tmp_path / "case" / group).iterdir())
        assert len(folders) == len(runs)
        for path, run in zip(folders, runs, strict=True):
            folder = RunFolder(path)
            assert folder.read_run_file() == run.file
            track = read_track(folder.track_csv)
            assert np.allclose(track.points_cm, run.track.points_cm, atol=1e-4)
            assert track.light == run.track.light
            assert list(track.time_s) == [ROW_S * row for row in range(61)]
            assert set(track.covariates) == {"temperature_c"}
            assert np.ptp(track.covariates["temperature_c"]) > 0.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"form": 2}, "form is 2"),
        ({"kind": "pear"}, "did you mean `pair`"),
        ({"effect": "draft"}, "no effect `draft`"),
        ({"kind": "none", "effect": "draught"}, "kind `none`"),
        ({"runs": 0}, "at least one"),
        ({"seed": -1}, "seed is -1"),
        ({"number": -1}, "number is -1"),
        ({"hours": 0.5}, "hours is 0.5"),
    ],
)
def test_what_makes_no_case_is_told(change: dict[str, object], word: str) -> None:
    with pytest.raises(BadInput, match=word):
        draw_case(**{"seed": 1, "form": 0, "kind": "single", **change})  # type: ignore[arg-type]


def test_the_command_writes_a_case_once(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.discovery.worlds", "--hours", "2", "--runs", "1", "--reference", "1"]
    command += ["--effect", "sag", "-o", str(tmp_path / "case")]
    first, second = (subprocess.run(command, cwd=ROOT, capture_output=True, text=True) for _ in range(2))
    assert first.returncode == 0, first.stderr
    assert "sag" in first.stdout
    assert second.returncode == 2
    assert second.stderr.count("\n") == 1


def test_the_generator_knows_nothing_of_the_finder() -> None:
    modules = set()
    for path in (Path(__file__).parent / "worlds").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                modules.add(str(node.module).split(".")[0])
    assert modules - set(sys.stdlib_module_names) == {"flora_common", "numba", "numpy"}
