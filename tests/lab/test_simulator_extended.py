"""The mechanistic simulator with effects that were found later: what they do, and when they act."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from extended_plants import (
    ALL_AT_ONCE,
    DARK,
    OF_PLANTS,
    START_CM,
    USUAL_C,
    base,
    course,
    lit,
    tips,
    with_effect,
    written,
)
from simulator_contract import LEFT, RIGHT, check_contract
from simulator_fakes import upright

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import GrowingState
from flora_lab.simulator.interface import Chance, History, run
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import in_steps
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension
from flora_lab.simulator.terms import ExtendedLaw
from flora_lab.simulator.tropism import TropismLaw
from flora_lab.simulator.tropism_traits import NAMES, prior_mean
from flora_twin.runs import dataset_runs

QUIET = DriveNoise(wander_per_cm_h=1e-6, nutation_per_cm_h=1e-6, growth_share=1e-6, rhythm_share=1e-6)


# What effects do

RIGHT_12H = lit((12.0, RIGHT))
SWITCHED = lit((6.0, RIGHT), (1.0, LEFT))
LATE = lit((60.0, DARK), (6.0, RIGHT))
SIDEWAYS, UP = 0, 1
Does = tuple[str, int, dict[str, float], Array, int, float]
DOES: list[Does] = [
    ("phototropic_latency", 0, {"delay_h": 0.6}, SWITCHED, SIDEWAYS, +1),
    ("adaptation", 0, {"time_constant_h": 1.5, "floor": 0.5}, RIGHT_12H, SIDEWAYS, -1),
    ("lamp_asymmetry", 0, {"right_to_left": 1.4}, RIGHT_12H, SIDEWAYS, +1),
    ("lamp_asymmetry", 0, {"right_to_left": 0.7}, RIGHT_12H, SIDEWAYS, -1),
    ("lamp_ageing", 0, {"loss": 0.4}, LATE, SIDEWAYS, -1),
    ("diurnal_growth", 0, {"amplitude": 0.4, "peak_h": 6.0}, RIGHT_12H, UP, +1),
    ("diurnal_growth", 0, {"amplitude": 0.4, "peak_h": 18.0}, RIGHT_12H, UP, -1),
    ("diurnal_growth", 1, {"amplitude": 0.4, "peak_h": 6.0}, lit((3.0, RIGHT)), SIDEWAYS, +1),
    ("growth_rate", 0, {"factor": 1.4}, lit((12.0, DARK)), UP, +1),
    ("growth_rate", 0, {"factor": 0.65}, lit((12.0, DARK)), UP, -1),
    ("growth_rate", 1, {"factor": 0.65}, lit((3.0, RIGHT)), SIDEWAYS, -1),
    ("stiffening", 0, {"factor": 0.75}, RIGHT_12H, SIDEWAYS, -1),
    ("stiffening", 1, {"factor": 0.75}, RIGHT_12H, SIDEWAYS, -1),
    ("gravitropism", 0, {"factor": 1.6}, RIGHT_12H, SIDEWAYS, -1),
    ("proprioception", 0, {"factor": 1.6}, RIGHT_12H, SIDEWAYS, -1),
    ("phototropic_gain", 0, {"factor": 0.7}, RIGHT_12H, SIDEWAYS, -1),
    ("sag", 0, {"amplitude": 1.5}, lit((3.0, RIGHT)), SIDEWAYS, +1),
    ("sag", 0, {"amplitude": 1.5}, lit((3.0, RIGHT)), UP, -1),
    ("draught", 0, {"drive_per_cm_h": 0.1}, lit((12.0, DARK)), SIDEWAYS, +1),
    ("draught", 0, {"drive_per_cm_h": -0.1}, lit((12.0, DARK)), SIDEWAYS, -1),
    ("time_scale", 0, {"factor": 3.0}, lit((12.0, DARK)), UP, -1),
]


@pytest.mark.parametrize(("name", "form", "parameters", "light", "axis", "sign"), DOES)
def test_an_effect_acts_in_its_direction(
    name: str, form: int, parameters: dict[str, float], light: Array, axis: int, sign: float
) -> None:
    extended = with_effect(name, form, **parameters)
    assert sign * (tips(extended, light)[-1] - tips(base(), light)[-1])[axis] > 0.03


def test_every_effect_of_a_plant_is_looked_at_here() -> None:
    assert {name for name, *_ in DOES} | {"circumnutation", "temperature_growth"} == set(OF_PLANTS)


def test_a_left_lamp_knows_nothing_of_the_right_ones_pull() -> None:
    dirty = with_effect("lamp_asymmetry", right_to_left=0.5)
    assert tips(dirty, lit((12.0, LEFT))).tobytes() == tips(base(), lit((12.0, LEFT))).tobytes()


@pytest.mark.parametrize(("period_h", "amplitude_cm"), [(1.4, 0.5), (2.3, 1.5)])
def test_a_tip_swings_as_far_and_as_fast_as_it_was_found_to(period_h: float, amplitude_cm: float) -> None:
    extension = Extension("circumnutation", {"period_h": period_h, "amplitude_cm": amplitude_cm})
    calm = base(QUIET)
    swinging = calm.extended([extension])
    seeds, light = Chance(np.arange(40)), lit((72.0, DARK), count=40)
    still, swung = (run(p, p.start(upright(40, 6.5), seeds), light, 300.0)[:, :, -1, 0] for p in (calm, swinging))
    away = swung - still
    waves, per_hour = np.fft.rfft(away, axis=0), np.fft.rfftfreq(len(away), 1 / 12)
    waves[per_hour < 0.5 / period_h] = 0.0  # a phase that drifts also makes the stem wander, slowly
    swing = np.fft.irfft(waves, len(away), axis=0)
    assert np.sqrt(2.0 * np.mean(swing**2)) == pytest.approx(amplitude_cm, rel=0.1)
    assert 1.0 / per_hour[np.argmax(np.mean(np.abs(waves) ** 2, axis=1))] == pytest.approx(period_h, rel=0.05)
    typical = (run(p, p.start(START_CM), RIGHT_12H, 300.0).tobytes() for p in (calm, swinging))
    assert len(set(typical)) == 1  # whose phase nobody knows


def test_a_swing_comes_on_top_of_the_one_that_is_there() -> None:
    noise = [with_effect("circumnutation", period_h=2.0, amplitude_cm=a).noise for a in (0.0, 0.5, 1.0)]
    assert noise[0] == base().noise
    added = [n.nutation_per_cm_h**2 - noise[0].nutation_per_cm_h ** 2 for n in noise]
    assert added[2] == pytest.approx(4.0 * added[1])
    assert noise[1].nutation_period_min == 120.0


def neutral(name: str) -> Extension:
    none = {p.name: 0.5 * (p.low + p.high) if p.none is None else p.none for p in BY_NAME[name].parameters}
    return Extension(name, none, len(BY_NAME[name].forms) - 1)


@pytest.mark.parametrize("name", OF_PLANTS)
def test_an_effect_of_no_size_changes_no_bit(name: str) -> None:
    assert course(base().extended([neutral(name)])) == course(base())


def test_a_law_with_neutral_terms_is_the_plain_law_to_the_bit() -> None:
    light, traits = lit((9.0, RIGHT), (9.0, LEFT), (3.0, DARK), count=2), np.stack([prior_mean(), prior_mean() + 0.1])
    out = []
    for law in (TropismLaw(LampsSection()), ExtendedLaw(LampsSection())):
        plant = base()
        plant.law = law
        state = GrowingState(plant.start(upright(2, 7.0)).stems, traits)
        out.append(run(plant, state, light, 300.0).tobytes())
    assert out[0] == out[1]
    assert type(base().extended([Extension("gravitropism", {"factor": 1.5})]).law) is TropismLaw


# When effects act


def test_steps_are_those_of_the_law_to_the_bit() -> None:
    plant = base().extended(ALL_AT_ONCE)
    rng = np.random.default_rng(4)
    lamps = np.array([LEFT, RIGHT, DARK, (1.0, 1.0)])[rng.integers(0, 4, (72, 2))]
    light = np.repeat(lamps, 12, axis=0)
    first = GrowingState(plant.start(upright(2, 7.0)).stems, plant.prior.mean + 0.05 * rng.normal(size=(2, len(NAMES))))
    stepped = run(plant, first, light, 300.0)
    out, shape = np.empty_like(stepped), light.shape[:2]
    plant.law.advance(first.stems.copy(), first.traits, light, np.zeros(shape), np.ones(shape), 1 / 12, 1, out)
    assert stepped.tobytes() == out.tobytes()
    assert np.abs(stepped - run(base(), first_of(base(), first), light, 300.0)).max() > 0.5


def first_of(plant: RodSimulator, state: GrowingState) -> GrowingState:
    return GrowingState(plant.start(upright(len(state.traits), 7.0)).stems, state.traits)


@pytest.mark.parametrize("step_s", [60.0, 120.0])
@pytest.mark.parametrize("delay_h", [0.1, 0.5, 1.7])
def test_a_delay_is_a_light_that_shines_later(step_s: float, delay_h: float) -> None:
    light, late = (lit((3.0 + h, RIGHT), (3.0 - h, LEFT), step_h=step_s / 3600.0) for h in (0.0, delay_h))
    plant = with_effect("phototropic_latency", delay_h=delay_h)
    delayed, shifted = (run(p, p.start(START_CM), shone, step_s) for p, shone in ((plant, light), (base(), late)))
    assert np.abs(delayed - shifted).max() < 1e-6
    assert np.abs(shifted[-1] - run(base(), base().start(START_CM), light, step_s)[-1]).max() > 0.02


@pytest.mark.parametrize("times", [2, 6])
def test_effects_act_in_long_steps_as_in_several_short_ones(times: int) -> None:
    plant, light = base().extended(ALL_AT_ONCE), lit((6.0, RIGHT), (6.0, LEFT))
    short = run(plant, plant.start(START_CM), light, 300.0)
    long = run(plant, plant.start(START_CM), light[::times], 300.0 * times)
    assert np.abs(long - short[times - 1 :: times]).max() < 1e-9


def test_the_clock_starts_with_the_run_whatever_shone_before() -> None:
    plant, dark = with_effect("diurnal_growth", amplitude=0.6, peak_h=6.0), lit((6.0, DARK))
    fresh, later = (tips(plant, dark, before=before)[-1, 1] for before in (None, np.array([DARK])))
    assert fresh == later
    aged = with_effect("lamp_ageing", loss=0.9)
    for before in (np.array([LEFT]), np.array([RIGHT])):
        assert aged.start(START_CM, before=before).stems.memory[0, 3, 0] == 0.0


def test_what_shone_before_the_start_is_still_on_its_way() -> None:
    plant = with_effect("phototropic_latency", delay_h=0.75)
    told = tips(plant, lit((0.75, LEFT)), before=np.array([RIGHT]))
    assert (np.diff(told[:, 0]) > 0.0).all()
    prompt = tips(base(), lit((0.75, LEFT)), before=np.array([RIGHT]))
    assert np.diff(prompt[:, 0])[-1] < 0.0


def test_the_clock_goes_on_with_what_was_watched() -> None:
    noon = with_effect("diurnal_growth", amplitude=0.8, peak_h=13.0)
    light = lit((12.0, DARK))
    seen = np.concatenate([START_CM[None], run(noon, noon.start(START_CM), light, 300.0)])
    state = noon.watch(History(seen, light, 300.0, {}))
    assert np.abs(state.traits - noon.prior.mean).max() < 0.05  # the effect is not taken for the individual
    fast = run(noon, state, lit((2.0, DARK)), 300.0)[-1, 0, -1, 1] - seen[-1, 0, -1, 1]
    slow = run(noon, noon.start(seen[-1]), lit((2.0, DARK)), 300.0)[-1, 0, -1, 1] - seen[-1, 0, -1, 1]
    assert fast > 4.0 * slow


# Temperature


def warm(light: Array, *at_c: float) -> dict[str, Array]:
    return {"temperature_c": np.repeat(np.array([at_c]), len(light), axis=0)}


def grown(plant: RodSimulator, *at_c: float) -> Array:
    """Heights after a day at constant temperatures, one plant each."""
    light = lit((24.0, DARK), count=len(at_c))
    return run(plant, plant.start(upright(len(at_c), 7.0)), light, 300.0, warm(light, *at_c))[-1, :, -1, 1]


def test_growth_follows_the_temperature_of_each_plant(tmp_path: Path) -> None:
    plant = with_effect("temperature_growth", per_degree=0.07)
    together = grown(plant, USUAL_C, 27.0, 17.0, np.nan)
    usual = float(tips(base(), lit((24.0, DARK)))[-1, 1])
    assert together[[0, 3]].tolist() == [usual, usual]
    assert together[1] > usual + 0.5 > usual - 0.5 > together[2]
    assert [float(grown(plant, at_c)[0]) for at_c in (USUAL_C, 27.0, 17.0)] == together[:3].tolist()
    assert tips(plant, lit((24.0, DARK)))[-1, 1] == usual  # nobody tells
    scales = {name: value for name, value in plant.scales().items() if name != "usual_temperature_c"}
    unknown = load(written(tmp_path / "sim", plant, scales=scales))
    assert isinstance(unknown, RodSimulator)
    assert grown(unknown, 30.0).tolist() == [usual]
    assert (grown(with_effect("temperature_growth", form=1, per_degree=0.07), 27.0) > usual).all()


def test_who_watches_knows_how_warm_it_was() -> None:
    plant, light = with_effect("temperature_growth", per_degree=0.07), lit((24.0, RIGHT))
    points = np.concatenate([START_CM[None], run(plant, plant.start(START_CM), light, 300.0, warm(light, 30.0))])
    told, untold = (plant.watch(History(points, light, 300.0, c)).traits[0] for c in (warm(light, 30.0), {}))
    growth = NAMES.index("growth_early_cm_per_day")
    assert abs(told[growth] - plant.prior.mean[growth]) < 0.02
    assert untold[growth] - plant.prior.mean[growth] > 0.1


# What all simulated plants promise


def test_it_keeps_what_simulated_plants_promise() -> None:
    runs = [
        in_steps(RunTrack(r.name, r.run_file.plant, Path(f"{r.name}.csv"), f"{i:064d}", r.track))
        for i, r in enumerate(dataset_runs(1, open_loops=2, closed_loops=1, hours=4.0))
    ]
    # Stems that sag get no shorter, but points along them are fewer than along the rod.
    check_contract(
        base().extended(ALL_AT_ONCE), runs, start_cm=1e-3, watch_cm=3e-3, merged_cm=0.02, shrink_cm=1e-2, hours=24.0
    )
