"""Gaps in which nobody knows which lamp shone: where a free run must begin anew, and what may be a little late.

A plant that answers for hours to a lamp that the record does not tell stands elsewhere afterwards, whatever the law. So
the stem is taken from the record again; what the plant remembers of the lamps is what the simulation makes of the gap.
After a short gap that is not needed: a lamp that changed in it is taken to have changed in its middle, and how wrong
that may be is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.first_stem import first_stem
from flora_lab.simulator.measured import MeasuredRun, UnseenLight

LEAST_H: Final = 0.5
"""A gap in which lamps changed is short up to this."""
_SHORT_DWELL: Final = 10.0
"""Per cent of dwells that are shorter than the one in which lamps may have changed twice."""


@dataclass(frozen=True, slots=True)
class Restart:
    """A stem taken from the record in the middle of a run.

    Attributes:
        step: from which on the run is simulated anew; its row was measured, and those on both sides of it, where there
            are such rows.
        blind_from: the first row before it that cannot be compared, up to the one after ``step``.
        stem_cm: shape (10, 2).
    """

    step: int
    blind_from: int
    stem_cm: Array


def restarts_of(run: MeasuredRun, steps: int, every: int) -> list[Restart]:
    """Where a run begins anew, in order of time.

    Args:
        run: with its gaps.
        steps: that are simulated.
        every: restarts lie at multiples of so many steps, for only these are told.
    """
    out: list[Restart] = []
    for gap in _long_gaps(run):
        if out and gap.start < out[-1].step:
            continue
        after = np.arange(-(-(gap.stop + 2) // every) * every, min(steps, len(run) - 1), every)
        step = _sound(after, run.is_measured)
        if step is not None:
            about = step - 1 + int(np.argmax(run.is_measured[step - 1 :]))
            out.append(Restart(step, gap.start + 1, first_stem(run.points_cm[about:], run.step_s)))
    return out


def lost_from(run: MeasuredRun, restarts: list[Restart]) -> int:
    """The first row that cannot be compared because no stem after a gap tells where the plant stood then."""
    begun = restarts[-1].step if restarts else 0
    return next((gap.start + 1 for gap in _long_gaps(run) if gap.start >= begun), len(run))


def _sound(rows: Array, measured: Array) -> int | None:
    """The first of some rows that was measured with those on both sides of it; else that was measured; else beside
    which one was."""
    about = np.stack([measured[rows - 1], measured[rows], measured[rows + 1]])
    for is_sound in (about.all(axis=0), about[1], about.any(axis=0)):
        if is_sound.any():
            return int(rows[np.argmax(is_sound)])
    return None


def _long_gaps(run: MeasuredRun) -> list[UnseenLight]:
    """Gaps after which a run must begin anew, in order of time."""
    dwell_h = _short_dwell_h(run)
    return [gap for gap in run.unseen if _hours(gap, run) > (LEAST_H if gap.changes else max(LEAST_H, dwell_h))]


def short_gaps(run: MeasuredRun, steps: int) -> list[UnseenLight]:
    """Gaps in which a lamp changed some minutes earlier or later, in order of time, within the first ``steps``."""
    return [gap for gap in run.unseen if gap.changes and gap.start < steps and _hours(gap, run) <= LEAST_H]


def _hours(gap: UnseenLight, run: MeasuredRun) -> float:
    return (gap.stop - gap.start) * run.step_s / 3600.0


def _short_dwell_h(run: MeasuredRun) -> float:
    """For how long at least a lamp nearly always shines; infinite where too few changes tell."""
    changes = np.flatnonzero((np.diff(run.light, axis=0) != 0.0).any(axis=1))
    dwells = np.diff(changes)
    return float(np.percentile(dwells, _SHORT_DWELL)) * run.step_s / 3600.0 if len(dwells) else np.inf
