"""How plants differ and what happens by chance, told apart: sizes under which reference runs are most probable.

Both scatter runs about the typical plant. What is alike in every hour of a run is the plant, what comes and goes is
chance; so they are found together, with each plant's own constants and all of chance integrated out (empirical Bayes).
All is taken for linear about the plant that each run's own fit has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg
import scipy.optimize

from flora_common.arrays import Array
from flora_lab.diagnose.chance import PARTS, sizes_expected
from flora_lab.diagnose.joint import TRAITS
from flora_lab.diagnose.packed import Root, add_product, all_packed, diagonal
from flora_lab.diagnose.scene import START_SD
from flora_lab.simulator.tropism_traits import NAMES, prior_spread

_RATES: Final = [NAMES.index(name) for name in ("growth_early_cm_per_day", "growth_late_cm_per_day")]
_DIFFER: Final = 0.2
"""How well it is known before by how much plants of a kind differ in all, as a standard deviation of the logarithm."""
_DIFFER_IN_ONE: Final = 0.1
"""How well by how much more or less in one constant than in the others; nine plants tell little of that."""
_DIFFER_IN_VIGOUR: Final = 0.7
"""How well by how much they differ in both rates of growth together."""
_FARTHEST: Final = 2.0
_ROUNDING: Final = 1e-9
_LEAST: Final = 0.05
_MOST: Final = 20.0
"""How far sizes may go from what is expected, as factors."""


@dataclass(frozen=True, slots=True)
class Linear:
    """A run as it would be for any plant near the one that it is.

    Attributes:
        offset: measured minus what is simulated, with the plant's own constants and first stem taken off linearly,
            shape (m,).
        slopes: of the features by the constants and the first stem, shape (m, 11).
        parts: covariances of what happens by chance, per unit, see :func:`flora_lab.diagnose.chance.covariances`,
            shape (parts, m, m).
    """

    offset: Array
    slopes: Array
    parts: Array

    def residual(self, mean: Array) -> Array:
        """Measured minus what a plant with these constants would do, shape (m,)."""
        return np.asarray(self.offset - self.slopes[:, :TRAITS] @ mean)

    def covariance(self, sizes: Array, spread: Array) -> Array:
        """Of the residual about the typical plant, shape (m, m): by chance, by how plants differ, and because the first
        stem is not known exactly."""
        own = scipy.linalg.block_diag(spread, np.diag(START_SD**2))
        whole = np.tensordot(sizes**2, self.parts, axes=1) + self.slopes @ own @ self.slopes.T
        whole[np.diag_indices_from(whole)] *= 1.0 + _ROUNDING
        return np.asarray(whole)


def typical(runs: Sequence[Linear], sizes: Array, spread: Array, known: tuple[Array, Array]) -> tuple[Array, Array]:
    """The constants of the typical plant, shape (9,), and how well they are known: covariance, shape (9, 9).

    Args:
        runs: of plants of one kind.
        sizes: of what happens by chance, shape (parts,).
        spread: between plants, shape (9, 9).
        known: the same two before any data.
    """
    mean, doubt = known
    information = np.linalg.inv(doubt)
    pull = information @ mean
    for run in runs:
        root = scipy.linalg.cholesky(run.covariance(sizes, spread), lower=True, check_finite=False)
        both = np.column_stack([run.slopes[:, :TRAITS], run.offset])
        white = scipy.linalg.solve_triangular(root, both, lower=True, check_finite=False)
        information = information + white[:, :-1].T @ white[:, :-1]
        pull = pull + white[:, :-1].T @ white[:, -1]
    return np.linalg.solve(information, pull), np.linalg.inv(information)


def evidence(runs: Sequence[Linear], mean: Array, sizes: Array, spread: Array) -> float:
    """Logarithm of the probability of runs of plants about a typical one, up to a constant."""
    total = 0.0
    for run in runs:
        root = scipy.linalg.cholesky(run.covariance(sizes, spread), lower=True, check_finite=False)
        white = scipy.linalg.solve_triangular(root, run.residual(mean), lower=True, check_finite=False)
        total -= float(np.log(np.diag(root)).sum() + 0.5 * white @ white)
    return total


def sizes_and_spread(runs: Sequence[Linear], mean: Array, start: Array) -> tuple[Array, Array]:
    """How large what happens by chance is, shape (parts,), and how plants differ, covariance of shape (9, 9).

    Args:
        runs: of plants of one kind.
        mean: constants of the typical one, shape (9,).
        start: sizes to begin with, shape (parts,).
    """
    count = len(PARTS)
    expected = _differ_expected()
    middle = np.log(np.concatenate([sizes_expected(), expected]))
    precision = _precision()
    least = np.maximum(_LEAST * sizes_expected(), [part.least for part in PARTS])
    low = np.concatenate([np.log(least), np.log(expected) - _FARTHEST])
    high = np.concatenate([np.log(_MOST * sizes_expected()), np.log(expected) + _FARTHEST])
    told = [_Told.of(run, mean) for run in runs]

    def improbability(log_sizes: Array) -> tuple[float, Array]:
        slope = precision @ (log_sizes - middle)
        total = 0.5 * float((log_sizes - middle) @ slope)
        sizes = np.exp(log_sizes)
        for run in told:
            one, uphill = run.improbability(sizes)
            total += one
            slope += uphill
        return total, slope

    found = scipy.optimize.minimize(
        improbability,
        np.clip(np.concatenate([np.log(start), np.log(expected)]), low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 60, "ftol": 1e-6},
    )
    return np.exp(found.x[:count]), _spread_of(np.exp(found.x[count:]))


@dataclass(frozen=True, slots=True)
class _Told:
    """A run as the search for sizes needs it.

    Attributes:
        residual: about the typical plant, shape (m, 1).
        parts: packed, see :attr:`Linear.parts`, shape (parts, m (m + 1) / 2).
        along: what a unit of each way to differ does to features, shape (m, 10).
        first: what one standard deviation of the first stem does, shape (m, 2).
        diagonal: of packed matrices.
    """

    residual: Array
    parts: Array
    along: Array
    first: Array
    diagonal: Array

    @classmethod
    def of(cls, run: Linear, mean: Array) -> _Told:
        residual, slopes = run.residual(mean), run.slopes
        along = np.column_stack([slopes[:, :TRAITS], slopes[:, _RATES].sum(axis=1)])
        first = slopes[:, TRAITS:] * START_SD
        return cls(residual[:, None], all_packed(run.parts), along, first, diagonal(len(residual)))

    def improbability(self, sizes: Array) -> tuple[float, Array]:
        """Minus the logarithm of the run's probability, up to a constant, and its slope by the logarithms of sizes.

        Args:
            sizes: of what happens by chance, and of how plants differ, shape (parts + 10,).
        """
        variances = sizes**2
        count = len(self.parts)
        covariance = variances[:count] @ self.parts
        add_product(covariance, np.hstack([self.along * sizes[count:], self.first]), 1.0)
        covariance[self.diagonal] *= 1.0 + _ROUNDING
        root = Root(covariance, self.diagonal)
        solved = root.solved(np.hstack([self.residual, self.along]))
        pull, along = solved[:, :1], solved[:, 1:]
        total = root.log_determinant() + 0.5 * float(np.sum(self.residual * pull))
        away = add_product(root.inverse(), pull, -1.0)
        # Both triangles count, and the diagonal once.
        away *= 2.0
        away[self.diagonal] *= 0.5
        differ = np.sum(self.along * along, axis=0) - (pull.T @ self.along)[0] ** 2
        return total, variances * np.concatenate([self.parts @ away, differ])


# Plants differ in each constant by itself, and in both rates of growth together: ten standard deviations.


def _differ_expected() -> Array:
    spread = prior_spread()
    together = spread[_RATES[0], _RATES[1]]
    own = np.diag(spread).copy()
    own[_RATES] -= together
    return np.asarray(np.sqrt(np.append(own, together)))


def _precision() -> Array:
    """Of the logarithms of all sizes before any data."""
    own = np.full((TRAITS, TRAITS), _DIFFER**2) + _DIFFER_IN_ONE**2 * np.eye(TRAITS)
    doubts = np.diag([part.doubt**2 for part in PARTS])
    return np.linalg.inv(scipy.linalg.block_diag(doubts, own, _DIFFER_IN_VIGOUR**2))


def _spread_of(differ: Array) -> Array:
    spread = np.diag(differ[:TRAITS] ** 2)
    spread[np.ix_(_RATES, _RATES)] += differ[TRAITS] ** 2
    return np.asarray(spread)
