"""Individuals and chance: plants that the law itself made, with traits and noise that are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numba
import numpy as np
import pytest
from simulator_contract import LEFT, RIGHT
from simulator_fakes import upright

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator.drives import BLOCK, DriveNoise, Drives
from flora_lab.simulator.growing import DataRange, GrowingSimulator
from flora_lab.simulator.individual import RANGE_SD, Fitted, Observed, Prior, covariance_of, fit
from flora_lab.simulator.interface import Chance, History, run
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.tropism_traits import NAMES, prior_mean, prior_spread

numba.set_num_threads(1)

Make = Callable[[], GrowingSimulator]

PRIOR = Prior(prior_mean(), prior_spread())
STEP_S = 300.0
MEASURE_CM = 0.03
NOISE = DriveNoise(measure_cm=0.05)
"""What chance does, and what the linear approximation of it leaves."""


def rod(noise: DriveNoise = NOISE) -> RodSimulator:
    return RodSimulator(LampsSection(), PRIOR, noise, DataRange(30.0, 10.0))


def sequence() -> SequenceSimulator:
    rng = np.random.default_rng(1)
    weights = {name: (0.05 * rng.normal(size=shape)).astype(np.float32) for name, shape in weight_shapes(2, 8).items()}
    prior = Prior(np.zeros(len(TRAITS)), np.eye(len(TRAITS)))
    return SequenceSimulator(NeuralLaw(weights, 6.0), prior, NOISE, DataRange(30.0, 10.0))


both_kinds = pytest.mark.parametrize("make", [rod, sequence])


def switching(count: int, steps: int, seed: int) -> Array:
    """Levels (steps, count, 2): left and right in turn, one to eight hours each, other times for each plant."""
    rng = np.random.default_rng(seed)
    light = np.zeros((steps, count, 2))
    for plant in range(count):
        at, side = 0, int(rng.integers(2))
        while at < steps:
            dwell = int(rng.uniform(12, 96))
            light[at : at + dwell, plant, side] = 1.0
            at, side = at + dwell, 1 - side
    return light


@dataclass(frozen=True)
class Garden:
    """Plants whose traits are known.

    Attributes:
        traits: shape (plants, 9).
        runs: what was measured, with noise.
    """

    traits: Array
    runs: list[MeasuredRun]


def grown(simulator: RodSimulator, seeds: Sequence[int], hours: int) -> Garden:
    """Individuals with all that happens to them by chance, measured to :data:`MEASURE_CM`."""
    count, steps = len(seeds), hours * 12
    light = switching(count, steps, 3)
    state = simulator.start(upright(count, 7.0), Chance(np.array(seeds)))
    points = np.concatenate([simulator.stems_cm(state)[None], run(simulator, state, light, STEP_S)])
    points[1:, :, 1:] += MEASURE_CM * np.random.default_rng(4).normal(size=points[1:, :, 1:].shape)
    time_s = np.arange(steps + 1, dtype=np.float64) * STEP_S
    runs = [
        MeasuredRun(f"{s}", f"{s}", "0" * 64, points[:, i], light[:, i], time_s, STEP_S, {})
        for i, s in enumerate(seeds)
    ]
    return Garden(state.traits, runs)


def scores(fits: Sequence[Fitted], truth: Array) -> Array:
    """Errors in units of the standard deviation that the fit claims, shape (plants, traits)."""
    sd = np.stack([np.sqrt(np.diag(found.covariance)) for found in fits])
    return np.asarray((np.stack([found.traits for found in fits]) - truth) / sd)


@pytest.fixture(scope="module")
def garden() -> Garden:
    return grown(rod(), range(100, 120), 24)


@pytest.fixture(scope="module")
def fits(garden: Garden) -> list[Fitted]:
    found = []
    for one in garden.runs:
        seen = Observed(one, rod().law)
        found.append(fit(seen, PRIOR, covariance_of(seen.responses(PRIOR.mean), NOISE)))
    return found


# Recognising individuals


def test_traits_are_found_and_as_far_off_as_the_fit_says(garden: Garden, fits: list[Fitted]) -> None:
    away = scores(fits, garden.traits)
    assert np.mean(np.abs(away) < 2.0) > 0.9
    assert 0.7 < np.sqrt(np.mean(away**2)) < 1.3
    # and the track has told much that the prior does not: most of how fast the plant grows, and of its lag
    share = np.stack([np.sqrt(np.diag(f.covariance) / np.diag(PRIOR.covariance)) for f in fits]).mean(axis=0)
    shares = dict(zip(NAMES, share, strict=True))
    assert shares["growth_early_cm_per_day"] < 0.6
    assert shares["photo_latency_min"] < 0.4
    found = np.stack([one.traits for one in fits])
    error, before = (np.sqrt(np.mean((told - garden.traits) ** 2, axis=0)) for told in (found, PRIOR.mean))
    assert np.mean(error / before) < 0.6


def test_taking_the_residuals_for_white_claims_false_precision(garden: Garden, fits: list[Fitted]) -> None:
    white = []
    for one, found in zip(garden.runs, fits, strict=True):
        seen = Observed(one, rod().law)
        white.append(fit(seen, PRIOR, np.var(found.residual) * np.eye(len(found.residual))))
    away, honest = scores(white, garden.traits), scores(fits, garden.traits)
    growth = NAMES.index("growth_early_cm_per_day")
    assert np.sqrt(np.mean(away[:, growth] ** 2)) > 2.0 > np.sqrt(np.mean(honest[:, growth] ** 2))
    assert np.mean(np.abs(away) < 2.0) < 0.85 < np.mean(np.abs(honest) < 2.0)
    assert np.sqrt(np.mean(away**2)) > 1.4 * np.sqrt(np.mean(honest**2))


def test_without_chance_traits_come_back(garden: Garden) -> None:
    law, quiet = rod().law, DriveNoise(measure_cm=1e-3, wander_per_cm_h=1e-6, nutation_per_cm_h=1e-6)
    quiet = replace(quiet, growth_share=1e-6, rhythm_share=1e-6)
    seen = Observed(garden.runs[0], law)
    truth = PRIOR.mean + np.sqrt(np.diag(PRIOR.covariance)) * np.array([1.0, -1.0, 0.5, -0.5, 1.0, 1.0, -1.0, 0.5, 1.0])
    seen.features = seen.simulated(truth[None])[0]
    found = fit(seen, PRIOR, covariance_of(seen.responses(PRIOR.mean), quiet))
    assert found.traits == pytest.approx(truth, abs=0.01)
    assert np.abs(found.residual).max() < 0.01


def test_traits_stay_those_of_a_plant(garden: Garden) -> None:
    one = garden.runs[0]
    wild = replace(one, points_cm=one.points_cm * np.linspace(1.0, 6.0, len(one))[:, None, None])
    seen = Observed(wild, rod().law)
    found = fit(seen, PRIOR, covariance_of(seen.responses(PRIOR.mean), NOISE))
    assert (np.abs(found.traits - PRIOR.mean) <= (RANGE_SD + 1e-9) * np.sqrt(np.diag(PRIOR.covariance))).all()


def test_what_was_not_seen_tells_nothing(garden: Garden) -> None:
    one = garden.runs[0]
    points = one.points_cm.copy()
    points[12:180] = np.nan
    few, all_of_it = (Observed(r, rod().law) for r in (replace(one, points_cm=points), one))
    assert few.is_told.sum() == len(few.features) == 40
    assert len(all_of_it.features) == 96
    wide, narrow = (
        np.diag(fit(seen, PRIOR, covariance_of(seen.responses(PRIOR.mean), NOISE)).covariance)
        for seen in (few, all_of_it)
    )
    assert (wide > 0.99 * narrow).all()
    assert np.mean(wide / narrow) > 1.2
    points[1:-5] = np.nan  # no hour is told, though stems are
    blind = Observed(replace(one, points_cm=points[:-4], light=one.light[:-4], time_s=one.time_s[:-4]), rod().law)
    found = fit(blind, PRIOR, covariance_of(blind.responses(PRIOR.mean), NOISE))
    assert found.traits == pytest.approx(PRIOR.mean)
    assert found.covariance == pytest.approx(PRIOR.covariance)


def test_responses_foretell_the_covariance_of_what_chance_does(garden: Garden) -> None:
    noise = replace(NOISE, wander_per_cm_h=0.006, nutation_per_cm_h=0.02, growth_share=0.03, rhythm_share=0.015)
    seen = Observed(garden.runs[1], rod().law)
    count, every = 500, 3  # drives that stay for a quarter of an hour
    drives = Drives(noise, np.arange(count))
    typical = seen.responses(PRIOR.mean)
    length_cm = np.interp(np.arange(0, seen.steps, every) / 12.0, typical.bias_h, typical.length_cm)
    processes, told = drives.start(), []
    for k, length in enumerate(length_cm):
        processes, *pushes = drives.step(processes, k, every / 12.0, np.full(count, length))
        told.append(pushes)
    bias, growth = np.repeat(np.array(told), every, axis=0).transpose(1, 0, 2)
    lanes = np.repeat(PRIOR.mean[None], count, axis=0)
    features = seen.of_points(seen.points(lanes, bias, growth)) - seen.simulated(PRIOR.mean[None])
    found, expected = features.T @ features / count, typical.covariance(noise)
    sizes = np.diag(expected)
    sampling = np.sqrt((sizes[:, None] * sizes[None] + expected**2) / count)
    late = np.arange(len(sizes)) >= 8  # knots of growth are an hour long
    assert np.abs((found - expected) / sampling)[np.ix_(late, late)].max() < 5.0
    assert np.median(np.diag(found) / sizes) == pytest.approx(1.0, abs=0.1)


def test_a_plant_that_was_watched_is_foretold_better_than_a_typical_one() -> None:
    plant, seen, hours = rod(), 24 * 12, 48
    runs = grown(plant, range(200, 212), hours).runs
    points, light = (np.stack([getattr(one, name) for one in runs], axis=1) for name in ("points_cm", "light"))
    watched = plant.watch(History(points[: seen + 1], light[:seen], STEP_S, {}))
    typical = plant.start(points[seen], before=light[seen - 1])
    error_cm = [
        np.hypot(*np.moveaxis(run(plant, state, light[seen:], STEP_S)[:, :, -1] - points[seen + 1 :, :, -1], -1, 0))
        for state in (watched, typical)
    ]
    better, worse = (np.sqrt(np.mean(error**2, axis=0)) for error in error_cm)
    assert np.median(better / worse) < 0.85
    assert better.mean() < 0.8 * worse.mean()


# Drawing individuals


@both_kinds
def test_a_seed_is_a_plant_and_another_seed_is_another(make: Make) -> None:
    plant = make()
    light = np.repeat(np.repeat(np.array([RIGHT, LEFT]), 12, axis=0)[:, None], 4, axis=1)
    state = plant.start(upright(4), Chance(np.array([7, 8, 7, 9])))
    stems = run(plant, state, light, 300.0)
    assert stems[:, 0].tobytes() == stems[:, 2].tobytes()
    assert all(np.abs(stems[-1, 0] - stems[-1, i]).max() > 1e-3 for i in (1, 3))
    alone = run(plant, plant.start(upright(1), Chance(np.array([9]))), light[:, :1], 300.0)
    assert alone[:, 0].tobytes() == stems[:, 3].tobytes()
    typical = plant.start(upright(4))
    assert (typical.traits == plant.prior.mean).all()


@both_kinds
def test_individuals_are_drawn_from_the_prior(make: Make) -> None:
    plant, count = make(), 4000
    traits = plant.start(upright(count), Chance(np.arange(count))).traits
    white = np.linalg.solve(np.linalg.cholesky(plant.prior.covariance), (traits - plant.prior.mean).T)
    assert np.abs(white.mean(axis=1)).max() < 4.0 / np.sqrt(count)
    scatter = white @ white.T / count
    sampling = np.sqrt((1.0 + np.eye(len(white))) / count)
    assert (np.abs(scatter - np.eye(len(white))) < 4.5 * sampling).all()


# What happens by chance


@pytest.mark.parametrize("dt_h", [1.0 / 12.0, 0.5])
def test_drives_have_the_covariances_of_the_noise(dt_h: float) -> None:
    noise = DriveNoise(wander_h=1.5, nutation_coherence_h=2.0, growth_h=2.0, rhythm_share=0.08)
    seeds, steps = np.arange(1500), 24
    drives = Drives(noise, seeds)
    length_cm = np.linspace(12.0, 20.0, steps)
    processes = drives.start()
    bias, growth = np.empty((2, steps, len(seeds)))
    for k in range(steps):
        lengths = np.full(len(seeds), length_cm[k])
        processes, bias[k], growth[k] = drives.step(processes, k, dt_h, lengths)
    time_h = dt_h * np.arange(steps)
    for values, expected in (
        (bias, noise.bias_covariance(time_h, length_cm)),
        (growth - 1.0, noise.growth_covariance(time_h)),
    ):
        found = values @ values.T / len(seeds)
        sizes = np.diag(expected)
        sampling = np.sqrt((sizes[:, None] * sizes[None] + expected**2) / len(seeds))
        assert np.abs((found - expected) / sampling).max() < 5.0
        assert np.sqrt(np.diag(found)) == pytest.approx(np.sqrt(sizes), rel=0.1)


def test_chance_follows_from_the_seed_and_the_number_of_the_step() -> None:
    drives = Drives(DriveNoise(), np.array([3, 4]))
    alone = Drives(DriveNoise(), np.array([4]))
    for step in (0, 1, BLOCK - 1, BLOCK, 3 * BLOCK + 7):
        assert drives.normals(step)[1].tobytes() == alone.normals(step)[0].tobytes()
    told = np.stack([drives.normals(step) for step in range(BLOCK - 40, BLOCK + 40)]).reshape(80, -1)
    assert len(np.unique(told)) == told.size  # nothing is drawn twice
    assert not np.isin(drives.start(), told).any()


def test_growth_by_chance_never_goes_back() -> None:
    drives = Drives(DriveNoise(growth_share=2.0), np.arange(500))
    _, _, growth = drives.step(drives.start(), 0, 0.1, np.full(500, 10.0))
    assert growth.min() == 0.0
