"""Whether a plant departs from its simulator, asked again at every hour of a run, with one rate of false alarms.

What is judged are innovations: what an hour brings beyond what the simulator, its chance and all hours before let
expect. If the simulator is right they are independent and of unit size, whatever the lamps did and whoever steered
them: a lamp is chosen before the hour that it is judged by.

The evidence are bets against the simulator that together start with one unit. Each hour multiplies a bet by how much
more probable its innovations are if, from some hour on, they are wider than they should be (:data:`WIDER`), or if
something pushes the plant all the time (:mod:`flora_lab.serve.expecting`). If the simulator is right, the chance that
they are ever worth ``1 / a`` is at most ``a`` (Ville 1939), however often one looks: nothing has to be corrected for
looking again. See Ramdas et al., "Game-theoretic statistics and safe anytime-valid inference", Statistical Science 38,
2023.

Runs differ in how well the simulator fits them. Half of the allowed rate is spent on how large innovations of a run may
be at all, told by the reference runs; the other half on the bets. All bets are on more than that: they win less still
where innovations are smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import scipy.stats

from flora_common.arrays import Array

WIDER: Final = np.array([1.5, 2.0, 4.0, 10.0, 40.0, 400.0])
"""Variances of innovations that are bet on, in units of what they are at most."""
_FROM_THE_START: Final = 0.5
"""Share of the bets that something is wrong from the first hour on."""
_SOON_H: Final = 72.0
"""Half of the other bets are on its beginning within so many hours."""
_LEAST_LOG_SD: Final = 0.2
"""Of the mean squares of runs, where reference runs differ less: the chance that they are judged by was fitted to
them."""


def largest_usual(misfits: Array, rate: float) -> float:
    """The mean square of innovations that a run exceeds with probability ``rate``, where the simulator is right.

    Args:
        misfits: of the reference runs, shape (n,), n >= 2.
        rate: between 0 and 1.
    """
    logs = np.log(misfits)
    sd = max(float(logs.std(ddof=1)), _LEAST_LOG_SD) * np.sqrt(1.0 + 1.0 / len(logs))
    return float(np.exp(logs.mean() + scipy.stats.t.ppf(1.0 - rate, len(logs) - 1) * sd))


def wider(squares: float, count: int, usual: float) -> Array:
    """Logarithms of how much more probable an hour is if innovations are wider, shape (len(WIDER),).

    Args:
        squares: sum of the squares of its innovations.
        count: of them.
        usual: their mean square, at most.
    """
    return np.asarray(0.5 * squares / usual * (1.0 - 1.0 / WIDER) - 0.5 * count * np.log(WIDER))


def log_worth(hours: Sequence[Sequence[float]]) -> Array:
    """Logarithm of what all bets together are worth after each hour, shape (hours,).

    Args:
        hours: since the bets began, for each the logarithms of how much more probable it is under each of them; they
            are zero where nothing was measured.
    """
    ratio = np.asarray(hours, dtype=np.float64)
    if not len(ratio):
        return np.zeros(0)
    shares = np.log(_shares(len(ratio)))
    told = np.concatenate([np.zeros((1, ratio.shape[1])), np.cumsum(ratio, axis=0)])
    out = np.empty(len(ratio))
    for now in range(len(ratio)):
        since = np.logaddexp.reduce(told[now + 1] - told[: now + 1], axis=1) - np.log(ratio.shape[1])
        not_begun = np.log(max(1.0 - float(np.exp(shares[: now + 1]).sum()), 1e-12))
        out[now] = np.logaddexp(np.logaddexp.reduce(shares[: now + 1] + since), not_begun)
    return out


def threshold(rate: float) -> float:
    """Logarithm of the worth that is reached with probability ``rate`` at most, where the simulator is right."""
    return float(-np.log(rate))


def _shares(hours: int) -> Array:
    """What is bet on each hour as the one where it begins; of all hours together, for ever, they are 1."""
    k = np.arange(hours, dtype=np.float64)
    later = (1.0 - _FROM_THE_START) * _SOON_H * (1.0 / (k - 1.0 + _SOON_H) - 1.0 / (k + _SOON_H))
    return np.asarray(np.where(k == 0.0, _FROM_THE_START, later))
