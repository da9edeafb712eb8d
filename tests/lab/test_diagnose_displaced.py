"""A cause that makes an earlier one worthless takes its place, and is compared with it where that says something."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest
from diagnose_runs import base, known, scenes_of

from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.explanation import Accepted, Stage, Tried
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.effects.catalogue import BY_NAME

EARLIER, LAST = BY_NAME["lamp_asymmetry"], BY_NAME["clock_skew"]


@dataclass
class Runs:
    """That one cause explains as well as two."""

    def fit(self, start: Found) -> Found:
        start.evidence = 100.0
        return start


def found_with(*causes: Cause) -> Found:
    count = sum(len(cause.parameters) for cause in causes)
    traits = base().mean[None]
    return Found(Hypothesis(causes), np.zeros(count), traits, np.zeros((1, 2)), evidence=100.0)


@pytest.mark.parametrize(("beside_the_earlier", "told"), [(9.0, 9.0), (-0.5, 32.0), (1.0, 32.0)])
def test_it_is_told_by_what_it_came_to_beside_the_one_whose_place_it_took(
    beside_the_earlier: float, told: float
) -> None:
    both = found_with(Cause(EARLIER), Cause(LAST))
    earlier, last = Tried(EARLIER, 20.0, found_with(Cause(EARLIER))), Tried(LAST, 32.0, both)
    then = Stage(found_with(), (earlier, Tried(LAST, beside_the_earlier, found_with(Cause(LAST)))))
    now = Stage(found_with(Cause(EARLIER)), (last,))
    accepted = [Accepted(earlier, then), Accepted(last, now)]
    explainer = Explainer(scenes_of((80,)), known())
    found = explainer._pruned(cast(Joint, Runs()), both, accepted)
    assert found.hypothesis.names() == (LAST.name,)
    assert [one.tried.gain for one in accepted] == [told]
    assert len(accepted[0].stage.tried) == (2 if told == beside_the_earlier else 1)
