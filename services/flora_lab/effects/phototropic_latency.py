"""The stem answers light later than it should: a pure delay, beside the lag that every plant has."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """The light acts later."""
    change.terms[terms.DELAY_H] += max(0.0, v["delay_h"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"the stem answers each change of light {v['delay_h']:.2f} h later"


EFFECT: Final = Effect(
    name="phototropic_latency",
    title="Slower answer to light",
    where="plant",
    parameters=(
        Parameter(
            name="delay_h",
            none=0.0,
            low=0.1,
            high=1.2,
            scale="linear",
            meaning="hours by which the answer comes later",
            source="Arabidopsis, buckwheat: minutes to an hour",
            starts=(0.4,),
            least=0.1,
        ),
    ),
    forms=(act,),
    sentence=sentence,
    same_as={"clock_offset": "a picture that shows the lamps change, with its time"},
    exactly=frozenset({"clock_offset"}),
)
