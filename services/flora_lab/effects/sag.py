"""The stem bends under its own weight."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms
from flora_lab.simulator.sag import SETTLING_H, SOFTNESS_CM


def act(change: Change, v: Values) -> None:
    """Weight above each joint bends it."""
    change.terms[terms.SAG] += 0.01 * v["amplitude"]
    change.terms[terms.SOFTNESS_CM] = v["softness_cm"]
    change.terms[terms.SETTLING_H] = v["settling_h"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"the stem sags under its own weight, elastically ({v['amplitude']:.2f})"


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
            least=0.15,
        ),
        Parameter(
            name="softness_cm",
            none=None,
            low=3.5,
            high=8.0,
            scale="log",
            meaning="distance from the tip within which the stem's softness falls e-fold",
            source="Ohad et al.: 5.0 cm (3.5-6.3) in 54 plants; 8 for a stem that stiffens late",
            starts=(SOFTNESS_CM,),
            usual=SOFTNESS_CM,
        ),
        Parameter(
            name="settling_h",
            none=None,
            low=0.02,
            high=0.4,
            scale="log",
            meaning="time constant with which a bend under weight is come to",
            source="no source for beans; from at once to creep of half an hour",
            starts=(SETTLING_H,),
            usual=SETTLING_H,
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=2.0,
)
