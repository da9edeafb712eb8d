"""What a learned simulator lacks as a whole: the right clock, and a memory.

Both are the paper's own: pairs of photographs in which a stem does not move by a pixel were dropped, which leaves
plants that live too fast; and single shuffled steps carry nothing from one to the next, so that whatever a plant
remembers of its light and of its own motion cannot be in the model.

Intervals and confidences of these two faults are no posterior, as those of causes of the catalogue are, though they
stand in the same columns and are shown as 90 %. Each constant says what it rests on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.rollout.intervals import LEVEL
from flora_lab.rollout.time_scale import TimeScale, best_time_scale
from flora_lab.simulator.interface import History, Simulator
from flora_lab.simulator.measured import MeasuredRun

TIME_SCALE: Final = "time_scale"
MEMORY: Final = "memory"
_SEED: Final = 1
_CLEAR: Final = 1.15
"""A clock that is wrong by less is not told from individuals."""
_BETTER: Final = 0.9
"""The error at the right clock, over that at the simulator's own, below which it matters."""
_SURE_BY_PLANTS: Final = LEVEL
"""Confidence in a wrong clock where the interval over plants excludes 1: that interval's own level. With fewer than six
plants it holds less, with three plants three in four, see :mod:`flora_lab.rollout.intervals`; it is told as 90 %."""
_SURE_BY_ERROR: Final = 0.8
"""Confidence in a wrong clock of too few plants for an interval: chosen, to be below the other; nothing was counted."""
_NEAR_BEST: Final = 1.1
"""Error over the least one up to which factors count as its interval then: chosen, of no known level."""
_SHIFTS: Final = 400
_MOMENTS: Final = 24
"""How often it is looked whether the simulator cares for the past."""
_PAST_H: Final = 6.0
_P_CLAIM: Final = 0.01
_SURE_OF_MEMORY: Final = 0.97
"""Confidence in a memory that the simulator lacks: chosen, nothing was counted. What is measured is ``p_value``, and
:data:`_P_CLAIM` the most of it with which one is told."""
_MEMORY_TIMES: Final = 2.0
"""A memory's time constant is told to lie between its estimate over this and times this: chosen, of no known level."""
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
    factor, low, high = scale.factor.value, scale.factor.low, scale.factor.high
    if scale.error_mm > _BETTER * scale.error_as_is_mm or abs(math.log(factor)) < math.log(_CLEAR):
        return None
    if low is None or high is None:
        low, high, sure = *_by_error(scale), _SURE_BY_ERROR
    elif low <= 1.0 <= high:
        return None
    else:
        sure = _SURE_BY_PLANTS
    effect = BY_NAME[TIME_SCALE]
    told = (
        f"; the tip error falls from {scale.error_as_is_mm:.0f} to {scale.error_mm:.0f} mm when its clock is set right"
    )
    sentence = effect.sentence({"factor": factor})
    return NamedCause(
        effect=effect.name,
        parameters={"factor": factor},
        interval={"factor": (low, high)},
        confidence=sure,
        p_value=0.05,
        confusable_with=["growth_rate"],
        evidence=sentence[0].upper() + sentence[1:] + told + ".",
        nats=0.0,
    )


def _by_error(scale: TimeScale) -> tuple[float, float]:
    """Factors at which the error is hardly more than at the best: what too few plants allow to say."""
    near = scale.factors[scale.errors_mm <= _NEAR_BEST * scale.errors_mm.min()]
    return float(near.min()), float(near.max())


def _memory(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> NamedCause | None:
    """Whether plants remember what the simulator forgets.

    The simulator's next stem must not depend on what went before, and its one-step errors must follow from the plant's
    own last step, in runs other than those that the rule is from if there are any; more than they do when the past is
    shifted in time.
    """
    if not _forgets(simulator, runs):
        return None
    errors, past = zip(*(_steps(simulator, run) for run in runs), strict=True)
    share = _told_by_past(errors, past)
    draw = np.random.default_rng(_SEED)
    by_chance = []
    for _ in range(_SHIFTS):
        shifted = [np.roll(p, int(draw.integers(len(p) // 10, len(p) - len(p) // 10)), axis=0) for p in past]
        by_chance.append(_told_by_past(errors, shifted))
    p_value = (1.0 + sum(value >= share for value in by_chance)) / (_SHIFTS + 1.0)
    if p_value > _P_CLAIM or share <= 0.0:
        return None
    hours = float(np.median([_lasting_h(e, run.step_s) for e, run in zip(errors, runs, strict=True)]))
    where = "runs that the rule is not from" if len(runs) > 1 else "the run that the rule is from"
    return NamedCause(
        effect=MEMORY,
        parameters={"time_constant_h": hours},
        interval={"time_constant_h": (hours / _MEMORY_TIMES, hours * _MEMORY_TIMES)},
        confidence=_SURE_OF_MEMORY,
        p_value=float(p_value),
        confusable_with=[],
        evidence=(
            "The simulator's next stem does not depend on what went before, a plant's does: its last step tells "
            f"{100.0 * share:.0f} % of the variance of the simulator's errors in {where}."
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


def _steps(simulator: Simulator[Any], run: MeasuredRun) -> tuple[Array, Array]:
    """Errors of the tip after one row, shape (n, 2), and the plant's own way in the row before each, shape (n, 2).

    Both in cm per step of the simulator, so that runs of different steps tell one rule.
    """
    known = run.is_measured
    rows = np.flatnonzero(np.logical_and.reduce([known[:-2], known[1:-1], known[2:]])) + 1
    stems = simulator.step(simulator.start(run.points_cm[rows]), run.light[rows], run.step_s)[1]
    tips = run.points_cm[:, -1]
    steps = run.step_s / simulator.step_s
    return (tips[rows + 1] - stems[:, -1]) / steps, (tips[rows] - tips[rows - 1]) / steps


def _told_by_past(errors: Sequence[Array], past: Sequence[Array]) -> float:
    """Share of the errors' variance that their past tells, each run by the rule of all others, or of itself alone."""
    left = total = 0.0
    for i, (own, before) in enumerate(zip(errors, past, strict=True)):
        others = [j for j in range(len(errors)) if j != i] or [i]
        x = np.concatenate([_columns(past[j]) for j in others])
        y = np.concatenate([errors[j] for j in others])
        rule = np.linalg.lstsq(x, y, rcond=None)[0]
        middle = np.concatenate([errors[j] for j in others]).mean(axis=0)
        left += float(((own - _columns(before) @ rule) ** 2).sum())
        total += float(((own - middle) ** 2).sum())
    return 1.0 - left / total if total > 0.0 else 0.0


def _columns(past: Array) -> Array:
    return np.column_stack([np.ones(len(past)), past])


def _lasting_h(errors: Array, step_s: float) -> float:
    """How long errors stay alike, hours: until their correlation has fallen to 1/e."""
    own = errors[:, 0] - errors[:, 0].mean()
    most = min(len(own) - 1, round(12.0 * 3600.0 / step_s))
    power = float(own @ own)
    for lag in range(1, most):
        if float(own[lag:] @ own[:-lag]) < power / math.e:
            return lag * step_s / 3600.0
    return most * step_s / 3600.0
