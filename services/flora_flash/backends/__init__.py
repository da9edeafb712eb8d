"""What the flash lamp hangs on; chosen by ``[flash] backend``."""

from __future__ import annotations

from typing import Protocol


class Lamp(Protocol):
    """A lamp that is on or off, and says which.

    Attributes:
        excuse: the likely reason where it does not do as it was told.
    """

    excuse: str

    def switch(self, on: bool) -> bool:
        """Switch; returns whether the lamp is on by its own account.

        Raises:
            DeviceError: it cannot be reached.
        """
        ...

    def close(self) -> None: ...


class NoLamp:
    """A rig without a flash lamp: photographs are taken in whatever light there is."""

    excuse = 'no flash lamp on this rig ([flash] backend = "none")'

    def switch(self, on: bool) -> bool:
        return False

    def close(self) -> None:
        """Nothing to let go of."""
