"""The strips of the virtual grow box: the real driver's bytes go to the box as they are."""

from __future__ import annotations

from flora_common.twin_link import TwinLink
from flora_led.backends.neopixel import NeoPixelStrips


class VirtualStrips(NeoPixelStrips):
    """Args:
    address: the box's endpoint.
    timeout_s: real seconds to wait for its answer.
    """

    def __init__(self, address: str, *, timeout_s: float = 5.0) -> None:
        self._link = TwinLink(address, timeout_s=timeout_s)
        super().__init__("NEOPIXEL", agnostic=True)

    def _transmitted(self, grb: bytes) -> None:
        self._link.ask("strips", grb=grb)
        super()._transmitted(grb)

    def close(self) -> None:
        super().close()
        self._link.close()
