"""All growth is faster or slower."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def growing(change: Change, v: Values) -> None:
    """Elongation alone."""
    change.times("growth_early_cm_per_day", v["factor"])
    change.times("growth_late_cm_per_day", v["factor"])


def acting(change: Change, v: Values) -> None:
    """Elongation and bending, as one activity."""
    _with_bending(change, v, 1.0)


def partly(change: Change, v: Values) -> None:
    """Bending by the root of what elongation is: between the two."""
    _with_bending(change, v, 0.5)


def _with_bending(change: Change, v: Values, power: float) -> None:
    growing(change, v)
    for rate in ("photoception_per_cm_h", "graviception_per_cm_h", "proprioception_per_h"):
        change.times(rate, v["factor"] ** power)


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
        ),
    ),
    forms=(
        growing,
        acting,
        partly,
    ),
    sentence=sentence,
    same_as={
        "camera_scale": "a scale bar in the picture",
    },
)
