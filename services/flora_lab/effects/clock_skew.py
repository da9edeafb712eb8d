"""One clock runs faster than the other."""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Change, Effect, Parameter, Values


def act(change: Change, v: Values) -> None:
    """The light shone more and more late."""
    change.late_per_h += v["per_hour"]


def sentence(v: Values) -> str:
    """What it means."""
    when = "later" if v["per_hour"] > 0 else "earlier"
    minutes = 60.0 * abs(v["per_hour"])
    return f"what the lamps did shows ever {when} than the record says: by {minutes:.1f} minutes more with every hour"


EFFECT: Final = Effect(
    name="clock_skew",
    title="A clock that runs wrong",
    where="clock",
    parameters=(
        Parameter(
            name="per_hour",
            none=0.0,
            low=-0.05,
            high=0.05,
            scale="linear",
            meaning="hours by which lamps act ever later than their record says, per hour; below 0: ever earlier",
            source="a bad oscillator; a computer that sleeps",
            starts=(-0.015, 0.015),
            least=0.1 / 72.0,
        ),
    ),
    forms=(act,),
    sentence=sentence,
)
