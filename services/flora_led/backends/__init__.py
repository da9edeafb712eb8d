"""The chain of pixels; chosen by ``[led] backend``."""

from __future__ import annotations

from typing import Protocol

from flora_led.core import Rgb


class Strips(Protocol):
    """Both strips as one chain."""

    def show(self, left: Rgb, right: Rgb) -> bytes:
        """Write a colour to each lamp.

        Returns:
            the very bytes that went out, 864 in the order green, red, blue.

        Raises:
            LampsDead: they could not be written.
        """
        ...

    def close(self) -> None: ...
