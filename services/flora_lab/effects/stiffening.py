"""Tissue stiffens nearer to the tip, or farther from it."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def zones(change: Change, v: Values) -> None:
    """The zone of growth and that of bending."""
    bending(change, v)
    change.times("growth_zone_cm", v["factor"])


def bending(change: Change, v: Values) -> None:
    """The zone of bending alone."""
    change.times("stiffening_cm", v["factor"])
    change.times("mature_cm", v["factor"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"the zone below the tip that grows and bends is {v['factor']:.2f} times as long"


EFFECT: Final = Effect(
    name="stiffening",
    title="Stiffening",
    where="plant",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.5,
            high=1.6,
            scale="log",
            meaning="on the length of the zone below the tip in which a stem grows and bends",
            source="Ohad et al., 54 plants: e-fold of the modulus 3.5 to 6.3 cm",
        ),
    ),
    forms=(
        zones,
        bending,
    ),
    sentence=sentence,
    first_needs=1.0,
)
