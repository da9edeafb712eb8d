"""Packed covariances do what whole ones do, of odd and even size."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from flora_common.arrays import Array
from flora_lab.diagnose.packed import Root, add_product, all_packed, diagonal, packed

SIZES = (1, 2, 7, 12)


def covariance(size: int, seed: int = 0) -> Array:
    factor = np.random.default_rng(seed).normal(size=(size, size + 3))
    return factor @ factor.T


@pytest.mark.parametrize("size", SIZES)
def test_the_diagonal_is_where_it_is_said_to_be(size: int) -> None:
    whole = covariance(size)
    assert packed(whole)[diagonal(size)] == pytest.approx(np.diag(whole), rel=1e-15)


@pytest.mark.parametrize("size", SIZES)
def test_packed_matrices_add_up_as_whole_ones_do(size: int) -> None:
    whole = np.stack([covariance(size, seed) for seed in range(3)])
    factor = np.random.default_rng(9).normal(size=(size, 2))
    weights = np.array([0.5, 2.0, 3.0])
    told = add_product(weights @ all_packed(whole), factor, -0.25)
    assert told == pytest.approx(packed(np.tensordot(weights, whole, axes=1) - 0.25 * factor @ factor.T), rel=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_a_root_solves_and_inverts(size: int) -> None:
    whole, right = covariance(size), np.random.default_rng(1).normal(size=(size, 3))
    root = Root(packed(whole), diagonal(size))
    assert 2.0 * root.log_determinant() == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-9)
    assert root.solved(right) == pytest.approx(np.linalg.solve(whole, right), rel=1e-6, abs=1e-9)
    assert root.inverse() == pytest.approx(packed(np.linalg.inv(whole)), rel=1e-6, abs=1e-9)


def test_what_is_no_covariance_has_no_root() -> None:
    with pytest.raises(LinAlgError, match="not positive definite"):
        Root(packed(np.diag([1.0, -1.0, 1.0])), diagonal(3))
