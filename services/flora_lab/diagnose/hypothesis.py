"""Causes that act together, and how what they change follows their parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.effects.effect import Change, Effect, Parameter
from flora_lab.simulator.tropism_traits import NAMES

STEP_SPREAD: Final = 0.05
"""Of differences, in standard deviations of what is known before."""


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect in one of its forms."""

    effect: Effect
    form: int = 0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.effect.parameters

    def values(self, coordinates: Array) -> dict[str, float]:
        """Parameters by name, at these coordinates."""
        return {p.name: p.value(float(u)) for p, u in zip(self.parameters, coordinates, strict=True)}

    def act(self, change: Change, coordinates: Array) -> None:
        """Add what it changes, with parameters at these coordinates."""
        self.effect.forms[self.form](change, self.values(coordinates))


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Causes that act together; none is the simulator as it is."""

    causes: tuple[Cause, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of all causes, in their order."""
        return tuple(p for cause in self.causes for p in cause.parameters)

    def change(self, coordinates: Array) -> Change:
        """What the causes change, with parameters at these coordinates."""
        change = Change()
        for cause, own in zip(self.causes, self.shares(coordinates), strict=True):
            cause.act(change, own)
        return change

    def shares(self, coordinates: Array) -> list[Array]:
        """The coordinates of each cause."""
        ends = np.cumsum([len(cause.parameters) for cause in self.causes], dtype=np.int64)
        return [coordinates[end - len(cause.parameters) : end] for cause, end in zip(self.causes, ends, strict=True)]

    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(cause.effect.name for cause in self.causes)


@dataclass(frozen=True, slots=True)
class Pushed:
    """A hypothesis with its last parameters a little more and a little less.

    Attributes:
        changes: that of the hypothesis, those with more and those with less, where anything but traits changes.
        shifts: derivative of the traits in each parameter, shape (9, count).
        acting: parameters that change more than traits.
        widths: of the differences, shape (count,).
    """

    changes: list[Change]
    shifts: Array
    acting: list[int]
    widths: Array

    def slopes(self, told: Array) -> Array:
        """Derivatives, traits held, (m + 2, count), from what all changes but the first give, (changes - 1, m + 2)."""
        found = np.zeros((told.shape[1], len(self.widths)))
        up, down = told.reshape(2, len(self.acting), told.shape[1])
        found[:, self.acting] = ((up - down) / (2.0 * self.widths[self.acting, None])).T
        return found


def pushed_by(hypothesis: Hypothesis, coordinates: Array, count: int) -> Pushed:
    """See :class:`Pushed`, for the last ``count`` parameters."""
    here = hypothesis.change(coordinates)
    first = len(coordinates) - count
    widths = np.array([STEP_SPREAD * p.spread for p in hypothesis.parameters[first:]])
    shifts = np.zeros((len(NAMES), count))
    acting, more, less = [], [], []
    for k in range(count):
        away = np.zeros(len(coordinates))
        away[first + k] = widths[k]
        up, down = hypothesis.change(coordinates + away), hypothesis.change(coordinates - away)
        shifts[:, k] = (up.traits - down.traits) / (2.0 * widths[k])
        if not up.is_but_for_traits(down):
            acting.append(k)
            more.append(replace(up, traits=here.traits))
            less.append(replace(down, traits=here.traits))
    return Pushed([here, *more, *less], shifts, acting, widths)
