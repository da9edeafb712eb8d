"""Nonlinear least squares by damped steps (Levenberg 1944; Marquardt 1963)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

import numpy as np

from flora_common.arrays import Array

_LEAST_DAMPING: Final = 1e-6
_FACTOR: Final = 10.0


class Place(Protocol):
    """Where a search may stand, with the model linearised there."""

    @property
    def misfit(self) -> float:
        """Half the sum of squares, with what was known before."""


At = TypeVar("At", bound=Place)


def descended(
    at: At,
    equations: Callable[[At], tuple[Array, Array]],
    better: Callable[[At, Array], At | None],
    *,
    steps: int,
    damping: float,
    most_damping: float,
    gained: float,
) -> At:
    """The place of least misfit that is reached from one.

    Args:
        at: the start.
        equations: the normal equations at a place: their matrix (n, n), and how the misfit falls, (n,).
        better: the place that a step (n,) leads to; None where the misfit is no less there.
        steps: that are taken at most.
        damping: of the first step.
        most_damping: a step that needs more leads nowhere.
        gained: the search ends after a step by which the misfit fell no more than this.
    """
    for _ in range(steps):
        normal, downhill = equations(at)
        scale = np.diag(np.diag(normal))
        reached = None
        while reached is None and damping < most_damping:
            reached = better(at, np.linalg.solve(normal + damping * scale, downhill))
            damping = damping * _FACTOR if reached is None else max(damping / _FACTOR, _LEAST_DAMPING)
        if reached is None:
            break
        fell = at.misfit - reached.misfit
        at = reached
        if fell <= gained:
            break
    return at
