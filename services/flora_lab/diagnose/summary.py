"""A diagnosis in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from flora_common.counted import counted
from flora_lab.diagnose.corrected_tracks import FOLDER
from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.diagnose.explanation import Explanation
from flora_lab.diagnose.nameless import times, times_as_probable
from flora_lab.diagnose.residual_words import one_in, p_text, percent_sure
from flora_lab.diagnose.residuals import SIGNIFICANT
from flora_lab.diagnose.verdict import Left
from flora_lab.effects.catalogue import BY_NAME

_WORTH_A_WORD: Final = 0.7
"""Nats: twice as probable."""


def title(effect: str) -> str:
    """For people."""
    return BY_NAME[effect].title


def set_right(corrected: Sequence[str]) -> str:
    """What became of runs in whose record something was wrong, in a sentence.

    Args:
        corrected: names of the tracks without that.
    """
    tracks = f"{counted(len(corrected), 'track')} without that {'is' if len(corrected) == 1 else 'are'}"
    return f"what is wrong in it was set right: {tracks} in the folder {FOLDER}, to take in place of the runs"


def nearest(explanation: Explanation) -> str:
    """What comes nearest to a cause where none is named, in a sentence; empty where little speaks for any."""
    best = explanation.nearest
    if best is None or best.gain < _WORTH_A_WORD:
        return ""
    asked = times(explanation.claim)
    more = "a little more" if asked == times(best.gain) else asked
    return (
        f"Nearest to a name comes {title(best.effect.name).lower()}: with it the runs are "
        f"{times_as_probable(best.gain)}; a name takes {more}."
    )


def summary(
    causes: Sequence[NamedCause],
    left: Left,
    next_best: str = "",
    dropped: Sequence[str] = (),
    p_value: float = 1.0,
    knocks: Sequence[str] = (),
) -> str:
    """What was found.

    Args:
        causes: that are named.
        left: unexplained.
        next_best: where nothing is wrong, what came nearest to a name, see :func:`nearest`.
        dropped: effects that were taken for causes before others made them worthless.
        p_value: of the residuals, all runs taken as wholes.
        knocks: in which runs, when and how far.
    """
    found = _found(causes, left, next_best, dropped, p_value)
    return f"Camera or pot was knocked: {'; '.join(knocks)}. Beside that: {found}" if knocks else found


def _found(causes: Sequence[NamedCause], left: Left, next_best: str, dropped: Sequence[str], p_value: float) -> str:
    """The same, of all but knocks."""
    if not causes:
        if left.unnamed is not None:
            return f"Something is at work that is not in the catalogue. A description that fits: {left.unnamed.words}."
        if left.is_much:
            return (
                "The runs differ from the simulation by more than chance, and by nothing in the catalogue: what is "
                f"left is {left.share:.1f} times what reference runs leave."
            )
        return " ".join(filter(None, [_nothing(p_value), next_best]))
    told = "; ".join(f"{title(cause.effect)} (sure to {percent_sure(cause.confidence)})" for cause in causes) + "."
    if left.unnamed is not None:
        told += f" But something else is at work. A description that fits: {left.unnamed.words}."
    elif left.is_much:
        told += f" But much is left: {left.share:.1f} times what reference runs leave. Something else is at work."
    return " ".join([told, *(f"{title(name)} seemed to be there, and is not needed beside that." for name in dropped)])


def _nothing(p_value: float) -> str:
    if p_value > SIGNIFICANT:
        return (
            "Nothing is wrong: the runs differ from the simulation by no more than chance and individuals make of it."
        )
    return (
        "Nothing is found: the runs are unusual as a whole "
        f"({p_text(p_value)}{one_in(p_value)}), but by nothing that has enough evidence."
    )
