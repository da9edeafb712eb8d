"""The lamps' clock and the camera's are apart."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """The light shone later than its record says."""
    change.late_h += v["offset_h"]


def sentence(v: Values) -> str:
    """What it means."""
    when = "after" if v["offset_h"] > 0 else "before"
    return f"what the lamps did shows {abs(v['offset_h']):.2f} h {when} the record says that they did it"


EFFECT: Final = Effect(
    name="clock_offset",
    title="Clocks apart",
    where="clock",
    parameters=(
        Parameter(
            name="offset_h",
            none=0.0,
            low=-1.3,
            high=1.3,
            scale="linear",
            meaning="hours by which lamps acted later than their record says; below 0: earlier",
            source="half an hour is a forgotten time zone; a slow boot is less",
            starts=(-0.4, 0.4),
            least=0.1,
        ),
    ),
    forms=(act,),
    sentence=sentence,
    same_as={"phototropic_latency": "a picture that shows the lamps change, with its time"},
    exactly=frozenset({"phototropic_latency"}),
)
