"""How plants differ and what happens by chance, found again in runs that were drawn with both."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from diagnose_runs import SPREAD, TYPICAL, base, scene_of

from flora_common.arrays import Array
from flora_lab.diagnose.chance import MEASURED, PARTS, covariances, sizes_expected
from flora_lab.diagnose.joint import Joint, ready
from flora_lab.diagnose.marginal import Linear, evidence, sizes_and_spread, typical
from flora_lab.diagnose.scene import START_SD
from flora_lab.effects.effect import Change
from flora_lab.simulator.tropism_traits import NAMES, prior_doubt, prior_mean, prior_spread

DRIVES = ("bias", "gradient", "growth", "gain", *MEASURED)
GROUPS = {drive: [i for i, part in enumerate(PARTS) if part.drive == drive] for drive in DRIVES}
KNOWN = prior_mean(), np.diag(prior_doubt() ** 2)
GROWTH = [NAMES.index("growth_early_cm_per_day"), NAMES.index("growth_late_cm_per_day")]


@functools.cache
def about() -> Linear:
    """A run of two days about a plant of the law, in which all is as it would be without plants or chance."""
    scene = scene_of(1, traits=TYPICAL, chance={}, hours=48.0)
    parts = covariances(scene, scene.answers(TYPICAL, Change()))
    joint = Joint([ready(scene, base().of_single_runs(), parts, together=0)], base().of_single_runs())
    _, slopes = joint.features_of(replace(joint.null(), traits=TYPICAL[None]), 0)
    return Linear(np.zeros(scene.size), slopes[: scene.size], parts)


def drawn(count: int, seed: int, *, sizes: Array | None = None, spread: Array = SPREAD) -> list[Linear]:
    """Runs of plants that differ, to whom things happen by chance."""
    rng = np.random.default_rng(seed)
    own = about()
    sizes = np.maximum(sizes_expected(), [part.least for part in PARTS]) if sizes is None else sizes
    root = np.linalg.cholesky(np.tensordot(sizes**2, own.parts, axes=1) + 1e-12 * np.eye(len(own.offset)))
    plants = TYPICAL + rng.standard_normal((count, len(NAMES))) @ np.linalg.cholesky(spread).T
    starts = START_SD * rng.standard_normal((count, len(START_SD)))
    chance = rng.standard_normal((count, len(root))) @ root.T
    return [
        replace(own, offset=own.slopes @ np.concatenate(values) + one)
        for *values, one in zip(plants, starts, chance, strict=True)
    ]


def by_drive(sizes: Array) -> dict[str, float]:
    """How far the features are pushed by each drive, cm."""
    own = np.array([np.trace(part) for part in about().parts])
    return {drive: float(np.sqrt((sizes[rows] ** 2) @ own[rows])) for drive, rows in GROUPS.items()}


def differ(spread: Array) -> Array:
    """Standard deviations in units of what is known before."""
    return np.sqrt(np.diag(spread) / np.diag(prior_spread()))


@pytest.mark.parametrize(
    "factors",
    [
        (1.0,) * len(DRIVES),
        (3.0, 0.5, 0.5, 2.0, 0.6, 2.0, 2.0),
        pytest.param((0.5, 2.0, 2.5, 0.5, 3.0, 1.5, 3.0), marks=pytest.mark.slow),
    ],
)
def test_sizes_of_chance_are_found_again(factors: tuple[float, ...]) -> None:
    truth = sizes_expected()
    for factor, rows in zip(factors, GROUPS.values(), strict=True):
        truth[rows] *= factor
    truth = np.maximum(truth, [part.least for part in PARTS])
    found = by_drive(sizes_and_spread(drawn(24, 5, sizes=truth), TYPICAL, 1.5 * sizes_expected())[0])
    largest = max(by_drive(truth).values())
    for drive, wanted in by_drive(truth).items():
        # What hardly pushes the features beside the rest is hardly told.
        assert found[drive] == pytest.approx(wanted, rel=0.35, abs=0.1 * largest), drive


@pytest.mark.parametrize("factor", [0.6, pytest.param(1.0, marks=pytest.mark.slow), 1.6])
def test_how_plants_differ_is_told_apart_from_chance(factor: float) -> None:
    """Over a few kinds: nine plants of one may by chance be alike."""
    truth = factor**2 * prior_spread()
    found = [sizes_and_spread(drawn(9, seed, spread=truth), TYPICAL, sizes_expected()) for seed in range(5)]
    assert np.exp(np.mean([np.log(differ(spread)) for _, spread in found])) == pytest.approx(factor, rel=0.15)
    wanted = by_drive(sizes_expected())
    for drive in ("bias", "growth"):
        told = np.mean([by_drive(sizes)[drive] for sizes, _ in found])
        assert told == pytest.approx(wanted[drive], rel=0.3), drive


def test_plants_differ_more_in_vigour_where_those_fast_early_are_fast_late() -> None:
    def in_both(correlation: float) -> float:
        """By how much they differ in the mean of both rates, as a standard deviation."""
        truth = np.diag(np.diag(prior_spread()))
        truth[GROWTH, GROWTH[::-1]] = correlation * truth[GROWTH[0], GROWTH[0]]
        spreads = [sizes_and_spread(drawn(9, seed, spread=truth), TYPICAL, sizes_expected())[1] for seed in range(3)]
        return float(np.mean([np.sqrt(spread[np.ix_(GROWTH, GROWTH)].mean()) for spread in spreads]))

    assert in_both(0.9) > 1.1 * in_both(0.0)


def test_spreads_are_covariances() -> None:
    _, spread = sizes_and_spread(drawn(4, 1), TYPICAL, sizes_expected())
    assert np.abs(spread - spread.T).max() == 0.0
    assert np.linalg.eigvalsh(spread)[0] > 0.0


def test_the_typical_plant_is_found_within_its_doubt() -> None:
    away = []
    for seed in range(20):
        mean, doubt = typical(drawn(9, seed), sizes_expected(), SPREAD, KNOWN)
        away.append((mean - TYPICAL) @ np.linalg.solve(doubt, mean - TYPICAL))
    assert np.mean(away) == pytest.approx(len(NAMES), rel=0.4)
    few, many = (typical(drawn(count, 3), sizes_expected(), SPREAD, KNOWN)[1] for count in (2, 9))
    assert np.linalg.eigvalsh(few - many)[0] > 0.0


def test_without_runs_the_typical_plant_is_that_of_the_sources() -> None:
    mean, doubt = typical([], sizes_expected(), SPREAD, KNOWN)
    assert mean == pytest.approx(KNOWN[0])
    assert doubt == pytest.approx(KNOWN[1])


def test_runs_are_most_probable_as_they_were_drawn() -> None:
    runs, sizes = drawn(9, 4), sizes_expected()
    as_drawn = evidence(runs, TYPICAL, sizes, SPREAD)
    assert as_drawn > evidence(runs, TYPICAL, sizes, 9.0 * SPREAD) + 10.0
    assert as_drawn > evidence(runs, TYPICAL, sizes, SPREAD / 9.0) + 10.0
    assert as_drawn > evidence(runs, TYPICAL, 2.0 * sizes, SPREAD) + 10.0
    assert as_drawn > evidence(runs, TYPICAL + 0.5, sizes, SPREAD) + 10.0


def test_the_slope_of_the_likelihood_is_that_of_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Callable[[Array], tuple[float, Array]]] = []

    def looked_at(function: Callable[[Array], tuple[float, Array]], start: Array, **_: Any) -> Any:
        asked.append(function)
        return scipy.optimize.OptimizeResult(x=start)

    monkeypatch.setattr(scipy.optimize, "minimize", looked_at)
    _, spread = sizes_and_spread(drawn(2, 8), TYPICAL, sizes_expected())
    assert spread == pytest.approx(prior_spread())  # from which it sets out
    (improbability,) = asked
    count = len(PARTS) + len(NAMES) + 1
    own = np.diag(prior_spread()) - np.isin(np.arange(len(NAMES)), GROWTH) * prior_spread()[0, 1]
    expected = np.concatenate([sizes_expected(), np.sqrt([*own, prior_spread()[0, 1]])])
    at = np.log(expected) + np.random.default_rng(9).normal(0.0, 0.3, count)
    slope = improbability(at)[1]
    for i in range(count):
        step = 1e-5 * np.eye(count)[i]
        difference = (improbability(at + step)[0] - improbability(at - step)[0]) / 2e-5
        assert slope[i] == pytest.approx(difference, rel=1e-4, abs=1e-4)


def _pushed(offsets: Sequence[Array]) -> list[Linear]:
    return [replace(about(), offset=about().slopes[:, : len(NAMES)] @ TYPICAL + one) for one in offsets]


def test_sizes_stay_within_what_is_possible() -> None:
    m = len(about().offset)
    quiet = sizes_and_spread(_pushed([np.zeros(m)] * 3), TYPICAL, sizes_expected())
    wild = sizes_and_spread(_pushed([100.0 * np.cos(np.arange(m) + i) for i in range(3)]), TYPICAL, sizes_expected())
    for sizes, spread in (quiet, wild):
        assert np.isfinite(sizes).all()
        assert np.linalg.eigvalsh(spread)[0] > 0.0
        assert all(size >= part.least * (1.0 - 1e-9) for size, part in zip(sizes, PARTS, strict=True))
    assert (quiet[0] <= sizes_expected() * (1.0 + 1e-9)).all()
    assert (differ(quiet[1]) < 1.0).all()
    assert sum(by_drive(wild[0]).values()) > 5.0 * sum(by_drive(sizes_expected()).values())
