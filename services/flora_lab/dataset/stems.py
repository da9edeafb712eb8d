"""Stems in a row: the paper's sequences Psi, Psi_n and Psi_Phi, all in one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, FloatArray, IntArray

POINTS: Final = 9
"""Points of a vector psi: point 2 to the tip. The anchor is always (0, 0) and left out."""
LEFT: Final = 0
RIGHT: Final = 1
"""The Boolean light condition b. The controllers' output has the same order: up to 0.5 is left, above is right."""

Int32Array = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Stems:
    """Stems of several sequences, one after the other; within a sequence in order of run and time.

    Attributes:
        points_cm: shape (n, 9, 2); the last point is the tip g.
        light: shape (n,), :data:`LEFT` or :data:`RIGHT`: the lamp that shines from this stem to the next.
        run: shape (n,), index of the run that it was measured in.
        row: shape (n,), its row in that run's track, from 0.
        segment: shape (n,); two stems of one segment and of neighbouring rows are one time step apart.
        sequence: shape (n,); 0 is what was measured (Psi), 1 to N the noisy copies (Psi_n), then the translations.
        mirrored: shape (n,).
    """

    points_cm: FloatArray
    light: Int32Array
    run: Int32Array
    row: Int32Array
    segment: Int32Array
    sequence: Int32Array
    mirrored: BoolArray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def tips_cm(self) -> FloatArray:
        """Shape (n, 2)."""
        return self.points_cm[:, -1]

    def take(self, which: BoolArray | IntArray) -> Self:
        """Those of a mask, or at these indices."""
        return type(self)(
            self.points_cm[which],
            self.light[which],
            self.run[which],
            self.row[which],
            self.segment[which],
            self.sequence[which],
            self.mirrored[which],
        )

    def copy_as(self, sequence: int, points_cm: FloatArray) -> Self:
        """The same stems with other points, as a sequence of its own."""
        return type(self)(
            points_cm,
            self.light,
            self.run,
            self.row,
            self.segment,
            np.full(len(self), sequence, dtype=np.int32),
            self.mirrored,
        )

    def followers(self) -> IntArray:
        """Indices of the stems whose next entry is the same plant's next stem, one time step later."""
        return np.nonzero(
            (self.row[1:] == self.row[:-1] + 1)
            & (self.segment[1:] == self.segment[:-1])
            & (self.sequence[1:] == self.sequence[:-1])
            & (self.mirrored[1:] == self.mirrored[:-1])
        )[0]


def joined(parts: Sequence[Stems]) -> Stems:
    """All of these, one after the other."""
    return Stems(
        np.concatenate([part.points_cm for part in parts]),
        np.concatenate([part.light for part in parts]),
        np.concatenate([part.run for part in parts]),
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.segment for part in parts]),
        np.concatenate([part.sequence for part in parts]),
        np.concatenate([part.mirrored for part in parts]),
    )
