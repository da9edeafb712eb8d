"""A diagnosis in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence

from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.diagnose.verdict import Left
from flora_lab.effects.catalogue import BY_NAME


def title(effect: str) -> str:
    """For people."""
    return BY_NAME[effect].title


def summary(causes: Sequence[NamedCause], left: Left) -> str:
    """What was found."""
    if not causes:
        if left.unnamed is not None:
            return f"Something is at work that is not in the catalogue. A description that fits: {left.unnamed.words}."
        if left.is_much:
            return (
                "The runs differ from the simulation by more than chance, and by nothing in the catalogue: what is "
                f"left is {left.share:.1f} times what reference runs leave."
            )
        return (
            "Nothing is wrong: the runs differ from the simulation by no more than chance and individuals make of it."
        )
    told = "; ".join(f"{title(cause.effect)} (sure to {100.0 * cause.confidence:.0f} %)" for cause in causes)
    if left.unnamed is not None:
        return f"{told}. But something else is at work. A description that fits: {left.unnamed.words}."
    if left.is_much:
        return f"{told}. But much is left: {left.share:.1f} times what reference runs leave. Something else is at work."
    return f"{told}."
