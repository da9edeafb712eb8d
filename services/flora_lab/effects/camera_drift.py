"""The camera turns slowly."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """Pictures are turned more and more."""
    change.drift_deg -= v["angle_deg"]


def sentence(v: Values) -> str:
    """What it means."""
    way = "anticlockwise" if v["angle_deg"] > 0 else "clockwise"
    return f"the picture turns by {abs(v['angle_deg']):.1f} degrees {way} in 72 h"


EFFECT: Final = Effect(
    name="camera_drift",
    title="Turning camera",
    where="camera",
    parameters=(
        Parameter(
            name="angle_deg",
            none=0.0,
            low=-8.0,
            high=8.0,
            scale="linear",
            meaning="of the picture after 72 h against the first, anticlockwise",
            source="a mount that gives way",
            starts=(-3.0, 3.0),
            least=0.5,
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=1.0,
)
