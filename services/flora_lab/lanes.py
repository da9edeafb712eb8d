"""How many plants the compiled products take side by side: a setting, for processors differ in their vectors.

What comes out is the same to the bit, whatever the number: no lane has to do with its neighbours.
"""

from __future__ import annotations

import os
from typing import Final

from flora_common.errors import BadInput

VARIABLE: Final = "FLORA_LANES"
CHOICES: Final = (16, 32, 64)
"""Loops over fewer are unrolled by LLVM before they become vectors, and take seven times as long."""
_WIDE: Final = "+avx512f"


def given() -> str:
    """What the user has set, where :func:`lanes` takes it; else nothing."""
    text = os.environ.get(VARIABLE, "")
    return text if text in map(str, CHOICES) else ""


def lanes(features: str) -> int:
    """Numbers side by side: as :data:`VARIABLE` says, or as many as suit the processor.

    Four rows of them are summed at a time, and the sums are to stay in registers, with what is multiplied: 32 registers
    of 512 bits have room for 32 lanes; 16 of 256 bits (AVX2) and 32 of 128 bits (NEON) for 16.

    Args:
        features: of the processor as LLVM names them, such as ``+avx2,+fma,-avx512f``.

    Raises:
        BadInput: the variable says what is none of :data:`CHOICES`.
    """
    if given():
        return int(given())
    if text := os.environ.get(VARIABLE, ""):
        raise BadInput(f"{VARIABLE} is {text!r}; set it to one of {', '.join(map(str, CHOICES))}, or not at all")
    return 32 if _WIDE in features.split(",") else 16
