"""The bets against a simulator: a known rate of false alarms however often one looks, and none missed that is plain."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from flora_lab.serve import evidence
from flora_lab.serve.expecting import within

HOURS, NUMBERS = 60, 5
RATE = 0.05


def bets(innovations: np.ndarray, usual: float = 1.0) -> list[tuple[float, ...]]:
    return [tuple(evidence.wider(float(z @ z), len(z), usual)) for z in innovations]


def test_a_simulator_that_is_right_is_doubted_no_more_often_than_stated() -> None:
    rng = np.random.default_rng(1)
    runs, alarms = 300, 0
    for _ in range(runs):
        worth = evidence.log_worth(bets(rng.standard_normal((HOURS, NUMBERS))))
        alarms += bool(worth.max() >= evidence.threshold(RATE))
    assert alarms <= scipy.stats.binom.ppf(0.999, runs, RATE)
    assert alarms > 0  # a bound that is never touched would see nothing else either


@pytest.mark.parametrize(("begin", "size"), [(0, 1.6), (40, 2.0), (50, 6.0)])
def test_wider_innovations_are_noticed_from_whatever_hour_on_they_come(begin: int, size: float) -> None:
    rng = np.random.default_rng(2)
    z = rng.standard_normal((HOURS, NUMBERS))
    z[begin:] *= size
    worth = evidence.log_worth(bets(z))
    alarm = int(np.flatnonzero(worth >= evidence.threshold(0.01))[0])
    assert begin <= alarm < min(HOURS, begin + 20)


def test_what_comes_later_changes_nothing_of_what_was_said() -> None:
    z = bets(np.random.default_rng(3).standard_normal((30, NUMBERS)))
    np.testing.assert_allclose(evidence.log_worth(z)[:20], evidence.log_worth(z[:20]))


def test_hours_without_a_stem_count_nothing() -> None:
    z = bets(2.0 * np.random.default_rng(4).standard_normal((10, NUMBERS)))
    gap = [tuple(evidence.wider(0.0, 0, 1.0))] * 5
    assert set(gap[0]) == {0.0}
    with_gap = evidence.log_worth([*z[:5], *gap, *z[5:]])
    assert with_gap[-1] == pytest.approx(evidence.log_worth(z)[-1], abs=0.7)


def test_no_hours_are_worth_nothing() -> None:
    assert len(evidence.log_worth([])) == 0


def test_reference_runs_tell_how_large_innovations_may_be() -> None:
    nine = np.array([1.0, 0.9, 1.1, 1.05, 0.95, 1.0, 1.0, 0.9, 1.1])
    assert 1.3 < evidence.largest_usual(nine, 0.05) < 1.7
    assert evidence.largest_usual(nine, 0.005) > evidence.largest_usual(nine, 0.05)
    assert evidence.largest_usual(nine[:3], 0.005) > 2.0 * evidence.largest_usual(nine, 0.005)
    assert evidence.largest_usual(2.0 * nine, 0.05) == pytest.approx(2.0 * evidence.largest_usual(nine, 0.05))


def test_the_distance_that_most_plants_stay_within() -> None:
    round_one = within(4.0 * np.eye(2), 0.95)
    assert round_one == pytest.approx(2.0 * np.sqrt(scipy.stats.chi2.ppf(0.95, 2)), rel=1e-4)
    long_one = within(np.diag([9.0, 1e-9]), 0.95)
    assert long_one == pytest.approx(3.0 * scipy.stats.norm.ppf(0.975), rel=1e-2)
    drawn = np.random.default_rng(5).multivariate_normal([0.0, 0.0], [[3.0, 1.0], [1.0, 1.0]], size=200_000)
    share = np.mean(np.hypot(*drawn.T) <= within(np.array([[3.0, 1.0], [1.0, 1.0]]), 0.95))
    assert share == pytest.approx(0.95, abs=0.003)
