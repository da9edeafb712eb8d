"""The stem bends under its own weight."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """Weight above each joint bends it."""
    change.terms[terms.SAG] += 0.01 * v["amplitude"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"the stem sags under its own weight, elastically and at once ({v['amplitude']:.2f})"


EFFECT: Final = Effect(
    name="sag",
    title="Sagging under its own weight",
    where="plant",
    parameters=(
        Parameter(
            name="amplitude",
            none=0.0,
            low=0.2,
            high=2.0,
            scale="linear",
            meaning="elastic bend, 0.01 per cm^3 of softness at the tip",
            source="Ohad et al.: the modulus grows e-fold in 5 cm from the tip",
            starts=(0.7,),
            least=0.05,
        ),
    ),
    forms=(act,),
    sentence=sentence,
)
