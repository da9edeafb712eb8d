"""What the plants of several runs have in common, how they differ, and what happened to them by chance.

Expectation-maximisation with Laplace's approximation: each plant's constants given what is known of all, then what is
known of all given each plant's constants; the noise by maximum likelihood of the free-run residuals in between, with
the plants' unknown constants integrated out. What was known before enters as prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
import scipy.optimize

from flora_common.arrays import Array
from flora_lab.simulator.drives import NOISE_NAMES, DriveNoise
from flora_lab.simulator.individual import (
    KNOT_H,
    Fitted,
    Observed,
    Prior,
    Responses,
    covariance_of,
    fit,
    linearised,
)

ROUNDS: Final = 3
SPREAD_STRENGTH: Final = 9.0
"""The prior of the spread counts as much as this many plants."""
SMALLEST_MEASURE_CM: Final = 0.05
"""What the linear approximation leaves is never less, however well the stems were measured."""
LONG_ROWS: Final = 36
_IMPOSSIBLE: Final = 1e12
_SIZE_RANGE: Final = 3.0
_TIME_RANGE: Final = 1.5
_PERIOD_RANGE: Final = 0.5
"""How far logarithms may go from what the sources say. Circumnutation of common bean: 74 to 155 min (Ohad et al.)."""
SEARCHES: Final = 2
PERIODS_MIN: Final = (70.0, 76.0, 83.0, 90.0, 98.0, 107.0, 116.0, 126.0, 137.0, 149.0)
"""The likelihood of a period has several peaks: each of these is tried before a search."""
_SIZE_DOUBT: Final = 1.0
_TIME_DOUBT: Final = 0.3
"""Standard deviations of the logarithms of the noise's numbers before any data. A short strong noise of growth and a
long weak one leave nearly the same track; the sources decide between them."""
_TIMES: Final = ("wander_h", "nutation_exponent", "nutation_period_min", "nutation_coherence_h", "growth_h")


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of the traits before any data.

    Attributes:
        mean: of the mean over plants, shape (traits,).
        doubt: standard deviation of that, shape (traits,).
        spread: covariance between plants, shape (traits, traits).
    """

    mean: Array
    doubt: Array
    spread: Array


@dataclass(frozen=True, slots=True)
class Population:
    """What was learned.

    Attributes:
        prior: of a plant that was never seen.
        noise: what happens by chance.
        plants: the fits of the runs that it was learned from.
    """

    prior: Prior
    noise: DriveNoise
    plants: tuple[Fitted, ...]


def first_guess(known: Known) -> Population:
    """What there is before any data."""
    return Population(Prior(known.mean, known.spread + np.diag(known.doubt**2)), DriveNoise(), ())


def improved(seen: Sequence[Observed], known: Known, before: Population) -> Population:
    """One round of expectation and maximisation.

    Args:
        seen: the runs, all under one law. Two runs of one plant count as two plants.
        known: of its traits.
        before: of the round before, or :func:`first_guess`.
    """
    prior, noise = before.prior, before.noise
    starts = [found.traits for found in before.plants] or [prior.mean] * len(seen)
    fits = [
        fit(one, prior, covariance_of(one.responses(prior.mean), noise), start)
        for one, start in zip(seen, starts, strict=True)
    ]
    prior = _prior_of(fits, known)
    answers = [one.responses(prior.mean) for one in seen]
    typical = [found.residual + found.jacobian @ (found.traits - prior.mean) for found in fits]
    noise = _noise_of(seen, typical, [found.jacobian for found in fits], answers, prior)
    return Population(prior, noise, tuple(fits))


def mean_sd(found: Population, known: Known) -> Array:
    """How sure the mean over plants is: standard deviations, shape (traits,).

    Where it is not much less than what was doubted before, the tracks do not tell that trait.
    """
    spread = found.prior.covariance
    told = np.diag(known.doubt**-2)
    for plant in found.plants:
        told = told + plant.information @ np.linalg.inv(np.eye(len(spread)) + spread @ plant.information)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(told))))


