"""Symmetric matrices as one triangle each, in LAPACK's rectangular full packed form.

Half the memory of whole matrices at the speed of these (Gustavson et al. 2010, doi:10.1145/1731022.1731028). What is
summed over many covariances in each step of a search waits for memory more than for sums.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import LinAlgError, lapack

from flora_common.arrays import Array


def packed(matrix: Array) -> Array:
    """A symmetric matrix of shape (m, m), shape (m (m + 1) / 2,)."""
    triangle, _ = lapack.dtrttf(matrix)
    return np.asarray(triangle)


def all_packed(matrices: Sequence[Array] | Array) -> Array:
    """Several of shape (m, m), a row each."""
    return np.stack([packed(matrix) for matrix in matrices])


def diagonal(size: int) -> Array:
    """Where the diagonal of a matrix of this size lies, shape (m,)."""
    places = packed(np.diag(np.arange(1.0, size + 1.0)))
    held = np.flatnonzero(places)
    return np.asarray(held[np.argsort(places[held])])


def add_product(triangle: Array, factor: Array, times: float) -> Array:
    """``triangle + times * factor @ factor.T``; the triangle is overwritten.

    Args:
        triangle: packed, shape (m (m + 1) / 2,).
        factor: shape (m, k).
        times: any number.
    """
    rows, columns = factor.shape
    return np.asarray(lapack.dsfrk(rows, columns, times, np.asfortranarray(factor), 1.0, triangle, overwrite_c=1))


class Root:
    """The Cholesky root of a packed covariance.

    Args:
        triangle: shape (m (m + 1) / 2,); it is overwritten.
        diagonal: see :func:`diagonal`.

    Raises:
        scipy.linalg.LinAlgError: where it is no covariance.
    """

    def __init__(self, triangle: Array, diagonal: Array) -> None:
        self._size = len(diagonal)
        self._triangle, status = lapack.dpftrf(self._size, triangle, overwrite_a=1)
        if status:
            raise LinAlgError("a packed matrix is not positive definite")
        self._diagonal = diagonal

    def log_determinant(self) -> float:
        """Logarithm of the determinant of the root, half of that of the covariance."""
        return float(np.log(self._triangle[self._diagonal]).sum())

    def solved(self, right: Array) -> Array:
        """The inverse of the covariance times ``right`` of shape (m, k)."""
        solution, _ = lapack.dpftrs(self._size, self._triangle, right)
        return np.asarray(solution)

    def inverse(self) -> Array:
        """Of the covariance, packed; the root is no more after it."""
        found, _ = lapack.dpftri(self._size, self._triangle, overwrite_a=1)
        return np.asarray(found)
