"""The camera is not level."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """Every picture is turned about the anchor."""
    change.turn_deg -= v["angle_deg"]


def sentence(v: Values) -> str:
    """What it means."""
    way = "anticlockwise" if v["angle_deg"] > 0 else "clockwise"
    return f"every picture is turned by {abs(v['angle_deg']):.1f} degrees {way}"


EFFECT: Final = Effect(
    name="camera_roll",
    title="Rolled camera",
    where="camera",
    parameters=(
        Parameter(
            name="angle_deg",
            none=0.0,
            low=-8.0,
            high=8.0,
            scale="linear",
            meaning="of the picture, anticlockwise",
            source="a tripod set up by eye is good to a degree or two",
            starts=(-3.0, 3.0),
            least=0.5,
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=4.0,
    same_as={
        "lamp_asymmetry": "a plumb line in the picture",
        "draught": "a plumb line in the picture",
    },
)
