"""How many times too fast a simulated plant is: the factor at which, set right by it, it errs least."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_lab.rollout.at_time_scale import AtTimeScale
from flora_lab.rollout.free_running import free_run
from flora_lab.rollout.intervals import FEWEST_PLANTS, Estimate, by_plant, ends, resampled
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import MeasuredRun, by_step

RANGE: Final = (0.25, 32.0)
COARSE: Final = 22
"""Factors over the range, each 1.26 times the one before."""
FINE: Final = 31
"""Factors between those on either side of the best coarse ones."""
FREE_RUNS: Final = COARSE + FINE
"""How often a simulator runs free for this, at most."""


@dataclass(frozen=True, slots=True)
class TimeScale:
    """The best factor of one simulator on some runs.

    Attributes:
        factor: 2 for a plant that does in an hour what the measured ones need two for; with its interval over plants.
        error_mm: median over plants of the mean tip error of the run, from its first stem to its end, at that factor.
        error_as_is_mm: the same at factor 1.
        at_edge: the best factor, or an end of its interval, is an end of :data:`RANGE`; the truth may lie beyond.
        factors, errors_mm: all that were tried, in order.
        of_each: the best factor of each plant, shape (plants,).
    """

    factor: Estimate
    error_mm: float
    error_as_is_mm: float
    at_edge: bool
    factors: FloatArray
    errors_mm: FloatArray
    of_each: FloatArray


def mean_tip_errors_mm(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> FloatArray:
    """Mean tip error of each plant over its runs' whole length, from the first stem on; shape (plants,)."""
    errors_mm = np.empty(len(runs))
    for places in by_step(runs):
        free = free_run(simulator, [runs[i] for i in places], np.zeros(len(places), dtype=np.int64), watched=False)
        errors_mm[places] = np.nanmean(free.errors.tip_mm[1:], axis=0)
    return by_plant(errors_mm, [run.plant for run in runs])


def best_time_scale(
    simulator: Simulator[Any],
    runs: Sequence[MeasuredRun],
    seed: int,
    on_run: Callable[[], None] = lambda: None,
) -> TimeScale:
    """Search the factor that minimises the median over plants of :func:`mean_tip_errors_mm`.

    A coarse search over :data:`RANGE`, then a fine one as far as resampled plants have their best factor. Of factors
    that do equally well the one nearest to 1 is taken.

    Args:
        simulator: whom.
        runs: measured; each is simulated in its own step.
        seed: of the resampling of plants.
        on_run: called after each free run.
    """
    errors: dict[float, FloatArray] = {}

    def run_at(factors: FloatArray) -> None:
        for factor in np.round(factors, 6).tolist():
            if factor not in errors:
                errors[factor] = mean_tip_errors_mm(AtTimeScale(simulator, factor), runs)
            on_run()

    coarse = np.geomspace(*RANGE, COARSE)
    coarse[np.argmin(np.abs(np.log(coarse)))] = 1.0  # as it is
    run_at(coarse)
    best = _best(errors, seed)
    low, high = np.searchsorted(coarse, [best.min() * (1 - 1e-6), best.max() * (1 - 1e-6)])
    run_at(np.geomspace(coarse[max(low - 1, 0)], coarse[min(high + 1, COARSE - 1)], FINE))
    best = _best(errors, seed)
    factors = np.array(sorted(errors))
    medians = np.array([np.median(errors[factor]) for factor in factors.tolist()])
    chosen = float(best[0])
    plants = len(errors[1.0])
    low, high = ends(best[1:], plants) if len(best) > 1 else (None, None)
    return TimeScale(
        Estimate(chosen, low, high, plants),
        float(np.median(errors[chosen])),
        float(np.median(errors[1.0])),
        any(factor in (factors[0], factors[-1]) for factor in (chosen, low, high)),
        factors,
        medians,
        _best_of_each(errors),
    )


def _best(errors: dict[float, FloatArray], seed: int) -> FloatArray:
    """The best factor for all plants, and after it those for resampled ones where there are enough plants."""
    factors, values = _nearest_to_1_first(errors)
    best = factors[[int(np.argmin(np.median(values, axis=-1)))]]
    plants = values.shape[-1]
    if plants < FEWEST_PLANTS:
        return best
    drawn = np.median(values[:, resampled(plants, seed, times=1000)], axis=-1)
    return np.concatenate([best, factors[np.argmin(drawn, axis=0)]])


def _best_of_each(errors: dict[float, FloatArray]) -> FloatArray:
    """The best factor of each plant, shape (plants,)."""
    factors, values = _nearest_to_1_first(errors)
    return np.asarray(factors[np.argmin(values, axis=0)], dtype=np.float64)


def _nearest_to_1_first(errors: dict[float, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Factors, and the errors of all plants at each, shape (factors, plants): of equal ones the first is taken."""
    factors = np.array(sorted(errors, key=lambda factor: (abs(np.log(factor)), factor)))
    return factors, np.stack([errors[factor] for factor in factors.tolist()])
