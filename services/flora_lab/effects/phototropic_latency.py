"""The stem answers light later than it should: a pure delay, beside the lag that every plant has."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator import terms


def act(change: Change, v: Values) -> None:
    """The light acts later, and did so before the record began."""
    change.terms[terms.DELAY_H] += max(0.0, v["delay_h"])


def act_after_dark(change: Change, v: Values) -> None:
    """The light acts later; before the record there was none."""
    act(change, v)
    change.terms[terms.DARK_BEFORE] = 1.0


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
        ),
    ),
    forms=(act, act_after_dark),
    sentence=sentence,
    same_as={"clock_offset": "a picture that shows the lamps change, with its time"},
    exactly=frozenset({"clock_offset"}),
)
