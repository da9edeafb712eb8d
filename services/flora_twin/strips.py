"""What two NeoPixel strips give off, from the very bytes that were meant for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.runs import Light

PIXELS_PER_STRIP: Final = 144
STRIP_BYTES: Final = 2 * PIXELS_PER_STRIP * 3

PHOTOTROPIN: Final = np.array([0.0, 0.08, 0.92])
"""Weight of red (630 nm), green (530 nm) and blue (475 nm) for bending: phototropins see blue (Christie and Murphy
2013). Green's share is an estimate. Full white is 1."""

LIT: Final = 0.02
"""Share of full light above which a lamp counts as lit."""


@dataclass(frozen=True, slots=True)
class LampLight:
    """What one lamp gives: mean red, green and blue over its pixels, 0 to 1, linear as pulse width is."""

    red: float = 0.0
    green: float = 0.0
    blue: float = 0.0

    @property
    def rgb(self) -> FloatArray:
        return np.array([self.red, self.green, self.blue])

    @property
    def bending(self) -> float:
        """Strength for the plant: 1 for full white."""
        return float(PHOTOTROPIN @ self.rgb)

    @property
    def is_lit(self) -> bool:
        return max(self.red, self.green, self.blue) > LIT


OFF: Final = LampLight()
DARK: Final = (OFF, OFF)


def read_strips(grb: bytes) -> tuple[LampLight, LampLight]:
    """Left and right lamp from the chain's bytes: 288 pixels in the order green, red, blue; 0 to 143 is left.

    Raises:
        BadInput: not 864 bytes.
    """
    if len(grb) != STRIP_BYTES:
        raise BadInput(f"strips: {len(grb)} bytes; the chain of 2 x {PIXELS_PER_STRIP} pixels takes {STRIP_BYTES}")
    levels = np.frombuffer(grb, dtype=np.uint8).reshape(2, PIXELS_PER_STRIP, 3).mean(axis=1) / 255.0
    left, right = (LampLight(float(r), float(g), float(b)) for g, r, b in levels)
    return left, right


def strip_bytes(left: LampLight, right: LampLight) -> bytes:
    """Bytes for two strips that are lit evenly: the inverse of :func:`read_strips` to rounding."""
    chain = np.empty((2, PIXELS_PER_STRIP, 3), dtype=np.uint8)
    for i, lamp in enumerate((left, right)):
        chain[i] = np.clip(np.rint(np.array([lamp.green, lamp.red, lamp.blue]) * 255.0), 0, 255).astype(np.uint8)
    return chain.tobytes()


def light_name(left: LampLight, right: LampLight) -> Light:
    """The state of both lamps as run folders name it."""
    if left.is_lit and right.is_lit:
        return "both"
    if left.is_lit:
        return "left"
    return "right" if right.is_lit else "dark"
