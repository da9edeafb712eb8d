"""What happens by chance: covariances of its parts, and their sizes found again."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from diagnose_runs import TYPICAL, red_noise, scene_of

from flora_lab.diagnose import chance
from flora_lab.diagnose.chance import GAPS, MEASURED, PARTS, covariances, of_swing, sizes_expected, sizes_of
from flora_lab.diagnose.rhythm import Swing
from flora_lab.diagnose.scene import FEATURES, Lanes, Scene
from flora_lab.effects.effect import Change

Array = Any
NAMES = [part.name for part in PARTS]
DRIVES = ("bias", "gradient", "growth", "gain", *MEASURED)
GROUPS = {drive: [i for i, part in enumerate(PARTS) if part.drive == drive] for drive in DRIVES}


@functools.cache
def scene(seed: int = 1) -> Scene:
    return scene_of(seed, traits=TYPICAL, chance={})


@functools.cache
def parts(seed: int = 1) -> Array:
    return covariances(scene(seed), scene(seed).answers(TYPICAL, Change()))


def test_covariances_are_symmetric_and_not_negative() -> None:
    own = parts()
    m = scene().size
    assert own.shape == (len(PARTS), m, m)
    for part, covariance in zip(PARTS, own, strict=True):
        assert np.abs(covariance - covariance.T).max() <= 1e-9 * np.abs(covariance).max(), part.name
        values = np.linalg.eigvalsh(covariance)
        assert values[0] >= -1e-9 * values[-1], part.name
        assert (values[-1] > 0.0) == (part.drive != GAPS), part.name  # this run has none
    assert np.linalg.eigvalsh(np.tensordot(sizes_expected() ** 2, own, axes=1))[0] > 0.0


@pytest.mark.parametrize(
    ("name", "sign"),
    [("wander_per_cm_h", 0.0), ("gradient_per_cm_h", 0.0), ("growth_slow_share", 1.0), ("gain_slow_share", 1.0)],
)
def test_a_part_is_what_many_plants_scatter_by(name: str, sign: float) -> None:
    """Plants of the law are pushed about at random, step by step: covariances of their features, the long way round."""
    part, count, size = PARTS[NAMES.index(name)], 500, 0.5 * PARTS[NAMES.index(name)].typical
    own = scene()
    rng = np.random.default_rng(3)
    courses = sign + size * np.stack([red_noise(rng, own.steps, part.memory_h) for _ in range(count)], axis=1)
    plants = Lanes(np.repeat(TYPICAL[None], count, axis=0), np.zeros((count, 2)), [Change()] * count)
    told = own.of_points(own.points(plants, {part.drive: courses}))
    sampled, wanted = np.cov(told.T), size**2 * parts()[NAMES.index(name)]
    assert np.trace(sampled) == pytest.approx(np.trace(wanted), rel=0.15)
    large = np.diag(wanted) > 0.05 * np.diag(wanted).max()
    assert np.diag(sampled)[large] == pytest.approx(np.diag(wanted)[large], rel=0.4)
    alike = np.sum(sampled * wanted) / np.sqrt(np.sum(sampled**2) * np.sum(wanted**2))
    assert alike > 0.98


def drawn(sizes: Array, runs: int, seed: int) -> tuple[list[Array], list[Array]]:
    rng = np.random.default_rng(seed)
    own = parts()
    root = np.linalg.cholesky(np.tensordot(sizes**2, own, axes=1) + 1e-12 * np.eye(own.shape[1]))
    return [root @ rng.standard_normal(own.shape[1]) for _ in range(runs)], [own] * runs


def by_drive(sizes: Array) -> dict[str, float]:
    """How far the features are pushed by each drive, cm."""
    own = np.array([np.trace(part) for part in parts()])
    return {drive: float(np.sqrt((sizes[rows] ** 2) @ own[rows])) for drive, rows in GROUPS.items()}


@pytest.mark.parametrize(
    "factors",
    [(1.0,) * len(DRIVES), (3.0, 0.5, 0.5, 2.0, 0.6, 2.0, 2.0), (0.5, 2.0, 2.5, 0.5, 3.0, 1.5, 3.0)],
)
def test_sizes_are_found_again(factors: tuple[float, ...]) -> None:
    truth = sizes_expected()
    for factor, rows in zip(factors, GROUPS.values(), strict=True):
        truth[rows] *= factor
    truth = np.maximum(truth, [part.least for part in PARTS])
    residuals, own = drawn(truth, 12, 5)
    none = [np.zeros_like(own[0][0])] * 12
    found = by_drive(sizes_of(residuals, own, none, 1.5 * sizes_expected()))
    largest = max(by_drive(truth).values())
    for drive, wanted in by_drive(truth).items():
        # What hardly pushes the features beside the rest is hardly told.
        assert found[drive] == pytest.approx(wanted, rel=0.35, abs=0.1 * largest), drive


def test_what_is_known_besides_is_not_taken_for_chance() -> None:
    truth = sizes_expected()
    residuals, own = drawn(truth, 9, 6)
    rng = np.random.default_rng(7)
    slope = np.linspace(0.0, 2.0, own[0].shape[1])
    with_more = [one + slope * rng.standard_normal() for one in residuals]
    known, none = [np.outer(slope, slope)] * 9, [np.zeros_like(own[0][0])] * 9
    told, untold = (by_drive(sizes_of(with_more, own, besides, truth)) for besides in (known, none))
    wanted = by_drive(truth)
    for drive in ("bias", "growth"):
        assert told[drive] == pytest.approx(wanted[drive], rel=0.4)
    assert sum(untold.values()) > 1.5 * sum(wanted.values())


def test_the_slope_of_the_likelihood_is_that_of_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Callable[[Array], tuple[float, Array]]] = []

    def looked_at(function: Callable[[Array], tuple[float, Array]], start: Array, **_: Any) -> Any:
        asked.append(function)
        return scipy.optimize.OptimizeResult(x=start)

    monkeypatch.setattr(scipy.optimize, "minimize", looked_at)
    residuals, own = drawn(2.0 * sizes_expected(), 2, 8)
    sizes_of(residuals, own, [0.01 * np.eye(len(residuals[0]))] * 2, sizes_expected())
    (improbability,) = asked
    at = np.log(sizes_expected()) + np.random.default_rng(9).normal(0.0, 0.3, len(PARTS))
    slope = improbability(at)[1]
    for i in range(len(PARTS)):
        step = 1e-5 * np.eye(len(PARTS))[i]
        difference = (improbability(at + step)[0] - improbability(at - step)[0]) / 2e-5
        assert slope[i] == pytest.approx(difference, rel=1e-4, abs=1e-4)


def test_sizes_stay_within_what_is_possible() -> None:
    own = [parts()] * 3
    none = [np.zeros_like(own[0][0])] * 3
    m = own[0].shape[1]
    quiet = sizes_of([np.zeros(m)] * 3, own, none, sizes_expected())
    wild = sizes_of([100.0 * np.cos(np.arange(m) + i) for i in range(3)], own, none, sizes_expected())
    for sizes in (quiet, wild):
        assert np.isfinite(sizes).all()
        assert all(size >= part.least * (1.0 - 1e-9) for size, part in zip(sizes, PARTS, strict=True))
    assert (quiet <= sizes_expected() * (1.0 + 1e-9)).all()
    assert sum(by_drive(wild).values()) > 5.0 * sum(by_drive(sizes_expected()).values())


@pytest.mark.parametrize("drive", MEASURED)
def test_errors_of_a_measurement_are_of_one_point_or_of_the_whole_stem(drive: str) -> None:
    own, together = scene(), parts()[GROUPS[drive][0]]
    first = own.window == own.window[0]
    here, axis = together[np.ix_(first, first)], np.array([axis for _, axis in FEATURES])
    same = axis[own.feature[first]][:, None] == axis[own.feature[first]][None, :]
    assert not here[~same].any()
    root = np.sqrt(np.diag(here))
    wanted = np.outer(root, root) * (np.eye(len(root)) if drive == "measure" else same)
    assert here == pytest.approx(wanted, abs=1e-12)
    tip, foot = root[own.feature[first] == 0], root[own.feature[first] == len(FEATURES) - 1]
    if drive == "bow":
        assert tip == pytest.approx(0.0)
    else:
        assert tip == pytest.approx(1.0)
    assert 0.0 < foot < 0.5


def test_sizes_are_named_with_their_units() -> None:
    assert list(chance.as_dict(sizes_expected())) == NAMES
    assert len(set(NAMES)) == len(NAMES)
    bending, shares = dict.fromkeys(("bias", "gradient"), "_per_cm_h"), dict.fromkeys(("growth", "gain"), "_share")
    units = bending | shares | dict.fromkeys(MEASURED, "_cm") | {GAPS: "gaps"}
    assert all(part.name.endswith(units[part.drive]) for part in PARTS)


@pytest.mark.parametrize("period_h", [1.2, 1.64, 2.5])
def test_a_swing_is_less_in_hourly_means_the_faster_it_is(period_h: float) -> None:
    own = scene()
    answers = own.answers(TYPICAL, Change())
    covariance = of_swing(own, answers, Swing(period_h, 0.5, 10.0, 50.0, (1.0, 3.0), (0.1, 1.0)))
    assert np.abs(covariance - covariance.T).max() < 1e-12
    assert np.linalg.eigvalsh(covariance)[0] > -1e-9
    tip = own.feature == 0
    slower = of_swing(own, answers, Swing(1.5 * period_h, 0.5, 10.0, 50.0, (1.0, 3.0), (0.1, 1.0)))
    assert np.diag(slower)[tip].mean() > np.diag(covariance)[tip].mean()
    # The foot of the stem hardly moves.
    assert np.diag(covariance)[tip].mean() > 20.0 * np.diag(covariance)[own.feature == 4].mean()
    # a mean over an hour of a swing of 0.5 cm has at most its variance, with some margin for the phase
    assert np.diag(covariance)[tip].mean() < 1.5**2 * 0.5 * 0.5**2
