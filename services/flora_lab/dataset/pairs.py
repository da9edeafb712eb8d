"""From sequences to vectors: mirroring, next-step pairing, and what is removed (the text after eq. 17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_lab.dataset.stems import LEFT, POINTS, RIGHT, Int32Array, Stems

COORDINATES: Final = 2 * POINTS


def mirrored(stems: Stems) -> Stems:
    """Left and right exchanged: x and the light.

    The paper mirrors "across the x-axis, as we assume the targeted plant behavior to lack left-right bias". Only
    x -> -x fits the reason that it gives, and then the lit lamp is the other one.
    """
    return Stems(
        stems.points_cm * np.array([-1.0, 1.0]),
        np.asarray(LEFT + RIGHT - stems.light, dtype=np.int32),
        stems.run,
        stems.row,
        stems.segment,
        stems.sequence,
        ~stems.mirrored,
    )


@dataclass(frozen=True, slots=True)
class Pairs:
    """Vectors psi*: each stem with its light, and the next stem.

    Attributes:
        inputs: shape (n, 19) in units: x2, y2, ..., x10, y10 of the present stem, then the light (0 left, 1 right).
        outputs: shape (n, 18) in units: the same points one time step later.
        run, row: shape (n,): where the present stem was measured.
        sequence: shape (n,); 0 measured, 1 to N noisy, then translations.
        mirrored: shape (n,).
    """

    inputs: Float32Array
    outputs: Float32Array
    run: Int32Array
    row: Int32Array
    sequence: Int32Array
    mirrored: BoolArray

    def __len__(self) -> int:
        return len(self.row)

    def take(self, which: BoolArray) -> Self:
        """Those of a mask."""
        return type(self)(
            self.inputs[which],
            self.outputs[which],
            self.run[which],
            self.row[which],
            self.sequence[which],
            self.mirrored[which],
        )


def paired(stems: Stems, unit_cm: float) -> Pairs:
    """Each stem beside the next one; never across runs, sequences, gaps, or stems that were removed.

    Args:
        stems: of any sequences.
        unit_cm: the normalised unit in cm.
    """
    now = stems.followers()
    vectors = (stems.points_cm.reshape(len(stems), COORDINATES) / unit_cm).astype(np.float32)
    light = stems.light[now, None].astype(np.float32)
    return Pairs(
        np.concatenate([vectors[now], light], axis=1),
        vectors[now + 1],
        stems.run[now],
        stems.row[now],
        stems.sequence[now],
        stems.mirrored[now],
    )


def changed(pairs: Pairs, tolerance: float = 0.0) -> BoolArray:
    """Which vectors do not "contain duplicate stems at the current and next positions" (rule 1).

    Args:
        pairs: n vectors.
        tolerance: in units; stems are equal if no coordinate differs by more than this.
    """
    difference = np.abs(pairs.inputs[:, :COORDINATES].astype(np.float64) - pairs.outputs)
    return np.asarray(difference.max(axis=1, initial=0.0) > tolerance, dtype=np.bool_)


def change(pairs: Pairs) -> FloatArray:
    """How far stems move in one step: the mean over the nine points of their distance, in units; shape (n,)."""
    difference = pairs.outputs.astype(np.float64) - pairs.inputs[:, :COORDINATES]
    way = difference.reshape(len(pairs), POINTS, 2)
    return np.asarray(np.hypot(way[..., 0], way[..., 1]).mean(axis=1), dtype=np.float64)


def no_jump(pairs: Pairs, times: float) -> BoolArray:
    """Which vectors do not change by more than ``times`` the mean change of all (rule 2), in a single pass."""
    if not len(pairs):
        return np.zeros(0, dtype=np.bool_)
    moved = change(pairs)
    return np.asarray(moved <= times * moved.mean(), dtype=np.bool_)
