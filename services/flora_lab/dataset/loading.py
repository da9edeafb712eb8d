"""Tracks of any origin, checked, as the sequence Psi."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from flora_common.arrays import BoolArray
from flora_common.errors import BadInput
from flora_lab.dataset.stems import LEFT, RIGHT, Stems, joined
from flora_lab.run_tracks import RunTrack

CONDITIONS: Final = {"left": LEFT, "right": RIGHT}
STEP_TOLERANCE: Final = 0.1
"""Relative: beats of a rig are early or late by seconds."""


def measured(runs: Sequence[RunTrack], interval_s: float, *, skip_other_lights: bool = False) -> Stems:
    """The sequence Psi of all runs.

    ``light`` of a track's row shone before it; a stem's condition is the light that acts on it until the next one,
    hence that of the next row. A stem that has no next one keeps the light of its own row.

    Args:
        runs: in order; their index is ``run``.
        interval_s: time from one row to the next. Rows further apart are a gap, over which nothing is paired.
        skip_other_lights: treat intervals in the dark or under both lamps as gaps.

    Raises:
        BadInput: rows nearer to each other than ``interval_s``, or no two rows that far apart; an anchor that is not
            (0, 0); coordinates that no stem has; lights that are neither left nor right. The message names file and
            row.
    """
    parts: list[Stems] = []
    segments = 0
    for index, run in enumerate(runs):
        part = _psi(run, index, segments, interval_s, skip_other_lights=skip_other_lights)
        segments += len(run.track.time_s)
        parts.append(part)
    return joined(parts)


def _psi(run: RunTrack, index: int, first_segment: int, interval_s: float, *, skip_other_lights: bool) -> Stems:
    track = run.track
    run.check_points()
    unbroken = _steps(run, interval_s)
    lit = np.array([light in CONDITIONS for light in track.light])
    if not skip_other_lights:
        used = lit.copy()
        # What shone before the first row, or over a gap, acts on no pair.
        used[0] = used[0] or len(used) > 1
        used[1:] |= ~unbroken
        if not used.all():
            row = int(np.argmin(used))
            raise BadInput(
                f"{run.where(row)}: light is `{track.light[row]}`; the model knows left and right only; "
                "add --skip-other-lights to leave such rows out"
            )
    unbroken &= lit[1:]
    own = np.array([CONDITIONS.get(light, LEFT) for light in track.light], dtype=np.int32)
    light = own.copy()
    light[:-1][unbroken] = own[1:][unbroken]
    known = lit.copy()
    known[:-1] |= unbroken
    segment = first_segment + np.concatenate([[0], np.cumsum(~unbroken)])
    count = len(track.time_s)
    stems = Stems(
        track.points_cm[:, 1:].copy(),
        light,
        np.full(count, index, dtype=np.int32),
        np.arange(count, dtype=np.int32),
        segment.astype(np.int32),
        np.zeros(count, dtype=np.int32),
        np.zeros(count, dtype=np.bool_),
    )
    return stems.take(known)


def _steps(run: RunTrack, interval_s: float) -> BoolArray:
    """Whether each row is one step after the row before; shape (n - 1,)."""
    step_s = np.diff(run.track.time_s)
    near = np.abs(step_s - interval_s) <= STEP_TOLERANCE * interval_s
    short = step_s < (1.0 - STEP_TOLERANCE) * interval_s
    # A track with no step of the right length has another beat altogether, not gaps.
    wrong = short if near.any() or not len(step_s) else np.ones_like(short)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise BadInput(
            f"{run.where(row + 1)}: {step_s[row]:g} s after the row before; steps of {interval_s:g} s are wanted "
            "(see --interval-s)"
        )
    return near
