"""How sure a median over plants is, by resampling plants.

Rows of one run, and runs of one plant, are alike: they tell of the same individual. To resample them as if each were a
plant of its own gives intervals that are much too narrow. So each plant becomes one number first (the median of its
own), and plants are drawn with replacement (Davison & Hinkley 1997, "Bootstrap Methods and their Application", sections
3.8: resampling of clusters).

Ends are percentiles of the resampled statistic, further out than 2.5 and 97.5 by as much as a t-interval is wider than
one that takes the spread for known ("expanded percentile", Hesterberg 2015, "What Teachers Should Know About the
Bootstrap", The American Statistician 69:371): plain percentiles are too narrow for few plants, 87 instead of 95 % with
seven. An interval of a median lies between the plants' own values whatever is done. With n plants the two outermost
enclose the true median with probability ``1 - 2 ** (1 - n)``, which is below 95 % for fewer than six.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr, stdtrit

from flora_common.arrays import Array, FloatArray
from flora_common.counted import counted

LEVEL: Final = 0.95
RESAMPLES: Final = 4000
FEWEST_PLANTS: Final = 3
ENOUGH_PLANTS: Final = 6
"""The first number of plants of which the outermost enclose the median with at least :data:`LEVEL`."""

Statistic = Callable[[FloatArray], FloatArray]
"""From plants along the last axis to one number for each of the others."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number and how sure it is.

    Attributes:
        value: NaN where there was nothing to take it from.
        low, high: ends of the interval; None with fewer than :data:`FEWEST_PLANTS` plants.
        plants: how many it is from.
    """

    value: float
    low: float | None
    high: float | None
    plants: int


def by_plant(values: FloatArray, plants: Sequence[str]) -> FloatArray:
    """One number for each plant: the median of what there is of it.

    Args:
        values: shape (..., n), NaN where there is nothing.
        plants: length n: whose each is.

    Returns:
        Shape (plants,), plants in the order of their first appearance; NaN for a plant of which there is nothing.
    """
    names = list(dict.fromkeys(plants))
    own = np.array([names.index(plant) for plant in plants])
    medians = np.full(len(names), np.nan)
    for i in range(len(names)):
        there = values[..., own == i]
        there = there[np.isfinite(there)]
        if len(there):
            medians[i] = np.median(there)
    return medians


def median(values: FloatArray, seed: int) -> Estimate:
    """Median over plants with its interval; shape (plants,), NaN are left out."""
    return estimate(values, _median, seed)


def ratio_of_medians(above: FloatArray, below: FloatArray, seed: int) -> Estimate:
    """Median of ``above`` over that of ``below``; both shape (plants,), of the same plants, drawn together."""
    return estimate(np.stack([above, below]), _ratio, seed)


def estimate(values: FloatArray, statistic: Statistic, seed: int) -> Estimate:
    """A statistic with its interval.

    Args:
        values: shape (..., plants); plants with a NaN are left out.
        statistic: see :data:`Statistic`.
        seed: of the resampling; equal seeds draw the same plants, whatever the values.
    """
    values = values[..., np.isfinite(values).all(axis=tuple(range(values.ndim - 1)))]
    plants = values.shape[-1]
    if plants == 0:
        return Estimate(float("nan"), None, None, 0)
    value = float(statistic(values))
    if plants < FEWEST_PLANTS:
        return Estimate(value, None, None, plants)
    drawn = statistic(values[..., resampled(plants, seed)])
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) == 0:  # a ratio to errors that are all 0
        return Estimate(value, None, None, plants)
    return Estimate(value, *ends(drawn, plants), plants)


def ends(drawn: FloatArray, plants: int) -> tuple[float, float]:
    """Ends of the interval from the statistic of resampled plants, shape (times,); see the module's text."""
    tail = ndtr(np.sqrt(plants / (plants - 1)) * stdtrit(plants - 1, (1.0 - LEVEL) / 2.0))
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return float(low), float(high)


def resampled(plants: int, seed: int, times: int = RESAMPLES) -> Array:
    """Plants drawn with replacement, as many as there are; shape (times, plants)."""
    return np.random.default_rng([seed, plants]).integers(plants, size=(times, plants))


def how_sure(plants: int) -> str:
    """A sentence on what the intervals are worth."""
    if plants < FEWEST_PLANTS:
        return (
            f"{counted(plants, 'plant')}: no intervals, for the differences between plants cannot be told from fewer "
            f"than {FEWEST_PLANTS}"
        )
    sentence = f"{plants} plants; in brackets {100 * LEVEL:.0f} % intervals, by resampling plants"
    if plants < ENOUGH_PLANTS:
        sentence += (
            f"; with {plants} plants no such interval holds a median more often than "
            f"{100 * (1 - 2.0 ** (1 - plants)):.0f} % of the time"
        )
    return sentence


def _median(values: FloatArray) -> FloatArray:
    middle: FloatArray = np.median(values, axis=-1)
    return middle


def _ratio(values: FloatArray) -> FloatArray:
    above, below = np.median(values[0], axis=-1), np.median(values[1], axis=-1)
    ratio: FloatArray = np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0.0)
    return ratio
