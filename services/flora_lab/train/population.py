"""What the plants of several runs have in common, how they differ, and what happened to them by chance.

Expectation-maximisation with Laplace's approximation: each plant's constants given what is known of all, then what is
known of all given each plant's constants; the noise by maximum likelihood of the free-run residuals in between, with
the plants' unknown constants integrated out. Literature enters as prior (:mod:`flora_lab.simulator.rod_parameters`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from flora_lab.simulator.rod_fit import Fitted, Observed, Prior, Responses, covariance_of, fit
from flora_lab.simulator.rod_noise import NOISE_NAMES, RodNoise
from flora_lab.simulator.rod_parameters import prior_doubt, prior_mean, prior_spread

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
class Population:
    """What was learned.

    Attributes:
        prior: of a plant that was never seen.
        noise: what happens by chance.
        plants: the fits of the runs that it was learned from.
    """

    prior: Prior
    noise: RodNoise
    plants: tuple[Fitted, ...]


def learn(seen: Sequence[Observed], *, on_round: Callable[[int, int], None] = lambda done, of: None) -> Population:
    """Learn a population from one run or more.

    Args:
        seen: the runs.
        on_round: told rounds done and rounds in all.
    """
    spread0 = prior_spread()
    prior, noise = Prior(prior_mean(), spread0 + np.diag(prior_doubt() ** 2)), RodNoise()
    fits: list[Fitted] = []
    answers = [one.responses(np.exp(prior.mean)) for one in seen]
    for number in range(ROUNDS):
        starts = [f.log_parameters for f in fits] or [prior.mean] * len(seen)
        fits = [
            fit(one, prior, covariance_of(answer, noise), start)
            for one, answer, start in zip(seen, answers, starts, strict=True)
        ]
        prior = _prior_of(fits, spread0)
        typical = np.exp(prior.mean)
        answers = [one.responses(typical) for one in seen]
        noise = _noise_of(fits, answers, prior, noise)
        on_round(number + 1, ROUNDS)
    return Population(prior, noise, tuple(fits))


def _prior_of(fits: Sequence[Fitted], spread0: Array) -> Prior:
    """Mean and covariance over plants: what the sources say, weighed against what the plants say."""
    count = len(fits)
    values = np.stack([f.log_parameters for f in fits])
    mean0, doubt = prior_mean(), np.diag(prior_doubt() ** 2)
    mean = values.mean(axis=0)
    for _ in range(3):
        away = values - mean
        scatter = away.T @ away + np.sum([f.covariance for f in fits], axis=0)
        spread = (scatter + SPREAD_STRENGTH * spread0) / (count + SPREAD_STRENGTH)
        weight = doubt @ np.linalg.inv(doubt + spread / count)
        mean = mean0 + weight @ (values.mean(axis=0) - mean0)
    return Prior(mean, spread)


def _noise_of(fits: Sequence[Fitted], answers: Sequence[Responses], prior: Prior, noise: RodNoise) -> RodNoise:
    """The noise under which the residuals of the typical plant are most probable."""
    first = RodNoise().as_array()
    doubt = np.array([_TIME_DOUBT if name in _TIMES else _SIZE_DOUBT for name in NOISE_NAMES])
    data = []
    for found, answer in zip(fits, answers, strict=True):
        typical = found.residual + found.jacobian @ (found.log_parameters - prior.mean)
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
