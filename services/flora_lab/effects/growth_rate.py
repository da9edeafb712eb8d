"""All growth is faster or slower."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def growing(change: Change, v: Values) -> None:
    """Elongation alone."""
    change.terms[terms.GROWTH] *= v["factor"]


def acting(change: Change, v: Values) -> None:
    """Elongation and bending, as one activity."""
    growing(change, v)
    change.terms[terms.ACTIVITY] = 1.0


def sentence(v: Values) -> str:
    """What it means."""
    return f"stems elongate {v['factor']:.2f} times as fast"


EFFECT: Final = Effect(
    name="growth_rate",
    title="Rate of growth",
    where="plant",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.3,
            high=1.8,
            scale="log",
            meaning="on the rate of elongation",
            source="plants of one sort differ by 10 to 15 %; soil and light do the rest",
            starts=(0.65, 1.4),
        ),
    ),
    forms=(
        growing,
        acting,
    ),
    sentence=sentence,
)
