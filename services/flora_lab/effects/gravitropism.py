"""The stem rights itself more or less than it should."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """The plant's constant."""
    change.times("graviception_per_cm_h", v["factor"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"the stem rights itself {v['factor']:.2f} times as strongly"


EFFECT: Final = Effect(
    name="gravitropism",
    title="Gravitropism",
    where="plant",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.4,
            high=2.7,
            scale="log",
            meaning="on the constant of graviception",
            source="Bastien et al. 2013, 2015: constants of one order, over sorts",
        ),
    ),
    forms=(act,),
    sentence=sentence,
)
