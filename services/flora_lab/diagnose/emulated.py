"""Runs of a simulator itself, to learn what is taken for right where no reference runs are given."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import LEVELS, LampsSection
from flora_lab.diagnose.inputs import Runs
from flora_lab.simulator import interface
from flora_lab.simulator.interface import Chance, Simulator
from flora_lab.simulator.measured import STEP_S, MeasuredRun

COUNT: Final = 9
HOURS: Final = 72.0
SWITCH_H: Final = 6.0
_SEED: Final = 71_000
_DWELL_H: Final = (0.5, 10.0)


def reference_of(simulator: Simulator[Any], measured: Runs) -> Runs:
    """As many simulated runs as the paper has measured ones, from the first stems of the measured runs.

    Half of them under lamps that switch every six hours, half under each lamp for a time drawn from 0.5 to 10 h.
    Individuals and chance are the simulator's own; one that knows none gives the same plant again and again.
    """
    first = [run.points_cm[np.flatnonzero(run.is_measured)[0]] for run in measured.measured]
    starts = np.stack([first[i % len(first)] for i in range(COUNT)])
    lamps = next((run.lamps for run in measured.measured if run.lamps is not None), LampsSection())
    steps = int(HOURS * 3600.0 / STEP_S)
    light = np.stack([_light(i, steps) for i in range(COUNT)], axis=1)
    chance = Chance(np.arange(_SEED, _SEED + COUNT)) if simulator.has_individuals else None
    stems = interface.run(simulator, simulator.start(starts, chance), light, STEP_S)
    time_s = np.arange(steps + 1, dtype=np.float64) * float(STEP_S)
    runs = []
    for i in range(COUNT):
        points = np.concatenate([starts[i][None], stems[:, i]])
        runs.append(
            MeasuredRun(f"simulated {i + 1}", f"simulated {i + 1}", "", points, light[:, i], time_s, STEP_S, {}, lamps)
        )
    return Runs((), tuple(runs), (), ((),) * len(runs))


def _light(i: int, steps: int) -> FloatArray:
    hour = np.arange(steps) * STEP_S / 3600.0
    if i % 2 == 0:
        right = (hour // SWITCH_H + i // 2) % 2 == 1
    else:
        draw = np.random.default_rng([_SEED, i])
        ends = np.cumsum(draw.uniform(*_DWELL_H, size=200))
        right = (np.searchsorted(ends, hour, side="right") + i // 2) % 2 == 1
    return np.asarray(np.where(right[:, None], np.array(LEVELS["right"]), np.array(LEVELS["left"])), dtype=np.float64)
