"""The base simulator, learned from reference runs: typical plants, how they differ, what happens by chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy.linalg

from flora_lab.diagnose import chance
from flora_lab.diagnose.joint import TRAITS, Base, Found, Joint, Ready, ready
from flora_lab.diagnose.scene import START_SD, Scene
from flora_lab.effects.effect import Change
from flora_lab.simulator.tropism_traits import NAMES, prior_doubt, prior_mean, prior_spread

Array = npt.NDArray[Any]

ROUNDS: Final = 3
SPREAD_STRENGTH: Final = 20.0
"""What the sources say of how differently plants differ in each constant counts as much as this many plants."""
SIZE_STRENGTH: Final = 3.0
"""What they say of how much plants differ in all, as this many."""
_POPULATION_STEPS: Final = 40
_FAR_WORSE: Final = 2.0
_FAR_OFF: Final = 4.5
_FIRST_SD: Final = np.array([0.08, 0.06])
"""How seedlings are expected to differ in the logarithm of their length, and in lean, rad."""
_FIRST_STRENGTH: Final = 3.0
_DOUBTS: Final = {
    "growth_early_cm_per_day": 0.5,
    "growth_late_cm_per_day": 0.5,
    "growth_zone_cm": 0.5,
    "stiffening_cm": 0.6,
    "mature_cm": 0.5,
    "photo_latency_min": 0.7,
}
"""Plants other than those that the sources measured are let in: what is not told by the runs matters little."""


@dataclass(frozen=True, slots=True)
class _Linear:
    """A run about the typical plant: all is linear there.

    Attributes:
        residual: measured minus what the typical plant does, shape (m,).
        slopes: of the features by the plant's own unknowns, shape (m, 11).
        parts: covariances of what happens by chance, per unit, shape (19, m, m).
    """

    residual: Array
    slopes: Array
    parts: Array

    def of_plants(self, spread: Array) -> Array:
        """Covariance because plants differ, and because the first stem is not known exactly, shape (m, m)."""
        own = scipy.linalg.block_diag(spread, np.diag(START_SD**2))
        return np.asarray(self.slopes @ own @ self.slopes.T)


@dataclass(frozen=True, slots=True)
class Learned:
    """What reference runs tell of plants under one law.

    Attributes:
        base: of plants.
        fits: of each run by itself.
        parts: what happens by chance about these, see :func:`flora_lab.diagnose.chance.covariances`.
        evidence: logarithm of the probability of the runs, up to a constant that all laws share.
        rounds: that were done.
    """

    base: Base
    fits: list[Found]
    parts: list[Array]
    evidence: float
    rounds: int


def begun(scenes: Sequence[Scene]) -> Learned:
    """The first round of learning a base from runs in which nothing is taken to be wrong; it tells laws apart."""
    first, first_sd = _firsts(scenes)
    sizes = chance.sizes_expected() * 1.5
    base = Base(prior_mean(), prior_spread(), _known_doubt(), sizes, first, first_sd, len(scenes))
    parts = [chance.covariances(scene, scene.answers(base.mean, Change())) for scene in scenes]
    return _carried_on(scenes, Learned(base, [], parts, -np.inf, 0))


def learned(scenes: Sequence[Scene], first: Learned, on_round: Callable[[], None] = lambda: None) -> Learned:
    """The rounds after the first one, see :func:`begun`; ``on_round`` is told of each."""
    so_far = first
    while so_far.rounds < ROUNDS:
        so_far = _carried_on(scenes, so_far)
        on_round()
    return so_far


def _carried_on(scenes: Sequence[Scene], so_far: Learned) -> Learned:
    """One round more: each run's plant, what plants have in common, and what happens by chance about them."""
    number = so_far.rounds + 1
    alone = so_far.base.of_single_runs()
    runs = [ready(scene, alone, one, together=0) for scene, one in zip(scenes, so_far.parts, strict=True)]
    starts = so_far.fits or [Joint([one], alone).null() for one in runs]
    iterations = 12 if number == 1 else 5
    fits = [Joint([one], alone).fit(old, iterations) for one, old in zip(runs, starts, strict=True)]
    fits = _from_the_middle(runs, alone, fits)
    base = _population(_near(fits) if number < ROUNDS else fits, _known_doubt(), so_far.base)
    parts = [
        chance.covariances(scene, scene.answers(fit.traits[0], Change()))
        for scene, fit in zip(scenes, fits, strict=True)
    ]
    linear = [_about_typical(base, *of_run) for of_run in zip(runs, fits, parts, strict=True)]
    base = _with_chance(linear, base)
    return Learned(base, fits, parts, _evidence(linear, base), number)


def _known_doubt() -> Array:
    return np.diag([_DOUBTS.get(n, d) ** 2 for n, d in zip(NAMES, prior_doubt(), strict=True)])


