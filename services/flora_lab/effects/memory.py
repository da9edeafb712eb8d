"""The simulator forgets: its next stem depends on the present one alone.

No term of the mechanistic law, which has a memory: only a learned simulator can lack one. It has no form that a search
could try; :mod:`flora_lab.diagnose.learned_simulator` finds it.
"""

from __future__ import annotations

from typing import Final

from flora_lab.effects.effect import Effect, Parameter, Values


def sentence(v: Values) -> str:
    """What it means."""
    return f"the simulator forgets at once what a plant remembers for some {v['time_constant_h']:.1f} h"


EFFECT: Final = Effect(
    name="memory",
    title="A simulator without memory",
    where="simulator",
    parameters=(
        Parameter(
            name="time_constant_h",
            none=None,
            low=0.1,
            high=4.0,
            scale="log",
            meaning="of the trace of the lamps that tells most of the simulator's errors",
            source="from two photographs to most of a lamp's turn of six hours",
        ),
    ),
    forms=(),
    sentence=sentence,
)
