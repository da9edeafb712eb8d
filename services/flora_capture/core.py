"""What to do with each word of the flash, and whether a photograph has the exposure that was asked for. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import msgspec

from flora_common.messages import Flash

Todo = Literal["nothing", "shoot", "again", "too_late"]

DIGITAL_GAIN: Final = 1.0
"""Anything else means that the camera brightened the picture by arithmetic."""


@dataclass(slots=True)
class Shot:
    """A photograph that is wanted.

    Attributes:
        lamps_told: the lamps had told lately what they do when it was asked for.
    """

    flash: Flash
    flash_confirmed: bool
    tries: int = 0
    lamps_told: bool = False


@dataclass(slots=True)
class Sequence:
    """Once per tick, however often it is told.

    Attributes:
        done: the last tick for which a photograph, or its lack, was announced.
        shot: what is being taken.
    """

    done: int = 0
    shot: Shot | None = field(default=None)

    def hear(self, flash: Flash) -> Todo:
        """What a word of the flash asks for.

        ``shoot``: :attr:`shot` is new; ``again``: announce the same once more; ``too_late``: it is dark again, or was
        left dark, and we were not there.
        """
        busy = self.shot.flash.tick if self.shot else 0
        if flash.tick < max(self.done, busy, 1):
            return "nothing"
        if flash.tick == busy:
            if not flash.lit and self.shot:
                self.shot.flash_confirmed = False  # dark before the picture was there
            return "nothing"
        if flash.tick == self.done:
            return "again" if flash.lit else "nothing"
        if not flash.lit:
            return "too_late"
        self.shot = Shot(flash, flash_confirmed=flash.confirmed)
        return "shoot"

    def finish(self, tick: int) -> None:
        """This tick has been announced."""
        self.done = max(self.done, tick)
        if self.shot and self.shot.flash.tick <= tick:
            self.shot = None


@dataclass(frozen=True, slots=True)
class LockedExposure:
    """What every photograph of a run must have; tolerances are relative, because sensors count in lines and steps."""

    exposure_us: float
    analogue_gain: float
    red_gain: float
    blue_gain: float
    exposure_tolerance: float
    gain_tolerance: float


class Exposure(msgspec.Struct, frozen=True):
    """What the camera says that it did; 0 where it does not say."""

    exposure_us: float = 0.0
    analogue_gain: float = 0.0
    digital_gain: float = 0.0
    red_gain: float = 0.0
    blue_gain: float = 0.0


def exposure_of(metadata: Mapping[str, Any]) -> Exposure:
    """The camera's own words under libcamera's names; what is no finite number within bounds counts as not said."""
    gains = metadata.get("ColourGains")
    red, blue = gains if isinstance(gains, list | tuple) and len(gains) == 2 else (None, None)
    return Exposure(
        exposure_us=_number(metadata.get("ExposureTime"), 1e9),
        analogue_gain=_number(metadata.get("AnalogueGain"), 1e3),
        digital_gain=_number(metadata.get("DigitalGain"), 1e3),
        red_gain=_number(red, 1e3),
        blue_gain=_number(blue, 1e3),
    )


def exposure_note(exposure: Exposure, locked: LockedExposure) -> str:
    """What differs from the locked exposure, in words; empty where nothing does."""
    pairs = (
        ("exposure in us", exposure.exposure_us, locked.exposure_us, locked.exposure_tolerance),
        ("analogue gain", exposure.analogue_gain, locked.analogue_gain, locked.gain_tolerance),
        ("digital gain", exposure.digital_gain, DIGITAL_GAIN, locked.gain_tolerance),
        ("red gain", exposure.red_gain, locked.red_gain, locked.gain_tolerance),
        ("blue gain", exposure.blue_gain, locked.blue_gain, locked.gain_tolerance),
    )
    unsaid = [name for name, is_value, _, _ in pairs if is_value == 0.0]
    if len(unsaid) == len(pairs):
        return "the camera does not tell its exposure"
    notes = [
        f"{name} is {is_value:g}, locked at {want:g}"
        for name, is_value, want, tolerance in pairs
        if is_value != 0.0 and abs(is_value - want) > tolerance * want
    ]
    if unsaid:
        notes.append(f"the camera does not tell {', '.join(unsaid)}")
    return "; ".join(notes)


def _number(value: object, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return 0.0
    return float(value) if 0.0 <= value <= most else 0.0
