"""Growth follows the temperature."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def growing(change: Change, v: Values) -> None:
    """Elongation alone."""
    change.terms[terms.PER_DEGREE] += v["per_degree"]


def acting(change: Change, v: Values) -> None:
    """Elongation and bending, as one activity."""
    growing(change, v)
    change.terms[terms.ACTIVITY] = 1.0


def partly(change: Change, v: Values) -> None:
    """Bending by the root of what elongation is: between the two."""
    growing(change, v)
    change.terms[terms.ACTIVITY] = 0.5


def sentence(v: Values) -> str:
    """What it means."""
    return f"growth changes by {100.0 * v['per_degree']:+.1f} % with each degree"


EFFECT: Final = Effect(
    name="temperature_growth",
    title="Growth with temperature",
    where="plant",
    parameters=(
        Parameter(
            name="per_degree",
            none=0.0,
            low=-0.12,
            high=0.12,
            scale="linear",
            meaning="relative change of the rate of growth per degree Celsius",
            source="a Q10 of 2 is 0.07 per degree",
            starts=(-0.05, 0.05),
        ),
    ),
    forms=(
        growing,
        acting,
        partly,
    ),
    sentence=sentence,
    same_as={"diurnal_growth": "a day of constant temperature"},
)
