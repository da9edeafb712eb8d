"""Whether the machine's wall clock can be believed: a Pi has none of its own, and starts with a time of long ago."""

from __future__ import annotations

import ctypes
from typing import Final

from flora_common.config import ClockSection

TIME_ERROR: Final = 5
TIMEX_BYTES: Final = 512
"""More than ``struct timex`` has anywhere (208 on 64-bit Linux)."""


def is_synchronised() -> bool:
    """Whether the kernel was told that its clock is right, by whichever time service runs here.

    Asks ``adjtimex`` and sets nothing: a structure of zeros has no ``modes``. False where it cannot be asked.
    """
    adjtimex = getattr(ctypes.CDLL(None), "adjtimex", None)
    if adjtimex is None:
        return False
    answer = adjtimex(ctypes.create_string_buffer(TIMEX_BYTES))
    return isinstance(answer, int) and 0 <= answer < TIME_ERROR


def is_right(clock: ClockSection) -> bool:
    """Whether a rig's wall clock can be believed: the grow box's always can, a Pi's not before it has been told."""
    return clock.kind == "twin" or is_synchronised()
