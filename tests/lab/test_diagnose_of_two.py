"""Two effects of which one alone is too little to be named."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

from diagnose_runs import known, scenes_of

from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.verdict import left_of, named
from flora_lab.threads import one_blas_thread

HIDDEN: Mapping[str, Mapping[str, float]] = {
    "clock_offset": {"offset_h": -0.4},
    "draught": {"drive_per_cm_h": 0.08},
}


def explained(asked_besides: Mapping[str, float]) -> Explanation:
    """With more asked of some first causes than usually."""
    explainer = Explainer(scenes_of((80,), HIDDEN), known())
    trials = explainer.trials
    trials.claims = replace(trials.claims, besides={**trials.claims.besides, **asked_besides})
    with one_blas_thread():
        return explainer.explain()


@functools.cache
def usual() -> Explanation:
    return explained({})


def test_two_that_are_enough_together_are_named_though_the_first_is_not_by_itself() -> None:
    first, second = (stage.tried[0] for stage in usual().stages[:2])
    assert {first.effect.name, second.effect.name} == set(HIDDEN)
    assert not usual().is_of_two
    together = explained({first.effect.name: first.gain + 0.5 * second.gain})
    assert together.is_of_two
    assert together.claim > together.stages[0].tried[0].gain
    assert [one.tried.effect.name for one in together.accepted] == [first.effect.name, second.effect.name]
    assert set(together.found.hypothesis.names()) == set(HIDDEN)
    # what is told of the first is what speaks for it beside the second
    beside = together.accepted[0]
    assert beside.stage.before.hypothesis.names() == (second.effect.name,)
    assert beside.tried is beside.stage.tried[0]
    causes = named(together, left_of(together, known()))
    assert {cause.effect for cause in causes} == set(HIDDEN)
    for cause in causes:
        assert not set(cause.confusable_with) & set(HIDDEN)
        assert "both together are" in cause.evidence
    assert not any("together" in cause.evidence for cause in named(usual(), left_of(usual(), known())))


def test_two_that_are_too_little_together_are_not() -> None:
    first, second = (stage.tried[0] for stage in usual().stages[:2])
    nothing = explained({first.effect.name: first.gain + 1.1 * second.gain})
    assert nothing.accepted == ()
    assert not nothing.is_of_two
    assert nothing.found.hypothesis.names() == ()
    assert len(nothing.stages) == 1
