"""What else might explain some runs, in place of the cause that was chosen last."""

from __future__ import annotations

from flora_lab.diagnose.explanation import Explanation, Stage, Tried


def last_choice(explanation: Explanation) -> Stage | None:
    """Where the last cause of the explanation was chosen, that cause first; None where there is none but a swing."""
    chosen = [accepted for accepted in explanation.accepted if accepted.tried.found is not None]
    if not chosen:
        return None
    last = chosen[-1]
    others = tuple(tried for tried in last.stage.tried if tried.effect.name != last.tried.effect.name)
    return Stage(last.stage.before, (last.tried, *others))


def rivals(explanation: Explanation) -> list[Tried]:
    """The causes that were tried beside the last one that was chosen, best first; swings left out."""
    stage = last_choice(explanation)
    return [] if stage is None else [tried for tried in stage.tried[1:] if tried.found is not None]
