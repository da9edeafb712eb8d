"""Damped least squares, on a curve with a known bottom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from flora_common.arrays import Array
from flora_lab.levenberg_marquardt import descended

TIMES = np.linspace(0.0, 4.0, 30)
TRUE = np.array([2.0, 0.7])
MEASURED = TRUE[0] * np.exp(-TRUE[1] * TIMES)


@dataclass(frozen=True)
class At:
    """A decay that is tried: size and rate."""

    size_and_rate: Array

    @property
    def residual(self) -> Array:
        size, rate = self.size_and_rate
        return np.asarray(MEASURED - size * np.exp(-rate * TIMES))

    @property
    def misfit(self) -> float:
        return 0.5 * float(self.residual @ self.residual)

    def equations(self) -> tuple[Array, Array]:
        size, rate = self.size_and_rate
        decay = np.exp(-rate * TIMES)
        jacobian = np.column_stack([decay, -size * TIMES * decay])
        return jacobian.T @ jacobian, jacobian.T @ self.residual


def better(at: At, step: Array) -> At | None:
    new = At(at.size_and_rate + step)
    return new if new.misfit < at.misfit else None


def from_far(steps: int = 50, gained: float = 1e-15) -> At:
    start = At(np.array([0.3, 3.0]))
    return descended(start, At.equations, better, steps=steps, damping=1e-3, most_damping=1e5, gained=gained)


def test_the_bottom_is_reached_from_far() -> None:
    assert from_far().size_and_rate == pytest.approx(TRUE, abs=1e-6)


def test_each_step_is_downhill_and_no_more_are_taken_than_asked() -> None:
    misfits = [from_far(steps).misfit for steps in range(6)]
    assert misfits[0] == At(np.array([0.3, 3.0])).misfit
    assert misfits == sorted(misfits, reverse=True)
    assert len(set(misfits)) == len(misfits)


def test_a_step_that_gains_little_is_the_last() -> None:
    assert from_far(gained=1e9).misfit == from_far(steps=1).misfit > from_far().misfit


def test_where_no_step_leads_to_anything_better_the_start_is_kept() -> None:
    start = At(np.array([0.3, 3.0]))
    dampings: list[float] = []

    def nowhere(_at: At, step: Array) -> At | None:
        dampings.append(float(np.abs(step).max()))
        return None

    found = descended(start, At.equations, nowhere, steps=5, damping=1e-3, most_damping=1e5, gained=0.0)
    assert found is start
    assert len(dampings) == 8  # 1e-3 to 1e4
    assert dampings == sorted(dampings, reverse=True)  # shorter and shorter
