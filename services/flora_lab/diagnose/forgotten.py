"""What the lamps of the hours before tell of a simulator's errors: all of it is what the simulator forgets.

One-step errors of the tip sideways are held against the traces that lamps leave for minutes to hours
(:mod:`flora_lab.simulator.remembering`). Lamps are known without error and do not follow from chance. A plant's own
last step does neither, and a stem that was measured too far to the right moves back by as much.

A simulator may be wrong in much else. So traces count beside the lamp and the stem of that very time, and beside any
slow course of errors, splines with a knot every six hours: chance lasts for hours, and of a stem that the lamps have
bent, their past would tell what chance has added. What is left is the time after a lamp has changed, in which a plant
goes on for a while as it did, and a simulator that forgets does not.

How much traces would tell by chance follows from the same errors with signs drawn for stretches of hours (a wild
bootstrap by clusters, Cameron, Gelbach and Miller 2008): left is as good as right, and lamps that turn every six hours
would be the same again if they were shifted in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.signal
from scipy.interpolate import BSpline

from flora_common.arrays import Array
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.remembering import TRACES_H, sides

_H: Final = 3600.0
_SEED: Final = 1
_DRAWS: Final = 999
_TRACES_H: Final = TRACES_H[:4]
"""Those that a course with a knot every :data:`_KNOT_H` does not hide."""
_MEAN_H: Final = 1.0 / 3.0
"""Over so long means are taken; errors of measuring in it nearly cancel."""
_KNOT_H: Final = 6.0
_STRETCH_H: Final = 6.0
_FEWEST_STRETCHES: Final = 9
"""With fewer, signs that are all alike, which leave the errors as they are, are no rare draw."""
_RIDGE: Final = 1e-3
_MIDDLE: Final = 4
"""Point of the stem that tells beside its tip how it stands."""
_ALONE_H: Final = np.geomspace(0.125, 4.0, 11)
"""Time constants that are tried alone. What lasts for longer than two hours is told too short: the slow course has a
part of it."""
_LEVEL: Final = 0.9
_ROUNDING_CM: Final = 1e-6
"""Errors as small as this are no plant's."""
_SMALL: Final = 1e-9
_ROUNDING: Final = 1e-9
"""Part of a number that is rounding."""


@dataclass(frozen=True, slots=True)
class Forgotten:
    """What the lamps before tell.

    Attributes:
        share: of the variance of errors that no slow course, nor lamp and stem of that time, tells.
        by_chance: the same in the mean where nothing is forgotten.
        p_value: how often chance comes to as much.
        time_constant_h: of the one trace that tells most by itself.
        interval_h: 90 % of it, by stretches drawn with replacement.
    """

    share: float
    by_chance: float
    p_value: float
    time_constant_h: float
    interval_h: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """A run by thirds of an hour, freed of what a slow course tells, and lamp and stem of that time.

    Attributes:
        present: orthonormal columns of what these tell, shape (n, m).
        errors: shape (n,), cm per step of the simulator.
        traces: shape (n, 4); alone: shape (n, 11).
        at_h: when they begin, shape (n,).
    """

    present: Array
    errors: Array
    traces: Array
    alone: Array
    at_h: Array

    def stretches(self, first_h: float = 0.0) -> Array:
        """Number of the stretch that each time is in."""
        return np.floor((self.at_h + first_h) / _STRETCH_H).astype(np.int64)


def forgotten(simulator: Simulator[Any], runs: Sequence[MeasuredRun]) -> Forgotten | None:
    """What the lamps of the hours before tell of a simulator's errors; None where runs are too short, lamps stay, or
    there are no errors."""
    told = [one for run in runs if (one := _course_of(simulator, run)) is not None]
    if sum(len(np.unique(one.stretches())) for one in told) < _FEWEST_STRETCHES:
        return None
    size = np.sqrt(np.mean([(one.traces**2).mean(axis=0) for one in told], axis=0))
    off_cm = np.sqrt(np.mean([(one.errors**2).mean() for one in told]))
    if (size < _SMALL).any() or off_cm < _ROUNDING_CM:
        return None
    traces = [one.traces / size for one in told]
    normal = sum(one.T @ one for one in traces)
    normal += _RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))

    def share_of(errors: Sequence[Array]) -> float:
        along = sum(one.T @ values for one, values in zip(traces, errors, strict=True))
        return float(along @ np.linalg.solve(normal, along) / sum(values @ values for values in errors))

    share = share_of([one.errors for one in told])
    draw = np.random.default_rng(_SEED)
    by_chance = np.array([share_of([_turned(one, draw) for one in told]) for _ in range(_DRAWS)])
    as_much = np.count_nonzero(by_chance >= share * (1.0 - _ROUNDING))
    p_value = (1.0 + as_much) / (_DRAWS + 1.0)
    tau_h, interval_h = _time_constant_h(told, draw)
    return Forgotten(share, float(by_chance.mean()), float(p_value), tau_h, interval_h)


