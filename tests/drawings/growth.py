"""How a drawn plant grows and bends: a plane curve by its curvature, which only the youngest part changes.

The stem lengthens near its tip (a point at distance x of the zone's length below the tip moves along the stem with
(1 - x)^2 of the tip's speed) and bends there towards the lit lamp, up against gravity, and round its own beat
(circumnutation). What the zone has left behind keeps its curvature for good. A seedling's hook and a nodding tip are
laid over that. None of this is meant as physiology; it is meant to move as plants move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import Light

STEP_S = 300.0
SPACING_CM = 0.1


@dataclass(frozen=True, slots=True)
class Posture:
    """A stem at one time.

    Attributes:
        time_s: since the start.
        line_cm: shape (n, 2), base first, tip last; n >= 60.
        along_cm: shape (n,), distance from the base along the stem.
        heading_rad: shape (n,), direction of growth from the vertical, to the right positive.
        node_cm: where the leaves sit along the stem; NaN before they come.
    """

    time_s: float
    line_cm: FloatArray
    along_cm: FloatArray
    heading_rad: FloatArray
    node_cm: FloatArray

    @property
    def length_cm(self) -> float:
        return float(self.along_cm[-1])


def light_schedule(rng: np.random.Generator, hours: float) -> list[tuple[float, Light]]:
    """(from when in s, lamp): every six hours, or at random."""
    lamps: tuple[Light, Light] = ("left", "right")
    first = int(rng.integers(2))
    even = bool(rng.random() < 0.5)
    switches: list[tuple[float, Light]] = []
    hour = 0.0
    while hour <= hours or not switches:
        switches.append((hour * 3600.0, lamps[(first + len(switches)) % 2]))
        hour += 6.0 if even else float(rng.uniform(1.5, 10.0))
    return switches


def light_at(schedule: list[tuple[float, Light]], time_s: float) -> Light:
    """The lamp that shone just before this time."""
    shining = schedule[0][1]
    for start_s, lamp in schedule:
        if start_s < time_s:
            shining = lamp
    return shining


class Growth:
    """The history of one stem, drawn at random, for any time from 0 to ``hours``."""

    def __init__(self, rng: np.random.Generator, schedule: list[tuple[float, Light]], hours: float) -> None:
        self.start_cm = float(rng.uniform(3.0, 7.0))
        self.end_cm = float(rng.uniform(12.0, 25.0))
        self.zone_cm = float(rng.uniform(3.5, 7.0))
        self.light_rad = math.radians(rng.uniform(45, 80))
        self.photo_per_h = float(rng.uniform(0.10, 0.50))
        self.gravi_per_h = float(rng.uniform(0.03, 0.10))
        self.straighten_per_h = float(rng.uniform(0.01, 0.08))
        self.swing_rad = math.radians(rng.uniform(2, 12))
        self.swing_h = float(rng.uniform(1.5, 4.0))
        self.swing_phase = float(rng.uniform(0, 2 * math.pi))
        self.lean_rad = float(rng.normal(0, 0.18))
        self.early = float(rng.uniform(0.6, 1.5))
        kind = rng.random()
        self.hook_rad = float(rng.choice([-1, 1]) * rng.uniform(2.2, 3.1)) if kind < 0.35 else 0.0
        self.hook_cm = float(rng.uniform(1.6, 2.8))
        self.hook_open_h = rng.uniform(4, 14), rng.uniform(18, 40)
        self.nod_rad = float(rng.choice([-1, 1]) * rng.uniform(1.2, 2.7)) if 0.25 < kind < 0.6 else 0.0
        self.nod_cm = float(rng.uniform(2.5, 5.0))
        down, up = sorted(rng.uniform(20, 80, 2))
        self.nod_h = float(down), float(up) + 6.0
        births_h = np.concatenate([[0.0, 0.0], np.cumsum(rng.uniform(14, 30, 5))])
        self._schedule, self._rng, self.births_h = schedule, rng, births_h
        self._compute(hours)

    def _length_cm(self, hour: float) -> float:
        share = min(max(hour / 72.0, 0.0), 1.2)
        return self.start_cm + (self.end_cm - self.start_cm) * (share**self.early)

    def _compute(self, hours: float) -> None:
        steps = math.ceil(hours * 3600.0 / STEP_S) + 1
        cells = math.ceil(self.end_cm * 1.3 / SPACING_CM) + 2
        s = np.arange(cells) * SPACING_CM
        waves = sum(self._rng.normal(0, 0.06) * np.sin(2 * np.pi * s / w + self._rng.uniform(0, 6)) for w in (3, 7, 12))
        bend = np.asarray(waves)
        node = np.full(self.births_h.size, np.nan)
        node[0] = self.start_cm * self._rng.uniform(0.45, 0.75)
        node[1] = self.start_cm - self._rng.uniform(0.3, 0.8)
        self._bend, self._node = np.empty((steps, cells)), np.empty((steps, node.size))
        step_h = STEP_S / 3600.0
        for i in range(steps):
            hour = i * step_h
            length = self._length_cm(hour)
            born = np.isnan(node) & (self.births_h <= hour)
            node[born] = length - 0.35
            self._bend[i], self._node[i] = bend, node
            grown = self._length_cm(hour + step_h) - length
            x = np.clip((length - s) / self.zone_cm, 0.0, 1.0)
            moved = s + grown * np.where(s <= length, (1 - x) ** 2, 1.0)
            stretch = 1.0 + grown * np.where(s <= length, 2 * (1 - x) / self.zone_cm, 0.0)
            heading = self.lean_rad + np.cumsum(bend) * SPACING_CM
            side = -1.0 if light_at(self._schedule, hour * 3600.0 + 1.0) == "left" else 1.0
            urge = self.photo_per_h * np.sin(side * self.light_rad - heading) - self.gravi_per_h * np.sin(heading)
            beat = 2 * math.pi / self.swing_h
            urge = urge + self.swing_rad * beat * math.cos(beat * hour + self.swing_phase)
            able = (1 - x) ** 2 * (1 + 2 * x)
            turned = bend + step_h * able * (urge * 1.5 / self.zone_cm - self.straighten_per_h * bend)
            turned[s > length] = turned[min(int(length / SPACING_CM), cells - 1)]
            bend = np.interp(s, moved, turned / stretch)
            node = node + grown * np.clip(1 - (length - node) / self.zone_cm, 0.0, 1.0) ** 2

    def at(self, time_s: float) -> Posture:
        """The stem at a time."""
        hour = time_s / 3600.0
        place = min(max(time_s / STEP_S, 0.0), len(self._bend) - 1.0)
        i = min(int(place), len(self._bend) - 2) if len(self._bend) > 1 else 0
        j, share = min(i + 1, len(self._bend) - 1), place - i
        length = self._length_cm(hour)
        s = np.linspace(0.0, length, max(60, math.ceil(length / 0.05) + 1))
        grid = np.arange(self._bend.shape[1]) * SPACING_CM
        bend = np.interp(s, grid, (1 - share) * self._bend[i] + share * self._bend[j])
        bend = bend + _arch((length - s) / self.hook_cm) * self.hook_rad * self._hooked(hour) / self.hook_cm
        nod_cm = min(self.nod_cm, 0.6 * length)
        bend = bend + _arch((length - s) / nod_cm) * self.nod_rad * self._nodding(hour) / nod_cm
        ds = s[1] - s[0]
        heading = self.lean_rad + np.concatenate([[0.0], np.cumsum((bend[1:] + bend[:-1]) / 2 * ds)])
        middle = (heading[1:] + heading[:-1]) / 2
        steps = np.column_stack([np.sin(middle), np.cos(middle)]) * ds
        line = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        node = np.where(np.isnan(self._node[i]), np.nan, (1 - share) * self._node[i] + share * self._node[j])
        return Posture(time_s, line, s, heading, node)

    def _hooked(self, hour: float) -> float:
        begin, took = self.hook_open_h
        return 1.0 - _smooth((hour - begin) / took)

    def _nodding(self, hour: float) -> float:
        down, up = self.nod_h
        return _smooth((hour - down) / 7.0) * (1.0 - _smooth((hour - up) / 7.0))


def _smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)


def _arch(x: FloatArray) -> FloatArray:
    """Unit area over 0..1, zero outside, smooth at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 30.0 * x**2 * (1 - x) ** 2
