"""What else might explain some runs, in place of the cause that was chosen last."""

from __future__ import annotations

from flora_lab.diagnose.explain import Explanation, Stage, Tried


def last_choice(explanation: Explanation) -> Stage | None:
    """The stage at which the last cause of the explanation was chosen; None where there is no cause."""
    names = explanation.found.hypothesis.names()
    for stage in explanation.stages:
        if len(stage.before.hypothesis.causes) == len(names) - 1 and stage.tried:
            first = stage.tried[0].found
            if first is not None and first.hypothesis.names() == names:
                return stage
    return None


def rivals(explanation: Explanation) -> list[Tried]:
    """The causes that were tried beside the last one that was chosen, best first; swings left out."""
    stage = last_choice(explanation)
    return [] if stage is None else [tried for tried in stage.tried[1:] if tried.found is not None]
