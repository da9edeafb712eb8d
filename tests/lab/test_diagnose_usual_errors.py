"""How much of every effect healthy runs seem to show, and that evidence is what goes beyond it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from diagnose_runs import REFERENCE, change_of, known, scene_of
from hypothesis import given
from hypothesis import strategies as st

from flora_lab.diagnose.joint import Cause, Found, Hypothesis
from flora_lab.diagnose.knowledge import learn_from
from flora_lab.diagnose.usual_errors import UsualErrors, causes, strength_of, told
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.threads import one_blas_thread

DRAUGHTS = np.array([0.5, -1.0, 1.0, 2.0, -0.5, -2.0, 1.5, -1.5, 0.0]) * 0.03
"""Of nine reference runs; about nothing on the mean."""


@functools.cache
def draughty() -> UsualErrors:
    """Every reference run is pushed to a side a little, each to its own."""
    changes = [change_of({"draught": {"drive_per_cm_h": float(push)}}) for push in DRAUGHTS]
    with one_blas_thread():
        return learn_from(
            [scene_of(seed, change=change) for seed, change in zip(REFERENCE, changes, strict=True)]
        ).errors


def at(name: str, form: int = 0) -> int:
    return causes().index((name, form))


def seen(name: str, value: float, sd: float, form: int = 0) -> Found:
    """A fit whose last cause came to a value, as if nothing had been known of it before."""
    effect = BY_NAME[name]
    own = strength_of(effect)
    coordinates = np.array([p.centre for p in effect.parameters])
    p = effect.parameters[own]
    precision = sd**-2.0 + p.spread**-2.0
    coordinates[own] = (sd**-2.0 * (p.centre + value) + p.spread**-2.0 * p.centre) / precision
    covariance = np.diag([1.0 / precision] * len(coordinates))
    nothing = np.zeros((1, 9)), np.zeros((1, 2))
    return Found(Hypothesis((Cause(effect, form),)), coordinates, *nothing, covariance=covariance)


def evidence(value: float, sd: float, spread: float) -> float:
    """Of an estimate, if a value of this spread stands against none: nats."""
    wide = sd**2 + spread**2
    return float(-0.5 * np.log(wide / sd**2) - 0.5 * value**2 / wide + 0.5 * value**2 / sd**2)


def errors_of(mean: float, sd: float) -> UsualErrors:
    count = len(causes())
    return UsualErrors(np.full(count, mean), np.full(count, sd), 9)


def test_every_cause_has_one() -> None:
    wanted = [(e.name, form) for e in CATALOGUE if e.name != "circumnutation" for form in range(len(e.forms))]
    assert causes() == wanted
    assert known().errors.mean.shape == known().errors.sd.shape == (len(wanted),)
    assert np.isfinite(known().errors.mean).all()
    assert (known().errors.sd >= 0.0).all()


def test_what_healthy_runs_scatter_by_is_found() -> None:
    assert draughty().sd[at("draught")] == pytest.approx(DRAUGHTS.std(ddof=1), rel=0.5)
    assert known().errors.sd[at("draught")] < 0.35 * DRAUGHTS.std(ddof=1)


def test_an_answer_is_as_late_as_clocks_are() -> None:
    errors = known().errors
    late, clock = at("phototropic_latency"), at("clock_offset")
    assert (errors.mean[late], errors.sd[late]) == (errors.mean[clock], errors.sd[clock])


@pytest.mark.parametrize("name", ["draught", "lamp_asymmetry", "adaptation", "diurnal_growth"])
def test_an_estimate_is_told_without_what_was_known_before(name: str) -> None:
    p = BY_NAME[name].parameters[strength_of(BY_NAME[name])]
    own = told(seen(name, 0.3 * p.spread, 0.2 * p.spread))
    assert own.value - p.centre == pytest.approx(0.3 * p.spread)
    assert own.variance == pytest.approx((0.2 * p.spread) ** 2)
    nothing_told = told(seen(name, 0.0, 1e6))
    assert np.isfinite(nothing_told.value)
    assert nothing_told.variance > p.spread**2


VALUE, SD, SCATTER = st.floats(-3.0, 3.0), st.floats(0.01, 1.0), st.floats(0.0, 2.0)


@given(VALUE, SD)
def test_where_healthy_runs_show_nothing_evidence_is_as_it_was(value: float, sd: float) -> None:
    spread = BY_NAME["draught"].parameters[0].spread
    found = seen("draught", value * spread, sd * spread)
    gain = evidence(value, sd, 1.0)
    assert errors_of(0.0, 0.0).beyond(found, gain, 3) == pytest.approx(gain, abs=1e-6)


@given(VALUE, SD, SCATTER, st.integers(1, 9))
def test_scatter_makes_no_evidence(value: float, sd: float, scatter: float, together: int) -> None:
    """Evidence against a cause may get less, too, but none for it is made."""
    spread = BY_NAME["draught"].parameters[0].spread
    found = seen("draught", value * spread, sd * spread)
    gain = evidence(value, sd, 1.0)
    assert errors_of(0.0, scatter * spread).beyond(found, gain, together) <= max(gain, 0.0) + 1e-6


@given(VALUE, SD, SCATTER)
def test_more_scatter_leaves_less_evidence(value: float, sd: float, scatter: float) -> None:
    spread = BY_NAME["draught"].parameters[0].spread
    found, gain = seen("draught", value * spread, sd * spread), evidence(value, sd, 1.0)
    less, more = (errors_of(0.0, one * spread).beyond(found, gain, 3) for one in (scatter, 1.5 * scatter))
    assert more <= max(less, 0.0) + 1e-6


def test_what_healthy_runs_show_is_no_news_and_beyond_it_is() -> None:
    spread = BY_NAME["draught"].parameters[0].spread
    gain = evidence(0.5, 0.05, 1.0)
    assert gain > 40.0
    usual = errors_of(0.0, 0.4 * spread)
    assert usual.beyond(seen("draught", 0.5 * spread, 0.05 * spread), gain, 3) < 2.0
    large = evidence(3.0, 0.05, 1.0)
    assert usual.beyond(seen("draught", 3.0 * spread, 0.05 * spread), large, 3) > 6.0
    # nine runs that show the same are more than three
    by_count = [usual.beyond(seen("draught", 1.2 * spread, 0.05 * spread), 500.0, n) for n in (1, 3, 9)]
    assert by_count == sorted(by_count)


@given(st.floats(2.0, 2000.0), st.floats(0.0, 1.0))
def test_of_hundreds_of_nats_none_are_left_for_what_healthy_runs_show(gain: float, share: float) -> None:
    """However large the evidence in these runs is, an estimate within the scatter of healthy ones is not worth a claim.

    The fit's own width stands for more evidence than was found, so that it is taken to be wider.
    """
    spread = BY_NAME["draught"].parameters[0].spread
    found = seen("draught", 0.2 * share * spread, 1e-3 * spread)
    assert errors_of(0.0, 0.3 * spread).beyond(found, min(gain, evidence(0.2 * share, 1e-3, 1.0)), 3) < 1.0


def test_what_all_healthy_runs_show_is_no_news_on_its_own_side_only() -> None:
    spread = BY_NAME["draught"].parameters[0].spread
    usual = errors_of(0.5 * spread, 0.05 * spread)
    gain = evidence(0.5, 0.1, 1.0)
    same, other = (usual.beyond(seen("draught", side * 0.5 * spread, 0.1 * spread), gain, 3) for side in (1, -1))
    assert same < 0.0 < gain < other
