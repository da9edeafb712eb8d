"""A centimetre in the picture is none."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """All lengths are wrong by one factor."""
    change.scale *= v["factor"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"all lengths in the record are {v['factor']:.3f} times what they should be"


EFFECT: Final = Effect(
    name="camera_scale",
    title="Wrong scale of the picture",
    where="camera",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.8,
            high=1.2,
            scale="log",
            meaning="centimetres that the record has for one",
            source="a plant a hand farther from the camera than the board that it was measured with",
            starts=(0.93, 1.07),
        ),
    ),
    forms=(act,),
    sentence=sentence,
    same_as={"growth_rate": "a scale bar in the picture"},
    # Told by a law's own lengths alone, which in light that no reference run had are off by some per cent.
    prior=0.05,
)
