"""The real driver class, adafruit-circuitpython-neopixel, on a Pi and on every other machine.

Where there is no Pi, Blinka's agnostic board takes its place: the same class, the same bytes, no pin behind it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from flora_common.errors import DeviceError, LampsDead
from flora_led.core import CHAIN_BYTES, PIXELS, PIXELS_PER_STRIP, Rgb

MODEL: Final = Path("/proc/device-tree/model")
AGNOSTIC: Final = "BLINKA_OS_AGNOSTIC"
AGNOSTIC_PIN: Final = "NEOPIXEL"


def is_pi() -> bool:
    """Whether this machine is a Raspberry Pi."""
    try:
        return b"Raspberry Pi" in MODEL.read_bytes()
    except OSError:
        return False


class NeoPixelStrips:
    """288 pixels behind one pin.

    Args:
        pin: name in Blinka's ``board``, such as ``D18``; used on a Pi only.
        agnostic: leave the pins alone even on a Pi.
    """

    def __init__(self, pin: str, *, agnostic: bool = False) -> None:
        agnostic = agnostic or not is_pi()
        if agnostic:
            os.environ[AGNOSTIC] = "1"  # read when board is first imported
        self._sent = b""
        sent = self._transmitted
        try:
            import board  # noqa: PLC0415 - decides at import what machine this is
            import neopixel  # noqa: PLC0415

            class Chain(neopixel.NeoPixel):  # type: ignore[misc]
                """Shows what really goes to the driver."""

                def _transmit(self, buffer: bytearray) -> None:
                    super()._transmit(buffer)
                    sent(bytes(buffer))

            name = AGNOSTIC_PIN if agnostic else pin
            self._chain: Any = Chain(getattr(board, name), PIXELS, bpp=3, auto_write=False, pixel_order=neopixel.GRB)
        except ImportError as problem:
            raise LampsDead(f"the NeoPixel driver cannot be loaded ({problem}): install flora[rig]") from problem
        except AttributeError as problem:
            raise LampsDead(f"[led] pin `{pin}`: this board has no such pin ({problem})") from problem
        except (NotImplementedError, RuntimeError, ValueError, OSError) as problem:
            raise LampsDead(f"pin {pin}: {problem}") from problem

    def _transmitted(self, grb: bytes) -> None:
        """Called with the bytes after the driver has taken them."""
        self._sent = grb

    def show(self, left: Rgb, right: Rgb) -> bytes:
        self._sent = b""
        try:
            self._chain[0:PIXELS_PER_STRIP] = left
            self._chain[PIXELS_PER_STRIP:PIXELS] = right
            self._chain.show()
        except (RuntimeError, ValueError, OSError, DeviceError) as problem:
            raise LampsDead(f"strips: {problem}") from problem
        if len(self._sent) != CHAIN_BYTES:
            raise LampsDead(f"strips: the driver took {len(self._sent)} bytes instead of {CHAIN_BYTES}")
        return self._sent

    def close(self) -> None:
        self._chain.pin.deinit()
