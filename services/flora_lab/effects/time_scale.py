"""The simulator's own clock is wrong: its plants live too fast or too slowly in everything."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values

RATES: Final = (
    "growth_early_cm_per_day",
    "growth_late_cm_per_day",
    "photoception_per_cm_h",
    "graviception_per_cm_h",
    "proprioception_per_h",
)


def act(change: Change, v: Values) -> None:
    """Every rate of the plant."""
    for rate in RATES:
        change.times(rate, 1.0 / v["factor"])
    change.times("photo_latency_min", v["factor"])


def sentence(v: Values) -> str:
    """What it means."""
    return f"simulated plants live {v['factor']:.2f} times as fast as real ones"


EFFECT: Final = Effect(
    name="time_scale",
    title="The simulator's clock",
    where="simulator",
    parameters=(
        Parameter(
            name="factor",
            none=1.0,
            low=0.05,
            high=20.0,
            scale="log",
            meaning="by which all that simulated plants do is faster than what real ones do",
            source="Wahby et al. 2018: simulated plants take 7 h for what real ones need 72 h for",
            starts=(0.3, 3.0),
        ),
    ),
    forms=(act,),
    sentence=sentence,
    prior=0.05,
)
