"""What else might explain some runs, in place of the causes that were chosen."""

from __future__ import annotations

from flora_lab.diagnose.explanation import Explanation, Stage, Tried


def choices(explanation: Explanation) -> list[Stage]:
    """Where each cause was chosen, the last first; in each that cause first, without those that are named besides."""
    named = {accepted.tried.effect.name for accepted in explanation.accepted}
    out = []
    for accepted in reversed(explanation.accepted):
        if accepted.tried.found is not None:
            others = tuple(tried for tried in accepted.stage.tried if tried.effect.name not in named)
            out.append(Stage(accepted.stage.before, (accepted.tried, *others)))
    return out


def last_choice(explanation: Explanation) -> Stage | None:
    """Where the last cause of the explanation was chosen, that cause first; None where there is none but a swing."""
    return next(iter(choices(explanation)), None)


def rivals(explanation: Explanation) -> list[Tried]:
    """The causes that were tried beside the last one that was chosen, best first; swings left out."""
    stage = last_choice(explanation)
    return [] if stage is None else [tried for tried in stage.tried[1:] if tried.found is not None]
