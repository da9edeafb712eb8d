"""The plant grows in a rhythm of 24 hours."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def growing(change: Change, v: Values) -> None:
    """Elongation alone."""
    change.terms[terms.DIURNAL] += min(0.95, v["amplitude"])
    change.terms[terms.PEAK_H] = v["peak_h"]


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
    size, peak_h = 100.0 * abs(v["amplitude"]), v["peak_h"] % 24.0
    return f"growth swings by {size:.0f} % about its mean every 24 h, fastest {peak_h:.0f} h after the start"


EFFECT: Final = Effect(
    name="diurnal_growth",
    title="Day rhythm of growth",
    where="plant",
    parameters=(
        Parameter(
            name="amplitude",
            none=0.0,
            low=0.2,
            high=0.8,
            scale="linear",
            meaning="of the rhythm, as a share of the mean rate",
            source="leaves of bean: growth jumps at lights-off",
            starts=(0.4,),
        ),
        Parameter(
            name="peak_h",
            none=None,
            low=0.0,
            high=24.0,
            scale="day",
            meaning="hours after the start of the run at which growth is fastest",
            source="any time",
            starts=(3.0, 9.0, 15.0, 21.0),
        ),
    ),
    forms=(
        growing,
        acting,
        partly,
    ),
    sentence=sentence,
    first_needs=4.0,
    same_as={"temperature_growth": "a day of constant temperature, or lamps shifted against the day"},
)
