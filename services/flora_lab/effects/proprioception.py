"""The stem straightens itself faster or slower."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """The plant's constant."""
    change.times("proprioception_per_h", v["factor"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"the stem straightens itself {v['factor']:.2f} times as fast"


EFFECT: Final = Effect(
    name="proprioception",
    title="Proprioception",
    where="plant",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.4,
            high=2.7,
            scale="log",
            meaning="on the constant of proprioception",
            source="Bastien et al. 2013, 2015: constants of one order, over sorts",
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=4.0,
    same_as={
        "phototropic_gain": "a lamp that shines for a day and longer, beside fast turns",
        "adaptation": "a lamp that shines for a day and longer, beside fast turns",
    },
)
