"""Smoothing splines with known uncertainty.

A cubic B-spline with even knots, whose third differences are held small (P-splines, Eilers and Marx 1996, "Flexible
smoothing with B-splines and penalties"): where nothing was measured the curve goes on with the curvature that it has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flora_common.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Spline:
    """A curve in the plane; :class:`Smoother` tells its places.

    Attributes:
        coefficients: shape (k, 2).
        covariance: shape (k, k), of the coefficients for a measuring error of 1.
    """

    coefficients: FloatArray
    covariance: FloatArray


def basis(s: FloatArray, knot_step: float, count: int) -> FloatArray:
    """Values of the ``count`` cubic B-splines at s, shape (n, count)."""
    t = np.clip(np.asarray(s, dtype=np.float64) / knot_step, 0.0, count - 3 - 1e-9)
    first = np.floor(t).astype(int)
    u = t - first
    values = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=1) / 6.0
    out = np.zeros((len(t), count))
    rows = np.arange(len(t))
    for k in range(4):
        out[rows, first + k] = values[:, k]
    return out


def coefficients(length: float, knot_step: float) -> int:
    """How many a spline of this length has."""
    return max(4, int(np.ceil(length / knot_step)) + 3)


class Smoother:
    """Fits splines to places at the same s again and again.

    Args:
        s: shape (n,), from 0, rising.
        knot_step: distance of knots.
        roughness: standard deviation that third differences of coefficients are believed to have, in units of places;
            one for all, or shape (:func:`coefficients` - 3,).
    """

    def __init__(self, s: FloatArray, *, knot_step: float, roughness: float | FloatArray) -> None:
        count = coefficients(float(s[-1]), knot_step)
        self._basis = basis(s, knot_step, count)
        third = np.diff(np.eye(count), n=3, axis=0) / np.broadcast_to(roughness, count - 3)[:, None]
        self._penalty = third.T @ third

    def fit(self, places: FloatArray, weights: FloatArray) -> Spline:
        """The spline that is near the places and smooth.

        Args:
            places: shape (n, 2).
            weights: shape (n,), one over the squared measuring error of each place; 0 leaves it out.
        """
        weighted = (self._basis * weights[:, None]).T
        normal = weighted @ self._basis + self._penalty
        # a trace of everything keeps the matrix whole where hardly anything was measured
        normal[np.diag_indices(len(normal))] += 1e-9 * max(1.0, float(normal.trace()))
        covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        return Spline(covariance @ (weighted @ places), covariance)

    def places(self, curve: Spline) -> FloatArray:
        """Where a curve is at s, shape (n, 2)."""
        return np.asarray(self._basis @ curve.coefficients, dtype=np.float64)

    def deviation(self, curve: Spline) -> FloatArray:
        """Standard deviation per coordinate of :meth:`places`, shape (n,), for a measuring error of 1."""
        variance = ((self._basis @ curve.covariance) * self._basis).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)