def _course_of(simulator: Simulator[Any], run: MeasuredRun) -> _Course | None:
    """A run's errors and traces where every row was measured; None where it is too short, or has too few of them."""
    known = run.is_measured
    rows = np.flatnonzero(known[:-1] & known[1:])
    stems = simulator.step(simulator.start(run.points_cm[rows]), run.light[rows], run.step_s)[1]
    errors = np.full(len(run) - 1, np.nan)
    errors[rows] = (run.points_cm[rows + 1, -1, 0] - stems[:, -1, 0]) / (run.step_s / simulator.step_s)
    side, hour = sides(run.light), np.arange(len(errors)) * run.step_s / _H
    tip, middle, height = run.points_cm[:-1, -1, 0], run.points_cm[:-1, _MIDDLE, 0], run.points_cm[:-1, -1, 1]
    present = [side, side * hour, tip, tip * height, middle, middle * height, *_slow(hour, run.hours).T]
    columns = [*present, errors, *(_trace(side, hours, run.step_s) for hours in (*_TRACES_H, *_ALONE_H))]
    count = max(1, round(_MEAN_H * _H / run.step_s))
    whole = len(errors) // count
    means = np.column_stack(columns)[: whole * count].reshape(whole, count, -1).mean(axis=1)
    at = np.flatnonzero(np.isfinite(means).all(axis=1))
    means = means[at]
    if len(means) <= 2 * len(present):
        return None
    size = np.sqrt((means[:, : len(present)] ** 2).mean(axis=0))
    basis, weight, _ = np.linalg.svd(means[:, : len(present)] / np.maximum(size, _SMALL), full_matrices=False)
    basis = basis[:, weight > _ROUNDING * weight[0]]  # a lamp that stays is no column of its own
    left = _without(basis, means[:, len(present) :])
    traces, alone = np.split(left[:, 1:], [len(_TRACES_H)], axis=1)
    return _Course(basis, left[:, 0], traces, alone, at * count * run.step_s / _H)


def _without(basis: Array, values: Array) -> Array:
    """What orthonormal columns do not tell of some values, first axis time."""
    return np.asarray(values - basis @ (basis.T @ values), dtype=np.float64)


def _slow(hour: Array, hours: float) -> Array:
    """Cubic B-splines over a run with a knot every :data:`_KNOT_H`, shape (rows, splines)."""
    knots = np.linspace(0.0, hours, max(1, round(hours / _KNOT_H)) + 1)
    ends = np.full(3, hours)
    return np.asarray(BSpline.design_matrix(hour, np.concatenate([0.0 * ends, knots, ends]), 3).toarray())


def _trace(side: Array, time_constant_h: float, step_s: float) -> Array:
    """What is left of lamps that are forgotten within a time, the row's own among them; shape as ``side``. The first
    one is taken to have shone for long."""
    kept = float(np.exp(-step_s / _H / time_constant_h))
    trace, _ = scipy.signal.lfilter([1.0 - kept], [1.0, -kept], side, zi=kept * side[:1])
    return np.asarray(trace, dtype=np.float64)


def _turned(one: _Course, draw: np.random.Generator) -> Array:
    """A run's errors with a sign drawn for each stretch; where these begin is drawn, too."""
    stretches = one.stretches(float(draw.uniform(0.0, _STRETCH_H)))
    return _without(one.present, one.errors * draw.choice([-1.0, 1.0], stretches.max() + 1)[stretches])


def _time_constant_h(told: Sequence[_Course], draw: np.random.Generator) -> tuple[float, tuple[float, float]]:
    """The time constant of the trace that tells most by itself, and its interval, hours."""
    along, power = [], []
    for one in told:
        stretches = one.stretches()
        for stretch in np.unique(stretches):
            own = stretches == stretch
            along.append(one.alone[own].T @ one.errors[own])
            power.append((one.alone[own] ** 2).sum(axis=0))
    weights = np.concatenate([np.ones((1, len(along))), draw.poisson(1.0, (_DRAWS, len(along)))])
    explained = (weights @ np.array(along)) ** 2 / np.maximum(weights @ np.array(power), _SMALL)
    best = _ALONE_H[explained[weights.any(axis=1)].argmax(axis=1)]
    low, high = np.quantile(best[1:], [(1.0 - _LEVEL) / 2.0, (1.0 + _LEVEL) / 2.0])
    about = float(np.sqrt(_ALONE_H[1] / _ALONE_H[0]))  # each of those tried stands for what lies half a step about it
    return float(best[0]), (float(min(low, best[0])) / about, float(max(high, best[0])) * about)
