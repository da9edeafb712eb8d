"""Light draws the stem more or less than it should."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """The plant's constant."""
    change.times("photoception_per_cm_h", v["factor"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"light draws the stem {v['factor']:.2f} times as much"


EFFECT: Final = Effect(
    name="phototropic_gain",
    title="Pull of the light",
    where="plant",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.4,
            high=1.8,
            scale="log",
            meaning="on the constant of photoception",
            source="Bastien et al. 2013, 2015: constants of one order, over sorts",
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=-1.2,
    same_as={
        "proprioception": "a lamp that shines for a day and longer, beside fast turns",
        "adaptation": "a lamp that shines for a day and longer, beside fast turns",
    },
)
