"""The fault menu: what can go wrong in the virtual rig, by name.

Tests and demo share it. Faults of the layer ``world`` are played by the world itself (operation ``fault``); those of
the layer ``rig`` by whoever runs the services.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean

Layer = Literal["world", "rig"]

OPERATIONS: Final = ("now", "wait", "flash", "strips", "shutter", "plant", "fault")
"""What the world's socket understands."""

CAMERA_HANGS: Final = "camera_hangs"
TORN_JPEG: Final = "torn_jpeg"
CAMERA_KNOCKED: Final = "camera_knocked"
FLASH_DEAD: Final = "flash_dead"
LAMP_COMMAND_LOST: Final = "lamp_command_lost"
CLOCK_JUMPS: Final = "clock_jumps"
SPOIL_PICTURES: Final = (TORN_JPEG, CAMERA_KNOCKED)
"""Of these an occurrence is used up by a photograph."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One entry of the menu."""

    name: str
    description: str
    layer: Layer


_ENTRIES: Final = (
    Fault(CAMERA_HANGS, "the shutter never answers; everything else still does", "world"),
    Fault(TORN_JPEG, "the camera hands over a JPEG file that ends too early", "world"),
    Fault(CAMERA_KNOCKED, "the camera looks 1 % of the picture's width beside where it did", "world"),
    Fault(FLASH_DEAD, "the flash lamp stays dark and says so", "world"),
    Fault(LAMP_COMMAND_LOST, "bytes for the strips are acknowledged and ignored", "world"),
    Fault(CLOCK_JUMPS, "the UTC clock is off by `seconds`; the steady clock is not", "world"),
    Fault("service_killed", "a service is killed with SIGKILL", "rig"),
    Fault("bus_restarted", "the bus ends and starts again", "rig"),
    Fault("nas_read_only", "the NAS folder refuses writing", "rig"),
    Fault("nas_gone", "the NAS folder is not there", "rig"),
)

MENU: Final = {fault.name: fault for fault in _ENTRIES}
"""All faults by name."""


class ActiveFaults:
    """The world's faults that are on, and how often each still occurs."""

    def __init__(self) -> None:
        self._left: dict[str, int | None] = {}
        self.clock_offset_s = 0.0

    def switch(self, name: str, on: bool, *, times: int | None = None, seconds: float | None = None) -> None:
        """Turn a fault on or off.

        Args:
            name: of the layer ``world``.
            on: off takes back what is left of it.
            times: how many occurrences; for ever where missing.
            seconds: how far ``clock_jumps`` jumps.

        Raises:
            BadInput: no such fault, one of the rig, or an argument that is missing or does not belong.
        """
        fault = MENU.get(name)
        if fault is None:
            raise BadInput(f"no fault `{name[:60]}`{did_you_mean(name[:60], MENU)}")
        if fault.layer != "world":
            raise BadInput(f"fault `{name}` is played by the rig, not by the world")
        if on and name == CLOCK_JUMPS and seconds is None:
            raise BadInput(f"fault `{name}` needs `seconds`, how far the clock jumps")
        if seconds is not None and name != CLOCK_JUMPS:
            raise BadInput(f"fault `{name}` takes no `seconds`")
        if not on:
            self._left.pop(name, None)
            return
        self._left[name] = times
        if seconds is not None:
            self.clock_offset_s = seconds

    def is_on(self, name: str) -> bool:
        """Whether it would occur now."""
        return name in self._left

    def occurs(self, name: str) -> bool:
        """Whether it occurs now; one occurrence is used up."""
        if name not in self._left:
            return False
        left = self._left[name]
        if left is not None:
            if left <= 1:
                del self._left[name]
            else:
                self._left[name] = left - 1
        return True

    def to_json(self) -> dict[str, object]:
        """For a checkpoint."""
        return {"left": dict(self._left), "clock_offset_s": self.clock_offset_s}

    @classmethod
    def from_json(cls, data: dict[str, object]) -> ActiveFaults:
        """Undo :meth:`to_json`.

        Raises:
            ValueError: not what :meth:`to_json` made.
        """
        faults = cls()
        left, offset = data.get("left"), data.get("clock_offset_s")
        known = isinstance(left, dict) and all(n in MENU and (t is None or isinstance(t, int)) for n, t in left.items())
        if not known or not isinstance(left, dict) or not isinstance(offset, float):
            raise ValueError("faults are not those of this version")
        faults._left, faults.clock_offset_s = dict(left), offset
        return faults
