"""The catalogue: effects by name, their parameters drawn in plausible ranges, and what each does to a run.

An effect has a typical strength, a deviation from nothing. The drawn one is that deviation times a factor between 0.6
and 1.7, even in its logarithm, in both directions where both make sense, and within the plausible range.

What parameters mean:

- ``circumnutation``: ``period_h``, ``amplitude_cm`` (of the tip about its path, in the picture); phase by run, cycles
  vary by 4.5 %.
- ``phototropic_latency``: ``delay_h`` on top of the plant's own latency.
- ``adaptation``: under light the response to a lamp falls with ``time_constant_h`` to the share ``floor`` and recovers
  with the same time constant.
- ``lamp_asymmetry``: the right lamp has ``right_to_left`` times the left one's brightness.
- ``lamp_ageing``: both lamps lose the share ``loss`` of their brightness, evenly over 72 h.
- ``diurnal_growth``: elongation times 1 + ``amplitude`` cos(2 pi (hour - ``peak_h``) / 24); runs start at hour 0.
- ``temperature_growth``: elongation times exp(``per_degree`` (temperature - 22)).
- ``growth_rate``, ``stiffening`` (length of the bending zone), ``gravitropism``, ``proprioception``,
  ``phototropic_gain``: the plant's constant times ``factor``.
- ``sag``: elastic curvature under the own weight, 0.015 ``amplitude`` per cm^3 times the moment of what lies above,
  softest at the tip (see :mod:`kernel`).
- ``draught``: a steady drive to the right, ``drive_per_cm_h``.
- ``camera_roll``, ``camera_drift`` (over 72 h): ``angle_deg``, anticlockwise in the picture. ``camera_scale``:
  recorded over true length, ``factor``.
- ``clock_offset``, ``clock_skew``: the pictures' clock is ahead of the lamps' by ``offset_h``, or gains ``per_hour``.

Sources of the ranges: circumnutation of common bean 98.6 +- 12.8 min (Ohad et al. data); latency a few minutes to an
hour (Arabidopsis, buckwheat); the rest are what a rig or a seed batch can plausibly do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from . import kernel
from .individuals import drift
from .scene import STEPS_PER_ROW, Scene

Parameters = dict[str, float]
WEAKEST, STRONGEST = 0.6, 1.7
SAG_PER_CM3 = 0.015
"""Elastic curvature at the tip per cm^2 of moment at an amplitude of 1: a soft stem bends and does not yet fold."""
TRIAL_PER_CM_H = 0.1
"""Turning drive with which a plant is tried to learn how far its tip moves."""


@dataclass(frozen=True)
class Effect:
    """An effect: how its parameters are drawn, and what it does to a scene.

    Attributes:
        draw: from chance to parameters.
        apply: changes a scene; its chance is the run's own.
    """

    draw: Callable[[np.random.Generator], Parameters]
    apply: Callable[[Scene, Mapping[str, float], np.random.Generator], None]


def strength(rng: np.random.Generator) -> float:
    """How many times the typical deviation."""
    return float(np.exp(rng.uniform(math.log(WEAKEST), math.log(STRONGEST))))


def sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def ratio(name: str, typical: float, low: float, high: float) -> Callable[[np.random.Generator], Parameters]:
    """Draws a factor whose logarithm deviates from 0 as the typical one's does, in either direction.

    A factor beyond the range is drawn again: limits would otherwise be the likeliest values.
    """

    def draw(rng: np.random.Generator) -> Parameters:
        while True:
            value = math.exp(abs(math.log(typical)) * strength(rng) * sign(rng))
            if low <= value <= high:
                return {name: value}

    return draw


def amount(
    name: str, typical: float, low: float, high: float, *, both: bool
) -> Callable[[np.random.Generator], Parameters]:
    """Draws an amount about the typical one; both signs where ``both``."""

    def draw(rng: np.random.Generator) -> Parameters:
        value = min(max(typical * strength(rng), low), high)
        return {name: value * sign(rng) if both else value}

    return draw


def constant(field: str) -> Callable[[Scene, Mapping[str, float], np.random.Generator], None]:
    """Multiplies one of the plant's constants by ``factor``."""

    def apply(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
        setattr(scene.plant, field, getattr(scene.plant, field) * p["factor"])

    return apply


def event(field: str, parameter: str, unit: float = 1.0) -> Callable[..., None]:
    def apply(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
        setattr(scene.events, field, p[parameter] * unit)

    return apply


def record(field: str, parameter: str) -> Callable[..., None]:
    def apply(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
        setattr(scene.record, field, p[parameter])

    return apply


def _draw_circumnutation(rng: np.random.Generator) -> Parameters:
    period_h = float(np.clip(rng.normal(1.64, 0.21) if rng.random() < 0.6 else rng.uniform(1.2, 2.6), 1.2, 2.6))
    return {"period_h": period_h, "amplitude_cm": max(0.3, 0.6 * strength(rng))}


def _circumnutation(scene: Scene, p: Mapping[str, float], rng: np.random.Generator) -> None:
    """A turning drive, so large that the tip moves by the stated amplitude about where it would be without."""
    steps = len(scene.series)
    pace = 2.0 * math.pi / p["period_h"]
    jitter = 0.045 * drift(rng, steps, p["period_h"])
    phase = np.cumsum(pace * np.exp(jitter) * np.diff(scene.hour_h, prepend=0.0)) + rng.uniform(0.0, 2.0 * math.pi)
    in_depth = float(scene.camera_cm > 0.0)
    still = scene.series.copy()

    def drive(per_cm_h: float) -> None:
        scene.series = still.copy()
        scene.series[:, kernel.DRIVE_X] += per_cm_h * np.cos(phase)
        scene.series[:, kernel.DRIVE_Z] += in_depth * per_cm_h * np.sin(phase)

    drive(0.0)
    without_cm, _ = scene.tip_cm(), drive(TRIAL_PER_CM_H)
    moved_cm = (scene.tip_cm() - without_cm)[steps // STEPS_PER_ROW // 6 :]
    drive(TRIAL_PER_CM_H * p["amplitude_cm"] / math.sqrt(2.0 * float(moved_cm.var(axis=0).sum())))


def _draw_adaptation(rng: np.random.Generator) -> Parameters:
    time_h = float(np.exp(rng.uniform(math.log(0.7), math.log(4.0))))
    return {"time_constant_h": time_h, "floor": max(0.2, 1.0 - 0.5 * strength(rng))}


def _adaptation(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.events.adaptation_h, scene.events.adaptation_floor = p["time_constant_h"], p["floor"]


def _asymmetry(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.scale_series(kernel.RIGHT, p["right_to_left"])


def _ageing(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    left = np.maximum(0.0, 1.0 - p["loss"] * scene.hour_h / 72.0)
    scene.scale_series(kernel.LEFT, left)
    scene.scale_series(kernel.RIGHT, left)


def _draw_diurnal(rng: np.random.Generator) -> Parameters:
    return {"amplitude": min(0.8, 0.4 * strength(rng)), "peak_h": float(rng.uniform(0.0, 24.0))}


def _diurnal(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.scale_series(
        kernel.GROWTH, 1.0 + p["amplitude"] * np.cos(2.0 * math.pi * (scene.hour_h - p["peak_h"]) / 24.0)
    )


def _temperature(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.scale_series(kernel.GROWTH, np.exp(p["per_degree"] * (scene.temperature_c[:-1] - 22.0)))


def _growth(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.scale_series(kernel.GROWTH, p["factor"])


def _draught(scene: Scene, p: Mapping[str, float], _: np.random.Generator) -> None:
    scene.series[:, kernel.DRIVE_X] += p["drive_per_cm_h"]


CATALOGUE: dict[str, Effect] = {
    "circumnutation": Effect(_draw_circumnutation, _circumnutation),
    "phototropic_latency": Effect(amount("delay_h", 0.4, 0.1, 1.2, both=False), event("delay_h", "delay_h")),
    "adaptation": Effect(_draw_adaptation, _adaptation),
    "lamp_asymmetry": Effect(ratio("right_to_left", 0.78, 0.4, 2.5), _asymmetry),
    "lamp_ageing": Effect(amount("loss", 0.4, 0.05, 0.9, both=False), _ageing),
    "diurnal_growth": Effect(_draw_diurnal, _diurnal),
    "temperature_growth": Effect(amount("per_degree", 0.069, 0.02, 0.14, both=False), _temperature),
    "growth_rate": Effect(ratio("factor", 0.6, 0.3, 1.8), _growth),
    "stiffening": Effect(ratio("factor", 0.78, 0.5, 1.6), constant("bending_zone_cm")),
    "gravitropism": Effect(ratio("factor", 1.6, 0.4, 2.7), constant("gravity_per_cm_h")),
    "proprioception": Effect(ratio("factor", 1.6, 0.4, 2.7), constant("proprioception_per_h")),
    "phototropic_gain": Effect(ratio("factor", 0.7, 0.4, 1.8), constant("photo_per_cm_h")),
    "sag": Effect(amount("amplitude", 0.7, 0.3, 1.2, both=False), event("sag_per_cm3", "amplitude", SAG_PER_CM3)),
    "draught": Effect(amount("drive_per_cm_h", 0.1, 0.02, 0.2, both=True), _draught),
    "camera_roll": Effect(amount("angle_deg", 3.0, 0.5, 8.0, both=True), record("roll_deg", "angle_deg")),
    "camera_scale": Effect(ratio("factor", 1.07, 0.8, 1.2), record("scale", "factor")),
    "camera_drift": Effect(amount("angle_deg", 3.0, 0.5, 8.0, both=True), record("drift_deg", "angle_deg")),
    "clock_offset": Effect(amount("offset_h", 0.4, 0.1, 1.3, both=True), record("offset_h", "offset_h")),
    "clock_skew": Effect(amount("per_hour", 0.015, 0.003, 0.05, both=True), record("skew_per_h", "per_hour")),
}
"""What a plant, a lamp, a camera or a clock can do. ``time_scale`` and ``memory`` are faults of a simulator itself and
cannot be hidden in measured runs."""

DAMAGE: dict[str, Effect] = {
    "frame_gaps": Effect(amount("share", 0.1, 0.02, 0.3, both=False), record("gap_share", "share")),
    "tip_misdetection": Effect(amount("share", 0.03, 0.005, 0.1, both=False), record("miss_share", "share")),
}
"""Faults of the record alone: drawn by name only, not among the single effects."""

INSEPARABLE: tuple[frozenset[str], ...] = (
    frozenset({"phototropic_latency", "clock_offset"}),
    frozenset({"phototropic_latency", "clock_skew"}),
    frozenset({"clock_offset", "clock_skew"}),
    frozenset({"lamp_asymmetry", "draught"}),
    frozenset({"lamp_asymmetry", "camera_roll"}),
    frozenset({"draught", "camera_roll"}),
    frozenset({"diurnal_growth", "temperature_growth"}),
    frozenset({"phototropic_gain", "proprioception"}),
    frozenset({"phototropic_gain", "adaptation"}),
    frozenset({"proprioception", "adaptation"}),
    frozenset({"camera_scale", "growth_rate"}),
)
"""Pairs that are not drawn together: what one does the other can undo or imitate."""
