"""What the plants of several runs have in common, how they differ, and what happened to them by chance.

Expectation-maximisation with Laplace's approximation: each plant's constants given what is known of all, then what is
known of all given each plant's constants; the noise by maximum likelihood of the free-run residuals in between, with
the plants' unknown constants integrated out. What was known before enters as prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from flora_lab.simulator.drives import NOISE_NAMES, DriveNoise
from flora_lab.simulator.individual import Fitted, Observed, Prior, Responses, covariance_of, fit

Array = npt.NDArray[Any]

ROUNDS: Final = 3
SPREAD_STRENGTH: Final = 9.0
"""The prior of the spread counts as much as this many plants."""
_SMALLEST_MEASURE_CM: Final = 0.05
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


def learn(
    seen: Sequence[Observed],
    known: Known,
    *,
    starts: Sequence[Array] | None = None,
    rounds: int = ROUNDS,
    on_round: Callable[[int, int], None] = lambda done, of: None,
) -> Population:
    """Learn a population from one run or more.

    Args:
        seen: the runs, all under one law.
        known: of its traits.
        starts: traits to begin with, one per run.
        rounds: of expectation and maximisation.
        on_round: told rounds done and rounds in all.
    """
    prior, noise = Prior(known.mean, known.spread + np.diag(known.doubt**2)), DriveNoise()
    fits: list[Fitted] = []
    answers = [one.responses(prior.mean) for one in seen]
    first = [prior.mean] * len(seen) if starts is None else starts
    for number in range(rounds):
        fits = [
            fit(one, prior, covariance_of(answer, noise), start)
            for one, answer, start in zip(seen, answers, [f.traits for f in fits] or first, strict=True)
        ]
        prior = _prior_of(fits, known)
        answers = [one.responses(prior.mean) for one in seen]
        noise = _noise_of(fits, answers, prior, noise)
        on_round(number + 1, rounds)
    return Population(prior, noise, tuple(fits))


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


def _noise_of(fits: Sequence[Fitted], answers: Sequence[Responses], prior: Prior, noise: DriveNoise) -> DriveNoise:
    """The noise under which the residuals of the typical plant are most probable."""
    first = DriveNoise().as_array()
    doubt = np.array([_TIME_DOUBT if name in _TIMES else _SIZE_DOUBT for name in NOISE_NAMES])
    data = []
    for found, answer in zip(fits, answers, strict=True):
        typical = found.residual + found.jacobian @ (found.traits - prior.mean)
        data.append((typical, answer, found.jacobian @ prior.covariance @ found.jacobian.T))

    def improbability(values: Array) -> float:
        if not np.all(np.abs(values - first) < 4.0):
            return 1e12
        tried = noise.with_array(values)
        if tried.measure_cm < _SMALLEST_MEASURE_CM:
            return 1e12
        total = 0.5 * float(np.sum(((values - first) / doubt) ** 2))
        for residual, answer, individual in data:
            covariance = covariance_of(answer, tried) + individual
            try:
                root = np.linalg.cholesky(covariance)
            except np.linalg.LinAlgError:
                return 1e12
            white = scipy.linalg.solve_triangular(root, residual, lower=True)
            total += float(np.log(np.diag(root)).sum() + 0.5 * white @ white)
        return total

    options = {"maxfev": 30 * len(NOISE_NAMES), "xtol": 0.02, "ftol": 1e-5}
    found = scipy.optimize.minimize(improbability, noise.as_array(), method="Powell", options=options)
    return noise.with_array(np.asarray(found.x))
