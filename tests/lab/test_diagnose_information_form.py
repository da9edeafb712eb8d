"""Sizes in which all is linear: evidence and means as sums over all sizes tell them."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import Array
from flora_lab.diagnose.information_form import InformationForm, together

ONE = InformationForm(np.array([[30.0]]), np.array([12.0]))
TWO = InformationForm(np.array([[30.0, 8.0], [8.0, 20.0]]), np.array([12.0, -5.0]))


def weights(told: InformationForm, mean: Array, sd: float) -> tuple[Array, Array]:
    """All sizes of a fine grid, shape (n, k), and how much each counts before any data, times how probable it is."""
    axis = np.linspace(-3.0, 3.0, 601)
    sizes = np.stack([one.ravel() for one in np.meshgrid(*[axis] * len(told.pull), indexing="ij")], axis=1)
    before = np.exp(-0.5 * ((sizes - mean) ** 2).sum(axis=1) / sd**2)
    nats = sizes @ told.pull - 0.5 * np.einsum("ni,ij,nj->n", sizes, told.information, sizes)
    return sizes, before / before.sum() * np.exp(nats)


@pytest.mark.parametrize("told", [ONE, TWO])
@pytest.mark.parametrize("mean", [0.0, 0.3])
def test_evidence_is_the_mean_over_all_sizes(told: InformationForm, mean: float) -> None:
    at, one = np.full(len(told.pull), mean), np.eye(len(told.pull))
    sizes, counted = weights(told, at, 0.4)
    assert told.nats(0.16 * one, at) == pytest.approx(np.log(counted.sum()), abs=1e-4)
    if not mean:
        assert told.nats(0.16 * one) == pytest.approx(np.log(counted.sum()), abs=1e-4)
        assert told.size(0.4) == pytest.approx(counted @ sizes / counted.sum(), abs=1e-4)


def test_a_size_that_is_known_is_weighed_as_it_is() -> None:
    at = np.array([0.2, -0.1])
    expected = float(TWO.pull @ at - 0.5 * at @ TWO.information @ at)
    assert TWO.nats(np.zeros((2, 2)), at) == pytest.approx(expected)
    assert TWO.nats(np.zeros((2, 2))) == 0.0


def test_a_part_is_told_as_if_the_rest_were_none() -> None:
    assert TWO.of(slice(0, 1)).nats(np.array([[0.16]])) == ONE.nats(np.array([[0.16]]))


def test_of_a_mean_less_is_told_where_sizes_scatter_about_it() -> None:
    """For each mean, evidence is that of sizes about it."""
    scattered = TWO.scattered(0.3)
    constant = TWO.nats(0.09 * np.eye(2))
    for mean in (np.array([0.2, 0.1]), np.array([-0.4, 0.3])):
        expected = TWO.nats(0.09 * np.eye(2), mean)
        assert constant + scattered.nats(np.zeros((2, 2)), mean) == pytest.approx(expected)
    same = TWO.scattered(0.0)
    assert np.array_equal(same.information, TWO.information)


def test_what_all_tell_is_their_sum() -> None:
    both = together([TWO, TWO])
    assert both.nats(0.16 * np.eye(2)) == pytest.approx(
        InformationForm(2.0 * TWO.information, 2.0 * TWO.pull).nats(0.16 * np.eye(2))
    )
