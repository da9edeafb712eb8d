"""The answer to a lamp gets weaker while it shines, and recovers in the dark."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """Each lamp pulls less the longer it shines."""
    change.terms[terms.ADAPTATION] = min(0.98, max(-0.5, 1.0 - v["floor"]))
    change.terms[terms.ADAPTATION_H] = v["time_constant_h"]


def sentence(v: Values) -> str:
    """What it means."""
    return f"the answer to a lamp falls to {v['floor']:.2f} of what it was, within about {v['time_constant_h']:.1f} h"


EFFECT: Final = Effect(
    name="adaptation",
    title="Adaptation to light",
    where="plant",
    parameters=(
        Parameter(
            name="time_constant_h",
            none=None,
            low=0.7,
            high=4.0,
            scale="log",
            meaning="hours in which the answer weakens and recovers",
            source="phototropism of seedlings: refractory after minutes to hours",
            starts=(0.8, 1.6, 3.2),
        ),
        Parameter(
            name="floor",
            none=1.0,
            low=0.1,
            high=1.0,
            scale="linear",
            meaning="what is left of the answer to a lamp that shines for ever",
            source="no source; half is common",
            starts=(0.6,),
        ),
    ),
    forms=(act,),
    sentence=sentence,
    first_needs=1.0,
    same_as={
        "phototropic_gain": "a lamp that shines for a day and longer, beside fast turns",
        "proprioception": "a lamp that shines for a day and longer, beside fast turns",
    },
)
