"""Gusts: no wind is steady, and a stem that it bends elastically follows it within minutes.

A draught in its elastic form (``WIND`` of :mod:`flora_lab.simulator.terms`) explains the mean push. That it blows
harder and weaker by turns is left over then, and would be told as something without a name, or as a swing of the tip.
A gust moves each place of the stem by its share of how far the mean wind holds that place aside: Gaussian processes of
known shapes in time, of a size that comes with the draught.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.joint import Found
from flora_lab.diagnose.rhythm import Spectrum
from flora_lab.diagnose.scene import WINDOW_H, Lanes, Scene
from flora_lab.simulator.terms import SOFTNESS_CM, WIND

GUSTS: Final = ((0.2, 0.15), (1.0, 0.15), (5.0, 0.1))
"""Correlation times, h, and the share of the mean wind that comes and goes with each."""


def covariance(scene: Scene, found: Found, run: int) -> Array:
    """What gusts do to the hourly means of a run, shape (m, m); nothing where no wind blows.

    Args:
        scene: the run.
        found: its explanation.
        run: which of those explained it is.
    """
    away = _held_aside_cm(scene, found, run, None)
    if away is None:
        return np.zeros((scene.size, scene.size))
    moved = scene.of_points(away[:, None])[0]
    at_h = scene.time_h[scene.window]
    lag_h = np.abs(at_h[:, None] - at_h[None, :])
    alike = np.sum([share**2 * _of_means(lag_h, memory_h) for memory_h, share in GUSTS], axis=0)
    return np.asarray(moved[:, None] * moved[None, :] * alike)


def power(scene: Scene, found: Found, run: int, seen: Spectrum) -> Array:
    """What gusts add to the spectrum of a tip, cm^2 h, at the frequencies of ``seen``, shape (n,)."""
    away = _held_aside_cm(scene, found, run, 1)
    if away is None:
        return np.zeros(len(seen.per_hour))
    turning = 2.0 * np.pi * seen.per_hour
    of_one = [share**2 * 2.0 * memory_h / (1.0 + (turning * memory_h) ** 2) for memory_h, share in GUSTS]
    return np.asarray(np.mean(away[:, -1, 0] ** 2) * np.sum(of_one, axis=0))


def _of_means(lag_h: Array, memory_h: float) -> Array:
    """How alike the means over :data:`WINDOW_H` of what forgets in ``memory_h`` are, of unit variance itself."""
    whole = WINDOW_H / memory_h
    apart = np.exp(-lag_h / memory_h) * 2.0 * (np.cosh(whole) - 1.0) / whole**2
    same = 2.0 * (whole - 1.0 + np.exp(-whole)) / whole**2
    return np.asarray(np.where(lag_h < 0.5 * WINDOW_H, same, apart))


def _held_aside_cm(scene: Scene, found: Found, run: int, every: int | None) -> Array | None:
    """How far the wind holds each point of the stem aside, cm, shape (rows told, 10, 2); None where none blows."""
    change = found.hypothesis.change(found.coordinates)
    terms = scene.terms_with(change)
    if terms[WIND] == 0.0:
        return None
    lanes = Lanes(found.traits[run][None] + change.traits, found.start[run][None], [change])
    return held_aside_cm(scene.points(lanes, every=every)[:, 0], float(terms[WIND]), float(terms[SOFTNESS_CM]))


def held_aside_cm(stems_cm: Array, wind: float, softness_cm: float) -> Array:
    """How far a wind holds each point of some stems aside, cm, of the shape of ``stems_cm``.

    By the moments of :mod:`flora_lab.simulator.sag`, about the stem as it stands in the wind.

    Args:
        stems_cm: from foot to tip, shape (stems, points, 2).
        wind, softness_cm: ``WIND`` and ``SOFTNESS_CM`` of :mod:`flora_lab.simulator.terms`.
    """
    pieces = np.linalg.norm(np.diff(stems_cm, axis=1), axis=2)
    middles = 0.5 * (stems_cm[:, 1:] + stems_cm[:, :-1])
    piece, point = np.arange(pieces.shape[1]), np.arange(stems_cm.shape[1])
    higher_cm = middles[:, None, :, 1] - middles[:, :, None, 1]
    moment = np.sum(higher_cm * pieces[:, None, :] * (piece[None, :] > piece[:, None]), axis=2)
    to_tip_cm = np.cumsum(pieces[:, ::-1], axis=1)[:, ::-1] - 0.5 * pieces
    bend = wind * np.exp(-to_tip_cm / softness_cm) * pieces * moment
    arm_cm = (stems_cm[:, None] - middles[:, :, None]) * (point[None, :] > piece[:, None])[None, :, :, None]
    turned = np.stack([arm_cm[..., 1], -arm_cm[..., 0]], axis=-1)
    return np.asarray(np.sum(bend[:, :, None, None] * turned, axis=1))
