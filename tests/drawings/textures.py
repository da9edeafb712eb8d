"""Surfaces of the drawn setups: noise of several scales, cloth, wood, walls. Values are linear reflectance, BGR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.float32]
Rng = np.random.Generator

BOARDS: Final = ("board", "cloth", "grey wall", "light wall", "wood")


@dataclass(frozen=True, slots=True)
class Surface:
    """What hangs behind the plant.

    Attributes:
        reflectance: shape (h, w, 3), linear, BGR.
        slope_x: shape (h, w), the surface's slope towards the right, which the lamps at the sides make visible.
    """

    reflectance: Picture
    slope_x: Picture


def bgr(red: float, green: float, blue: float) -> Picture:
    """A colour named red first, stored blue first."""
    return np.array([blue, green, red], np.float32)


def cloud(rng: Rng, shape: tuple[int, int], cells: tuple[float, float], octaves: int = 4, gain: float = 0.5) -> Picture:
    """Smooth noise with about unit standard deviation; ``cells`` of the coarsest octave in y and in x."""
    height, width = shape
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = (max(2, min(side, round(n * 2**octave) + 2)) for side, n in zip(shape, cells, strict=True))
        grid = rng.standard_normal((rows, columns)).astype(np.float32)
        total += gain**octave * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
    return total / np.float32(max(float(total.std()), 1e-6))


def surface(kind: str, rng: Rng, shape: tuple[int, int], px_per_cm: float) -> Surface:
    """A surface of one of ``BOARDS``."""
    height, width = shape
    flat = np.zeros(shape, np.float32)
    if kind == "cloth":
        return _cloth(rng, shape)
    if kind == "wood":
        return Surface(_wood(rng, shape, px_per_cm), flat)
    if kind == "board":
        level, spread = rng.uniform(0.015, 0.06), rng.uniform(0.03, 0.12)
        tint = 1.0 + rng.uniform(-0.2, 0.2, 3)
    elif kind == "grey wall":
        level, spread = rng.uniform(0.10, 0.24), rng.uniform(0.02, 0.07)
        tint = 1.0 + rng.uniform(-0.12, 0.12, 3)
    else:
        level, spread = rng.uniform(0.40, 0.70), rng.uniform(0.01, 0.05)
        tint = bgr(1.0, 0.95, 0.88) ** rng.uniform(0.0, 3.0)
    rough = cloud(rng, shape, (3, 4), 6, 0.7)
    fine = cloud(rng, shape, (height / 6, width / 6), 2)
    tone = np.exp(spread * rough + 0.4 * spread * fine)
    return Surface((level * tone[..., None] * tint).astype(np.float32), (0.3 * spread * fine).astype(np.float32))


def _cloth(rng: Rng, shape: tuple[int, int]) -> Surface:
    height, width = shape
    lean, many = rng.uniform(-0.5, 0.5), rng.uniform(2.5, 7)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / np.float32(height)
    # folds fall from where the cloth hangs and wander a little; no two are alike
    phase = (x + lean * y) * many + 0.22 * cloud(rng, shape, (0.3, 2.5), 2) + 0.02 * cloud(rng, shape, (2, 6), 2)
    deep = np.clip(0.5 + 0.6 * cloud(rng, shape, (0.8, 5), 2), 0, 1.5)
    folds = deep * (1.0 - np.abs(np.sin(np.pi * phase)) ** 0.6)
    folds += 0.5 * deep * (1.0 - np.abs(np.sin(np.pi * (2.3 * phase + 0.3 * cloud(rng, shape, (0.6, 3), 2)))) ** 0.5)
    folds += 0.06 * cloud(rng, shape, (6, 18), 3)
    folds = cv2.GaussianBlur(folds.astype(np.float32), None, height / 300)
    slope = cv2.Sobel(folds, cv2.CV_32F, 1, 0, ksize=3) * np.float32(height / 90)
    level = rng.uniform(0.012, 0.04)
    tint = 1.0 + rng.uniform(-0.3, 0.3, 3)
    weave = 1.0 + 0.06 * cloud(rng, shape, (height / 3, width / 3), 1)
    tone = level * weave * np.exp(0.35 * folds)
    return Surface((tone[..., None] * tint).astype(np.float32), np.clip(slope, -0.9, 0.9))


def _wood(rng: Rng, shape: tuple[int, int], px_per_cm: float) -> Picture:
    upright = bool(rng.integers(2))
    height, width = shape[::-1] if upright else shape
    boards = np.empty((height, width, 3), np.float32)
    tones = (bgr(0.30, 0.19, 0.10), bgr(0.42, 0.31, 0.19), bgr(0.16, 0.09, 0.05), bgr(0.25, 0.22, 0.19))
    tone = tones[int(rng.integers(len(tones)))]
    top = 0
    while top < height:
        rows = min(height - top, max(8, round(rng.uniform(6, 14) * px_per_cm)))
        part = (rows, width)
        bend = cloud(rng, part, (1.5, 3), 2) * 0.35 + cloud(rng, part, (6, 1.2), 1) * 0.15
        rings = np.arange(rows, dtype=np.float32)[:, None] / px_per_cm * rng.uniform(1.0, 2.5) + bend
        grain = 0.16 * np.sin(2 * np.pi * rings) + 0.10 * cloud(rng, part, (rows / 3, width / 90), 2)
        boards[top : top + rows] = np.exp(grain + rng.normal(0, 0.12))[..., None] * tone
        boards[top : top + max(1, round(0.12 * px_per_cm))] *= 0.25
        top += rows
    return np.ascontiguousarray(boards.transpose(1, 0, 2)) if upright else boards


def wandering_line(rng: Rng, start: Sequence[float], end: Sequence[float], swing: float, count: int = 60) -> Picture:
    """A smooth line from start to end that swings to the sides, shape (count, 2)."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    t = np.linspace(0.0, 1.0, count)[:, None]
    across = np.array([b[1] - a[1], a[0] - b[0]])
    across /= max(float(np.hypot(*across)), 1e-9)
    side = sum(rng.normal(0, swing / k) * np.sin(np.pi * k * t) for k in (1, 2, 3))
    return (a + t * (b - a) + side * across).astype(np.float32)