def noise_about(seen: Sequence[Observed], prior: Prior) -> DriveNoise:
    """What happens by chance, if the plants differ as ``prior`` says and the law is right about the typical one."""
    linear = [linearised(one, prior.mean, np.sqrt(np.diag(prior.covariance))) for one in seen]
    residuals = [one.features - told for one, (told, _) in zip(seen, linear, strict=True)]
    answers = [one.responses(prior.mean) for one in seen]
    return _noise_of(seen, residuals, [jacobian for _, jacobian in linear], answers, prior)


def _prior_of(fits: Sequence[Fitted], known: Known) -> Prior:
    """Mean and covariance over plants: what the sources say, weighed against what the plants say."""
    count = len(fits)
    values = np.stack([f.traits for f in fits])
    doubt = np.diag(known.doubt**2)
    mean = values.mean(axis=0)
    for _ in range(3):
        away = values - mean
        scatter = away.T @ away + np.sum([f.covariance for f in fits], axis=0)
        spread = (scatter + SPREAD_STRENGTH * known.spread) / (count + SPREAD_STRENGTH)
        weight = doubt @ np.linalg.inv(doubt + spread / count)
        mean = known.mean + weight @ (values.mean(axis=0) - known.mean)
    return Prior(mean, spread)


def _noise_of(
    seen: Sequence[Observed],
    residuals: Sequence[Array],
    jacobians: Sequence[Array],
    answers: Sequence[Responses],
    prior: Prior,
) -> DriveNoise:
    """The noise under which the residuals of the typical plant are most probable, whatever the traits of each.

    Of long runs every second row is looked at: the cost goes with the cube of what is.
    """
    used = [one.row % (2 if one.row[-1] >= LONG_ROWS else 1) == 0 for one in seen]
    residuals = [residual[which] for residual, which in zip(residuals, used, strict=True)]
    jacobians = [jacobian[which] for jacobian, which in zip(jacobians, used, strict=True)]
    answers = [answer.of(which) for answer, which in zip(answers, used, strict=True)]
    guess = DriveNoise()
    first = guess.as_array()
    doubt = np.array([_TIME_DOUBT if name in _TIMES else _SIZE_DOUBT for name in NOISE_NAMES])
    individual = [jacobian @ prior.covariance @ jacobian.T for jacobian in jacobians]

    def improbability(values: Array) -> float:
        tried = guess.with_array(values)
        if tried.measure_cm < SMALLEST_MEASURE_CM or tried.growth_h < KNOT_H["growth"]:
            return _IMPOSSIBLE
        total = 0.5 * float(np.sum(((values - first) / doubt) ** 2))
        for residual, answer, differing in zip(residuals, answers, individual, strict=True):
            try:
                root = np.linalg.cholesky(covariance_of(answer, tried) + differing)
            except np.linalg.LinAlgError:
                return _IMPOSSIBLE
            white = scipy.linalg.solve_triangular(root, residual, lower=True)
            total += float(np.log(np.diag(root)).sum() + 0.5 * white @ white)
        return total

    options = {"maxfev": 15 * len(NOISE_NAMES), "xtol": 0.02, "ftol": 1e-5}
    reach = np.where(doubt == _TIME_DOUBT, _TIME_RANGE, _SIZE_RANGE)
    reach[NOISE_NAMES.index("nutation_period_min")] = _PERIOD_RANGE
    bounds = list(zip(first - reach, first + reach, strict=True))
    best = first
    for _ in range(SEARCHES):
        best = min((_with_period(best, minutes) for minutes in PERIODS_MIN), key=improbability)
        best = scipy.optimize.minimize(improbability, best, method="Powell", bounds=bounds, options=options).x
    return guess.with_array(np.asarray(best))


def _with_period(values: Array, minutes: float) -> Array:
    changed = np.array(values)
    changed[NOISE_NAMES.index("nutation_period_min")] = np.log(minutes)
    return changed
