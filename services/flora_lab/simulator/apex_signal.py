"""What the apex senses, on its way to the tissue below it: a line of what was sent in the last six hours, compiled."""

from __future__ import annotations

from typing import Final

from flora_common.arrays import Array
from flora_lab.simulator.fast_functions import inlined
from flora_lab.simulator.rod import LONGEST_STEP_H

_SLOTS: Final = 72
"""Five minutes each in the longest time that a signal is under way, and one that is being written."""
SENT: Final = (_SLOTS // 2, 2)
"""What is remembered of the apex's signal: one of five minutes after the other, two in a row."""
_ROUNDING: Final = 1e-9
"""Parts of five minutes that sums of steps may be off."""


@inlined
def send(sent: Array, light: float, told_h: float) -> int:
    """What the apex senses goes on its way; returns its place. Before the first step it is taken to have been that."""
    if told_h == 0.0:
        sent[:] = light
    at = int(told_h / LONGEST_STEP_H + _ROUNDING) % _SLOTS
    sent[at // 2, at % 2] = light
    return at


@inlined
def arrived(sent: Array, at: int, ago_h: float) -> float:
    """What the apex sensed so long ago."""
    slots = min(ago_h / LONGEST_STEP_H, _SLOTS - 2.0)
    whole = int(slots)
    near, far = (at - whole) % _SLOTS, (at - whole - 1) % _SLOTS
    share = slots - whole
    return float((1.0 - share) * sent[near // 2, near % 2] + share * sent[far // 2, far % 2])
