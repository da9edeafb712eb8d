"""A cause that is too little about the plants that have it is not weighed again on top of the same."""

from __future__ import annotations

import pytest
from diagnose_runs import known, scenes_of

from flora_lab.diagnose import explain
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Stage
from flora_lab.threads import one_blas_thread


def test_a_search_ends_though_what_was_weighed_stays_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it displaces another cause, it may be asked for more than it was chosen by."""
    weighed = []

    def too_little(self: Explainer, reached: explain._Reached, stage: Stage) -> Stage:
        weighed.append(stage.tried[0].effect.name)
        assert len(weighed) < 5
        return stage

    monkeypatch.setattr(Explainer, "_with_the_best", too_little)
    with one_blas_thread():
        explanation = Explainer(scenes_of((80, 81), {"clock_offset": {"offset_h": -0.7}}), known()).explain()
    assert weighed == [explanation.stages[0].tried[0].effect.name]
    assert explanation.accepted == ()
