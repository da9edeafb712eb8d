"""The generic plant model: translations of the smoothest movements (eq. 17)."""

from __future__ import annotations

import itertools

import numpy as np

from flora_common.arrays import BoolArray, FloatArray, IntArray
from flora_lab.dataset.recipe import GenericSettings
from flora_lab.dataset.stems import Stems


def translations(exponents: tuple[int, ...], unit_cm: float) -> FloatArray:
    """All shifts by +-10^lambda in x with +-10^lambda in y (eq. 17).

    Args:
        exponents: lambda. The paper's (-3, -4, -5, -6) give 8 shifts along each axis: 64 together, as it says.
        unit_cm: the normalised unit in cm.

    Returns:
        Shape ((2 * len(exponents))^2, 2) in cm.
    """
    steps = [sign * 10.0**exponent for exponent in exponents for sign in (1.0, -1.0)]
    return unit_cm * np.array(list(itertools.product(steps, steps)))


def windows(stems: Stems, length: int) -> IntArray:
    """Starts of pieces of ``length`` stems, end to end, each unbroken and under one light; shape (k,)."""
    follows = np.zeros(len(stems), dtype=np.bool_)
    follows[stems.followers() + 1] = True
    starts: list[int] = []
    begin = 0
    for i in range(len(stems)):
        if i > begin and (not follows[i] or stems.light[i] != stems.light[begin]):
            begin = i
        if i - begin + 1 == length:
            starts.append(begin)
            begin = i + 1
    return np.array(starts, dtype=np.int64)


def roughness(points_cm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How uneven movements are, and how far they go.

    Args:
        points_cm: shape (k, length, 9, 2): k movements.

    Returns:
        Roughness, the sum of the changes of velocity over the sum of velocities (0 is a steady movement, near 2 one to
        and fro), and the way, the sum of velocities in cm; both of shape (k,). A velocity is the length of the vector
        of 18 from one stem to the next. What does not move at all has infinite roughness.
    """
    count, length = points_cm.shape[:2]
    velocity = np.diff(points_cm.reshape(count, length, -1), axis=1)
    way = np.linalg.norm(velocity, axis=2).sum(axis=1)
    change = np.linalg.norm(np.diff(velocity, axis=1), axis=2).sum(axis=1)
    return np.divide(change, way, out=np.full(count, np.inf), where=way > 0.0), way


def smoothest(stems: Stems, settings: GenericSettings, interval_s: float) -> BoolArray:
    """Which stems belong to the smoothest movements.

    The paper selects by hand "the natural plants' smoothest and least noisy movements". Here movements are pieces of
    ``window_h`` hours under one light. Those that go less far than the median are left aside, for rest is smooth too.
    Of the others the least rough are taken, until they hold ``share`` of all stems (to the nearest piece, at least
    one).

    Args:
        stems: what was measured.
        settings: length of the pieces and the share.
        interval_s: from one stem to the next.

    Returns:
        Shape (n,); all False where no piece is long enough.
    """
    chosen = np.zeros(len(stems), dtype=np.bool_)
    length = max(3, round(settings.window_h * 3600.0 / interval_s))
    starts = windows(stems, length)
    if not len(starts):
        return chosen
    rows = starts[:, None] + np.arange(length)
    rough, way = roughness(stems.points_cm[rows])
    candidates = np.nonzero((way >= np.median(way)) & np.isfinite(rough))[0]
    order = candidates[np.argsort(rough[candidates], kind="stable")]
    wanted = max(1, round(settings.share * len(stems) / length))
    chosen[rows[order[:wanted]].reshape(-1)] = True
    return chosen


def translated(stems: Stems, chosen: BoolArray, shifts_cm: FloatArray, first_sequence: int) -> list[Stems]:
    """The sequences Psi_Phi: the chosen stems moved by each shift, every point by the same (eq. 17).

    The anchor is not part of the vectors and stays at (0, 0).
    """
    picked = stems.take(chosen)
    return [picked.copy_as(first_sequence + i, picked.points_cm + shift) for i, shift in enumerate(shifts_cm)]
