"""Both lamps draw the stem less and less."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import RUN_H, Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """Both lamps lose their pull evenly."""
    change.terms[terms.AGEING_PER_H] += max(-0.9, min(0.98, v["loss"])) / RUN_H


def sentence(v: Values) -> str:
    """What it means."""
    return f"both lamps lose {100.0 * v['loss']:.0f} % of their pull in 72 h"


EFFECT: Final = Effect(
    name="lamp_ageing",
    title="Ageing lamps",
    where="plant",
    parameters=(
        Parameter(
            name="loss",
            none=0.0,
            low=0.05,
            high=0.9,
            scale="linear",
            meaning="share of its pull that a lamp has lost after 72 h",
            source="LEDs that run too hot",
            starts=(0.4,),
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=-1.2,
)