def _from_the_middle(runs: Sequence[Ready], base: Base, fits: Sequence[Found]) -> list[Found]:
    """Fits that ended much worse than the others, or far from them, once more, from where these ended."""
    middle = np.median([fit.traits[0] for fit in fits], axis=0)
    usual = float(np.median([fit.misfit for fit in fits]))
    near = {id(fit) for fit in _near(fits)}
    out = []
    for one, fit in zip(runs, fits, strict=True):
        best = fit
        if id(fit) not in near or not fit.misfit <= _FAR_WORSE * usual:
            joint = Joint([one], base)
            again = joint.fit(replace(joint.null(), traits=middle[None]), 12)
            best = again if again.misfit < fit.misfit else fit
        out.append(best)
    return out


def _near(fits: Sequence[Found]) -> list[Found]:
    """Fits of plants like most others: one that ended in a corner must not tell how plants differ."""
    values = np.concatenate([fit.traits for fit in fits])
    away = np.abs(values - np.median(values, axis=0))
    usual = np.maximum(np.median(away, axis=0), np.sqrt(np.diag(prior_spread())))
    return [fit for fit, one in zip(fits, away, strict=True) if (one / usual).max() <= _FAR_OFF]


def _population(fits: Sequence[Found], known_doubt: Array, base: Base) -> Base:
    """Mean and spread over plants: what the sources say, weighed against what the plants say.

    Expectation maximisation (Dempster, Laird and Rubin 1977) about the fits, where all is taken for linear. How much
    plants differ in all is told well by nine of them; in what they differ more than in the rest is not, so that each
    constant alone may only go little from what the sources say of it.
    """
    count = len(fits)
    plants = [_told_of(fit) for fit in fits]
    known_mean, known_spread = prior_mean(), prior_spread()
    mean, spread = base.mean, base.spread
    for _ in range(_POPULATION_STEPS):
        held = np.linalg.inv(spread)
        within = [np.linalg.inv(told + held) for told, _ in plants]
        values = np.stack([own @ (pull + held @ mean) for own, (_, pull) in zip(within, plants, strict=True)])
        weight = known_doubt @ np.linalg.inv(known_doubt + spread / count)
        mean = known_mean + weight @ (values.mean(axis=0) - known_mean)
        away = values - mean
        scatter = away.T @ away + np.sum(within, axis=0)
        told_wider = float(np.median(np.diag(scatter) / np.diag(known_spread)))
        wider = (told_wider + SIZE_STRENGTH) / (count + SIZE_STRENGTH)
        spread = (scatter + SPREAD_STRENGTH * wider * known_spread) / (count + SPREAD_STRENGTH)
    doubt = np.linalg.inv(known_doubt)
    for told, _ in plants:
        doubt = doubt + told @ np.linalg.inv(np.eye(TRAITS) + spread @ told)
    return replace(base, mean=mean, spread=spread, doubt=np.linalg.inv(doubt))


def _told_of(fit: Found) -> tuple[Array, Array]:
    """What a run alone tells of its plant: precision of the traits (9, 9), and that times the estimate (9,).

    That the first stem is not known exactly is in it.
    """
    jacobian, residual = fit.jacobians[0], fit.residuals[0]
    whole = jacobian.T @ jacobian
    whole[TRAITS:, TRAITS:] += np.diag(START_SD**-2.0)
    downhill = jacobian.T @ residual
    downhill[TRAITS:] -= fit.start[0] / START_SD**2
    share = whole[:TRAITS, TRAITS:] @ np.linalg.inv(whole[TRAITS:, TRAITS:])
    told = whole[:TRAITS, :TRAITS] - share @ whole[TRAITS:, :TRAITS]
    return told, told @ fit.traits[0] + downhill[:TRAITS] - share @ downhill[TRAITS:]


def _about_typical(base: Base, run: Ready, fit: Found, parts: Array) -> _Linear:
    """A run, from its own fit carried on to the typical plant: linear, because that plant may stand elsewhere."""
    scene = run.scene
    told, slopes = Joint([run], base.of_single_runs()).features_of(fit, 0)
    told, slopes = told[: scene.size], slopes[: scene.size]
    away = np.concatenate([fit.traits[0] - base.mean, fit.start[0]])
    return _Linear(scene.features - told + slopes @ away, slopes, parts)


def _with_chance(runs: Sequence[_Linear], base: Base) -> Base:
    """Sizes of what happens by chance."""
    known = [run.of_plants(base.spread) for run in runs]
    sizes = chance.sizes_of([run.residual for run in runs], [run.parts for run in runs], known, base.sizes)
    return replace(base, sizes=sizes)


def _evidence(runs: Sequence[_Linear], base: Base) -> float:
    """Of all runs, each about the typical plant, by what plants differ in and what happens by chance."""
    total = 0.0
    for run in runs:
        whole = np.tensordot(base.sizes**2, run.parts, axes=1) + run.of_plants(base.spread + base.doubt)
        root = scipy.linalg.cholesky(whole, lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(root, run.residual, lower=True, check_finite=False)
        total -= float(np.log(np.diag(root)).sum() + 0.5 * white @ white)
    return total


def _firsts(scenes: Sequence[Scene]) -> tuple[Array, Array]:
    values = np.stack([scene.first for scene in scenes])
    mean = values.mean(axis=0)
    variance = ((values - mean) ** 2).sum(axis=0) + _FIRST_STRENGTH * _FIRST_SD**2
    return mean, np.sqrt(variance / (len(scenes) + _FIRST_STRENGTH))
