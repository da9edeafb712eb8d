"""One lamp draws the stem more than the other."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """The right lamp pulls that many times as much."""
    change.terms[terms.RIGHT_TO_LEFT] *= v["right_to_left"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"the right lamp draws the stem {v['right_to_left']:.2f} times as much as the left one"


EFFECT: Final = Effect(
    name="lamp_asymmetry",
    title="Unequal lamps",
    where="plant",
    parameters=(
        Parameter(
            name="right_to_left",
            none=1.0,
            low=0.4,
            high=2.5,
            scale="log",
            meaning="pull of the right lamp over that of the left",
            source="lamps of one kind differ by some per cent; a dirty or turned one by half",
            starts=(0.75, 1.33),
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=-1.2,
    same_as={
        "draught": "a day in the dark or under both lamps, or the pot turned round",
        "camera_roll": "a plumb line in the picture",
    },
)
