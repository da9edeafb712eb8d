"""Noisy copies of what was measured (eqs. 8 to 16).

Three places cannot be done as they are printed, and what is done instead:

- Eq. 11 has its closing bracket after the square: ``w_j (x_i - mu^2)``. The standard deviation is meant.
- Eq. 12 adds ``N(mu, sigma omega)`` to the tip, mu being the mean *place* of the tips near it: a tip at 15 cm would go
  to about 30 cm. The sentence before it says that both mu and sigma are scaled by omega. So mu is taken relative to the
  tip and scaled: ``x' = x + N(omega (mu - x), omega sigma)``. This is ``mean = "offset"``. With ``"zero"`` the mean is
  0, and ``"printed"`` does what is printed.
- Eq. 16 adds to ``x_i`` a draw about mu_2, which holds ``x_i`` already (eq. 13). It is counted once, except in
  ``"printed"``.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import FloatArray, IntArray
from flora_lab.dataset.recipe import NoiseMean, NoiseSettings
from flora_lab.dataset.stems import Int32Array, Stems

_BLOCK_CELLS: Final = 8_000_000
"""Distances that are held at a time: 64 MB."""


def local_statistics(tips_cm: FloatArray, light: Int32Array, theta_3: int) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the tips nearest to each tip under the same light (eqs. 9 to 11).

    Args:
        tips_cm: shape (n, 2).
        light: shape (n,); only tips of the same value are looked at.
        theta_3: how many of the *other* tips; of those equally far the earlier ones. Where there are fewer, all.

    Returns:
        mu and sigma, both of shape (n, 2), x and y apart. A tip without any other has its own place, and 0.
    """
    mean, deviation = tips_cm.copy(), np.zeros_like(tips_cm)
    for condition in np.unique(light):
        members = np.nonzero(light == condition)[0]
        count = min(theta_3, len(members) - 1)
        if count < 1:
            continue
        tips = tips_cm[members]
        per_block = max(1, _BLOCK_CELLS // len(members))
        for start in range(0, len(members), per_block):
            block = slice(start, min(start + per_block, len(members)))
            near = tips[_nearest_others(tips, block, count)]
            mean[members[block]] = near.mean(axis=1)
            deviation[members[block]] = near.std(axis=1)
    return mean, deviation


def _nearest_others(tips: FloatArray, block: slice, count: int) -> IntArray:
    """Indices of the ``count`` nearest other tips of each tip in the block, shape (block, count)."""
    squared = ((tips[block, None, :] - tips[None, :, :]) ** 2).sum(axis=2)
    own = np.arange(block.start, block.stop)
    squared[own - block.start, own] = np.inf
    limit = np.partition(squared, count - 1, axis=1)[:, count - 1 : count]
    nearer = squared < limit
    # Of those at the limit as many as are missing, the earlier first: partition alone would take any.
    at_limit = squared == limit
    missing = count - nearer.sum(axis=1, keepdims=True)
    chosen = nearer | (at_limit & (at_limit.cumsum(axis=1) <= missing))
    return np.nonzero(chosen)[1].reshape(-1, count)


def extents_ratio(points_cm: FloatArray) -> FloatArray:
    """omega_2: the extent of each point's places relative to that of the tip's (eq. 15).

    Args:
        points_cm: shape (n, 9, 2).

    Returns:
        Shape (9, 2), the tip's own 1. Where the tip has no extent the ratio is not defined, and 0.
    """
    extents = points_cm.max(axis=0) - points_cm.min(axis=0)
    tip = extents[-1]
    ratio = np.divide(extents, tip, out=np.zeros_like(extents), where=tip > 0.0)
    return np.asarray(ratio, dtype=np.float64)


def noisy_points(
    points_cm: FloatArray,
    mean_cm: FloatArray,
    deviation_cm: FloatArray,
    omega_2: FloatArray,
    draws: FloatArray,
    *,
    omega: float,
    mean: NoiseMean,
) -> FloatArray:
    """One noisy copy (eqs. 12 to 14 and 16).

    Args:
        points_cm: shape (n, 9, 2), the tip last.
        mean_cm, deviation_cm: mu and sigma of :func:`local_statistics`, shape (n, 2).
        omega_2: of :func:`extents_ratio`, shape (9, 2).
        draws: of the standard normal distribution, shape (n, 9, 2).
        omega: the scaling factor.
        mean: how eq. 12 is read.

    Returns:
        Shape (n, 9, 2).
    """
    tips = points_cm[:, -1]
    about = {"offset": omega * (mean_cm - tips), "zero": np.zeros_like(tips), "printed": mean_cm}[mean]
    moved = about + omega * deviation_cm * draws[:, -1]
    out = points_cm + moved[:, None, :] * omega_2  # eq. 13
    if mean == "printed":
        out = out + points_cm
    sigma_2 = omega * deviation_cm[:, None, :] * omega_2  # eq. 14
    out = out + omega * sigma_2 * draws  # eq. 16
    out[:, -1] = tips + moved
    return np.asarray(out, dtype=np.float64)


def noisy_sequences(stems: Stems, settings: NoiseSettings, seed: int) -> list[Stems]:
    """The sequences Psi_1 to Psi_N. Each has a generator of its own, so that more of them do not change the first.

    Args:
        stems: what was measured (Psi).
        settings: theta_3, omega, how many.
        seed: of the noise.
    """
    mean, deviation = local_statistics(stems.tips_cm, stems.light, settings.theta_3)
    omega_2 = extents_ratio(stems.points_cm)
    out = []
    for number in range(1, settings.sequences + 1):
        draws = np.random.default_rng([seed, number]).standard_normal(stems.points_cm.shape)
        points = noisy_points(
            stems.points_cm, mean, deviation, omega_2, draws, omega=settings.omega, mean=settings.mean
        )
        out.append(stems.copy_as(number, points))
    return out
