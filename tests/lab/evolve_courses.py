"""Courses of plants under given lights, by the compiled plants of evolution."""

from __future__ import annotations

from typing import Any

import numpy as np

from flora_lab.evolve.plants_kinds import plants_of
from flora_lab.evolve.task import LEFT
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.rod import jit


@jit
def advanced(plants: Any, is_right: Any, out: Any) -> None:
    """The courses of plants, all of which start in row 0; ``is_right`` is (steps, rows), ``out`` (steps, rows, ...)."""
    rows = is_right.shape[1]
    plants.copy_rows(np.zeros(rows, dtype=np.int64), np.arange(rows), rows)
    for k in range(len(is_right)):
        plants.advance(rows, is_right[k], k)
        plants.points(rows, out[k])


def courses(simulator: Simulator[Any], is_right: Any) -> Any:
    """Stems after each step, cm; shape (steps, rows, 10, 2)."""
    out = np.empty((*is_right.shape, 10, 2))
    advanced(plants_of(simulator, LEFT, None, is_right.shape[1]), is_right, out)
    return out
