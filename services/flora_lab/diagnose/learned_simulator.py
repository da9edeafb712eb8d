"""What a learned simulator lacks as a whole: the right clock, and a memory.

Both are the paper's own: pairs of photographs in which a stem does not move by a pixel were dropped, which leaves
plants that live too fast; and single shuffled steps carry nothing from one to the next, so that whatever a plant
remembers of its light and of its own motion cannot be in the model.

How often they are found, and what intervals of a clock are worth, was counted on simulators of drawn worlds
(``make discovery-simulators``, docs/results/discovery.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.special import stdtr, stdtrit

from flora_common.arrays import Array
from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.diagnose.forgotten import forgotten
from flora_lab.diagnose.verdict import LEAST_P, SUREST
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.rollout.time_scale import best_time_scale
from flora_lab.simulator.interface import History, Simulator
from flora_lab.simulator.measured import MeasuredRun

TIME_SCALE: Final = "time_scale"
MEMORY: Final = "memory"
_SEED: Final = 1
_CLEAR: Final = 1.15
"""A clock that is wrong by less is not told from individuals."""
_BETTER: Final = 0.9
"""The error at the right clock, over that at the simulator's own, below which it matters."""
_LEVEL: Final = 0.9
"""Of the interval, which must leave out a clock that is right."""
_PLANTS_DIFFER: Final = 0.15
"""By which the logarithms of plants' own factors differ where few plants tell; it counts as much as
:data:`_AS_PLANTS` plants. Their growth differs by 13 % (docs/how-to/train-a-simulator.md), other constants by more."""
_AS_PLANTS: Final = 4
_BEYOND: Final = "; the truth may lie beyond what was searched"
_MOMENTS: Final = 24
"""How often it is looked whether the simulator cares for the past."""
_PAST_H: Final = 6.0
_P_CLAIM: Final = 0.01
_SAME_CM: Final = 1e-6


def faults_of(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> list[NamedCause]:
    """What is wrong with a learned simulator as a whole, as measured runs tell; nothing where it is right."""
    found = [_clock(simulator, runs), _memory(simulator, runs)]
    return [fault for fault in found if fault is not None]


def still_wrong(
    faults: Sequence[NamedCause], corrected: Simulator[Any], runs: Sequence[MeasuredRun]
) -> list[NamedCause]:
    """The faults without a clock that is right once the effects that were found are beside the simulator: plants that
    grow more slowly look like a clock that is too fast.

    Args:
        faults: of the simulator as it is.
        corrected: with these effects.
        runs: measured.
    """
    is_in_question = any(fault.effect == TIME_SCALE for fault in faults)
    is_right = is_in_question and _clock(corrected, runs) is None
    return [fault for fault in faults if not (is_right and fault.effect == TIME_SCALE)]


def _clock(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> NamedCause | None:
    scale = best_time_scale(simulator, runs, _SEED)
    factor = scale.factor.value
    if scale.error_mm > _BETTER * scale.error_as_is_mm or abs(math.log(factor)) < math.log(_CLEAR):
        return None
    half, sure = clock_interval(factor, np.log(scale.of_each))
    if half >= max(factor, 1.0 / factor):
        return None
    effect = BY_NAME[TIME_SCALE]
    told = (
        f"; the tip error falls from {scale.error_as_is_mm:.0f} to {scale.error_mm:.0f} mm when its clock is set right"
    )
    sentence = effect.sentence({"factor": factor})
    return NamedCause(
        effect=effect.name,
        parameters={"factor": factor},
        interval={"factor": (factor / half, factor * half)},
        confidence=min(round(sure, 3), SUREST),
        p_value=max(LEAST_P, 2.0 * (1.0 - sure)),
        confusable_with=["growth_rate"],
        evidence=f"{sentence[0].upper()}{sentence[1:]}{told}{_BEYOND if scale.at_edge else ''}.",
        nats=0.0,
    )


def clock_interval(factor: float, of_each: Array) -> tuple[float, float]:
    """By which factor the ends of the 90 % interval of a clock lie to either side, and how likely it is wrong to the
    side that it is told to be.

    Student's, of plants' own factors, whose variance is held to what plants usually have where they are few; as far as
    these lie about another factor, it is wider.

    Args:
        factor: how many times too fast it is.
        of_each: logarithm of each plant's own factor, shape (plants,).
    """
    freedom = _AS_PLANTS + len(of_each) - 1
    squares = float(((of_each - of_each.mean()) ** 2).sum()) + _AS_PLANTS * _PLANTS_DIFFER**2
    aside = math.log(factor) - float(of_each.mean())
    error = math.sqrt(squares / freedom / len(of_each) + aside**2)
    half = float(stdtrit(freedom, (1.0 + _LEVEL) / 2.0)) * error
    return math.exp(half), float(stdtr(freedom, abs(math.log(factor)) / error))


def _memory(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> NamedCause | None:
    """Whether plants remember what the simulator forgets: its next stem does not depend on what went before, and its
    errors follow from the lamps of the hours before."""
    if not _forgets(simulator, runs):
        return None
    found = forgotten(simulator, runs)
    if found is None or found.p_value > _P_CLAIM:
        return None
    return NamedCause(
        effect=MEMORY,
        parameters={"time_constant_h": found.time_constant_h},
        interval={"time_constant_h": found.interval_h},
        confidence=min(round(1.0 - found.p_value, 3), SUREST),
        p_value=found.p_value,
        confusable_with=[],
        evidence=(
            "The simulator's next stem does not depend on what went before, a plant's does: the lamps of the hours "
            f"before tell {100.0 * found.share:.0f} % of what the simulator gets wrong about lamps that change "
            f"({100.0 * found.by_chance:.0f} % by chance)."
        ),
        nats=0.0,
    )


def _forgets(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> bool:
    """Whether a step from a stem is the same whatever was seen before it."""
    run = max(runs, key=len)
    rows_back = round(_PAST_H * 3600.0 / run.step_s)
    rows = np.flatnonzero(run.is_measured[:-1])
    rows = rows[rows >= rows_back]
    rows = rows[:: max(1, len(rows) // _MOMENTS)]
    for row in rows.tolist():
        start = row - rows_back
        while not run.is_measured[start]:
            start += 1
        stems, light = run.points_cm[start : row + 1, None], run.light[start:row, None]
        seen = simulator.watch(History(stems, light, run.step_s, {}))
        fresh = simulator.start(run.points_cm[row][None])
        now = run.light[row][None]
        after = [simulator.step(state, now, run.step_s)[1] for state in (seen, fresh)]
        if np.abs(after[0] - after[1]).max() > _SAME_CM:
            return False
    return len(rows) > 0
