"""The tip swings by itself."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """A swing of the tip that no lamp causes."""
    change.rhythm_h = v["period_h"]
    change.rhythm_cm = v["amplitude_cm"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"the tip swings by itself, {v['amplitude_cm']:.2f} cm to each side every {v['period_h']:.2f} h"


EFFECT: Final = Effect(
    name="circumnutation",
    title="Circumnutation",
    where="plant",
    parameters=(
        Parameter(
            name="period_h",
            none=None,
            low=1.2,
            high=2.6,
            scale="log",
            meaning="of the swing",
            source="Ohad et al., 103 beans: 98.6 +- 12.8 min (74-155)",
        ),
        Parameter(
            name="amplitude_cm",
            none=0.0,
            low=0.3,
            high=3.0,
            scale="linear",
            meaning="of the tip in the picture plane, middle to side",
            source="small in seedlings; 12 cm at 37 cm height",
            most=20.0,
        ),
    ),
    forms=(act,),
    sentence=sentence,
)
