"""One run before it is grown: the plant, what it is exposed to, what befalls it, and how it is recorded.

Effects are functions that change a :class:`Scene`. Times in hours since the run's start unless a name says otherwise;
every run starts at midnight, so the hour of the day is the same number modulo 24.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import Light

from . import kernel

STEP_S = 150.0
ROW_S = 300.0
STEPS_PER_ROW = round(ROW_S / STEP_S)
HOUR_S = 3600.0
STEP_H = STEP_S / HOUR_S
LIGHT_CODES: tuple[Light, ...] = ("left", "right", "dark", "both")
"""Lamp states by their code in the kernel."""


@dataclass
class Plant:
    """Constants of one individual; defaults are the typical plant of form 0. In the kernel's order."""

    initial_length_cm: float = 6.5
    lean_rad: float = 0.0
    early_cm_per_day: float = 3.4
    late_cm_per_day: float = 6.8
    growth_zone_cm: float = 6.0
    bending_zone_cm: float = 6.0
    photo_per_cm_h: float = 0.28
    gravity_per_cm_h: float = 0.25
    proprioception_per_h: float = 0.9
    latency_h: float = 0.25
    curve_u_per_cm: float = 0.0
    curve_v_per_cm: float = 0.0


@dataclass
class Laws:
    """Forms of the equations and where the lamps hang, the same for all plants of a case. In the kernel's order.

    Codes are those of :mod:`kernel`; lengths in cm. ``fall`` is the power of the distance with which light falls.
    """

    stiffening: int = kernel.BOX
    elongation: int = 0
    growth: int = 0
    response: int = kernel.LINEAR
    fall: float = 1.0
    half: float = 1.0
    pull: int = 0
    dilution: int = 0
    twist_per_cm: float = 0.0
    lamp_x_cm: float = 35.0
    lamp_y_cm: float = 30.0
    lamp_z_cm: float = 0.0


@dataclass
class Events:
    """What befalls a plant or makes it another one; the defaults are nothing. In the kernel's order."""

    delay_h: float = 0.0
    adaptation_h: float = 0.0
    adaptation_floor: float = 1.0
    sag_per_cm3: float = 0.0
    wall_x_cm: float = 0.0
    kick_h: float = -1.0
    kick_per_cm: float = 0.0
    shy_cm: float = 0.0
    history: float = 0.0
    history_h: float = 8.0


@dataclass
class Record:
    """How camera and clock turn the plant into rows.

    Attributes:
        roll_deg: the picture's turn about the anchor, anticlockwise, at the start.
        drift_deg: what is added to it by the end of the run.
        scale: recorded over true length.
        offset_h: the pictures' clock is so far ahead of the lamps', so that the plant seems to answer late.
        skew_per_h: the pictures' clock gains so many hours on the lamps' in each hour.
        gap_share: share of rows that are missing, in gaps of hours.
        miss_share: share of rows whose tip was found in a wrong place.
    """

    roll_deg: float = 0.0
    drift_deg: float = 0.0
    scale: float = 1.0
    offset_h: float = 0.0
    skew_per_h: float = 0.0
    gap_share: float = 0.0
    miss_share: float = 0.0


@dataclass
class Scene:
    """One run: everything that the kernel and the record need.

    Attributes:
        schedule: code of the lamp of each row from the start on, longer than the run; -1 leaves it to a closed loop.
        target_x_cm: where the closed loop wants the tip.
        camera_cm: distance of the camera in front of the plant; 0 is infinitely far.
        series: shape (steps, 9), in the kernel's order; see :mod:`kernel`.
        temperature_c: shape (steps + 1,).
    """

    plant: Plant
    laws: Laws
    schedule: np.ndarray
    hours: float
    target_x_cm: float = 0.0
    camera_cm: float = 0.0
    events: Events = field(default_factory=Events)
    record: Record = field(default_factory=Record)
    series: FloatArray = field(init=False)
    temperature_c: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        steps = round(self.hours * HOUR_S / ROW_S) * STEPS_PER_ROW
        self.series = np.zeros((steps, 9))
        self.series[:, [kernel.LEFT, kernel.RIGHT, kernel.GROWTH, kernel.GAIN, kernel.BENDING, kernel.ZONE]] = 1.0
        self.temperature_c = np.full(steps + 1, 22.0)

    @property
    def hour_h(self) -> FloatArray:
        """Hours since the start at the middle of each step, shape (steps,)."""
        return (np.arange(len(self.series)) + 0.5) * STEP_H

    def scale_series(self, column: int, factor: FloatArray | float) -> None:
        """Multiply one column, all steps or step by step."""
        self.series[:, column] *= factor

    def lamp_codes(self) -> np.ndarray:
        """The lamp of each step as the plant sees it; a pictures' clock that runs fast has shorter true steps."""
        true_h = np.arange(len(self.series)) * STEP_H / (1.0 + self.record.skew_per_h)
        return self.schedule[self._rows_of(true_h)]

    def recorded_codes(self, grown: np.ndarray) -> np.ndarray:
        """The lamp that the record gives each row, by the lamps' clock; ``grown`` are the codes of the steps lit.

        A row's lamp shone over the interval before it.
        """
        record = self.record
        rows = len(self.series) // STEPS_PER_ROW + 1
        known = self.schedule.copy()
        known[: rows - 1] = np.where(known[: rows - 1] < 0, grown[::STEPS_PER_ROW], known[: rows - 1])
        known[rows - 1 :] = np.where(known[rows - 1 :] < 0, known[rows - 2], known[rows - 1 :])
        stamp_h = (np.arange(rows) - 0.5) * ROW_S / HOUR_S + record.offset_h
        return known[self._rows_of(stamp_h)]

    def grow(self) -> tuple[FloatArray, np.ndarray, np.ndarray]:
        """Nodes (rows, most, 3), how many of each row are used, and the lamp of each step."""
        dt_h = STEP_H / (1.0 + self.record.skew_per_h)
        lines, used, lit = kernel.grow(
            np.array(astuple(self.plant), dtype=np.float64),
            np.array(astuple(self.laws), dtype=np.float64),
            self.series,
            self.lamp_codes(),
            self.target_x_cm,
            np.array(astuple(self.events), dtype=np.float64),
            dt_h,
            STEPS_PER_ROW,
        )
        return lines, used, lit

    def tip_cm(self) -> FloatArray:
        """Where the tip goes, across the picture and up, shape (rows, 2)."""
        lines, used, _ = self.grow()
        tips: FloatArray = lines[np.arange(len(lines)), used - 1, :2]
        return tips

    def _rows_of(self, time_h: FloatArray) -> np.ndarray:
        rows = np.floor(time_h * HOUR_S / ROW_S + 1e-9).astype(np.int64)
        return np.clip(rows, 0, len(self.schedule) - 1)
