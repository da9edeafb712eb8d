"""The constants of the mechanistic law, what was known of them before any data, and how plants differ in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array


@dataclass(frozen=True, slots=True)
class Parameter:
    """A positive constant of a plant; its logarithm is normal over plants.

    Attributes:
        name: with its unit.
        typical: the prior's median over plants.
        doubt: standard deviation of the logarithm of the median before any data: how little the sources say.
        spread: standard deviation of the logarithm between plants before any data.
        source: where that is from.
    """

    name: str
    typical: float
    doubt: float
    spread: float
    source: str


PARAMETERS: Final = (
    Parameter("growth_early_cm_per_day", 3.0, 0.4, 0.13, "Checa et al. 2008 through Wahby et al. 2018: 3 cm/day"),
    Parameter("growth_late_cm_per_day", 7.0, 0.3, 0.13, "Wahby et al. 2018: to 21 cm in 72 h, about 7 cm/day late"),
    Parameter("growth_zone_cm", 6.0, 0.3, 0.13, "Bastien et al. 2015: growth zones of stems of a few cm"),
    Parameter("stiffening_cm", 5.0, 0.15, 0.13, "Ohad et al., 54 plants: e-fold of the modulus 5.0 cm (3.5-6.3)"),
    Parameter("mature_cm", 13.0, 0.3, 0.13, "estimate: the stems of Wahby et al. 2018 keep their curve for days"),
    Parameter("photoception_per_cm_h", 0.3, 0.7, 0.13, "Bastien et al. 2015: ratio to graviception of order one"),
    Parameter("graviception_per_cm_h", 0.3, 0.7, 0.13, "Bastien et al. 2013: beta * L_gz / gamma below 2.8"),
    Parameter("proprioception_per_h", 0.7, 0.7, 0.13, "Bastien et al. 2013: curvature decays within hours"),
    Parameter("photo_latency_min", 20.0, 0.5, 0.20, "Arabidopsis, buckwheat: a few minutes to about 60 min"),
)
"""In the order of the columns in :mod:`flora_lab.simulator.tropism`."""

NAMES: Final = tuple(p.name for p in PARAMETERS)

VIGOUR: Final = 0.3
"""Correlation of the two rates of growth between plants before any data: an estimate."""


def prior_mean() -> Array:
    """Logarithms of the typical values, shape (9,)."""
    return np.log([p.typical for p in PARAMETERS])


def prior_doubt() -> Array:
    """Shape (9,)."""
    return np.array([p.doubt for p in PARAMETERS])


def prior_spread() -> Array:
    """Covariance of the logarithms between plants, shape (9, 9).

    The two rates of growth go together: a plant that is fast early tends to be fast late.
    """
    spread = np.array([p.spread for p in PARAMETERS])
    together = np.eye(len(PARAMETERS))
    together[0, 1] = together[1, 0] = VIGOUR
    return np.asarray(together * spread[:, None] * spread[None, :])
