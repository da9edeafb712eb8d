"""The black cloth on the back wall: folds, creases, wrinkles, dust and lint."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Float32Array
from flora_twin.render.decor import Decor

_DRAPES: Final = 13
_CREASES: Final = 26
_SPECKS: Final = 150
_LINT: Final = 26
_COARSE: Final = 2
"""The relief is made at this fraction of the picture's size."""


def relief(x_cm: Float32Array, y_cm: Float32Array, decor: Decor, rng: np.random.Generator) -> Float32Array:
    """Slopes of the hanging cloth, shape (height, width, 2): rise towards the camera per cm in x and in y.

    Args:
        x_cm: of the columns on the wall, shape (width,).
        y_cm: of the rows, shape (height,), falling.
        decor: of the box.
        rng: draws folds and creases.
    """
    shape = (len(y_cm), len(x_cm))
    x, y = x_cm[::_COARSE][None, :], y_cm[::_COARSE][:, None]
    small = (y.shape[0], x.shape[1])
    height = np.zeros(small, np.float32)
    for _ in range(_DRAPES):
        middle, slant = rng.uniform(-52.0, 52.0), 0.16 * rng.standard_normal()
        bend, phase = 1.2 * rng.standard_normal(), rng.uniform(0.0, 6.28)
        width = np.exp(rng.uniform(np.log(0.8), np.log(6.0)))
        tall = decor.fold_cm * 0.19 * width * rng.standard_normal()
        path = middle + slant * (y - 20.0) + bend * np.sin(y / 14.0 + phase)
        grows = 0.6 + 0.4 * np.sin(y / 19.0 + 2.0 * phase)
        across = (x - path) / width
        height += (tall * grows * np.exp(-across * across)).astype(np.float32)
    for size_cm, tall in ((13.0, 0.40), (6.5, 0.30), (3.2, 0.13), (0.9, 0.009)):
        # Drawn tall and narrow: cloth hangs.
        narrow = _cloud(rng, (small[0] // 3, small[1]), size_cm / abs(float(x[0, 1] - x[0, 0])))
        height += float(tall * decor.fold_cm) * np.asarray(cv2.resize(narrow, (small[1], small[0])), np.float32)
    for _ in range(_CREASES):
        _add_crease(height, x, y, decor.crease, rng)
    step = np.float32(abs(float(x[0, 1] - x[0, 0])))
    slope_y, slope_x = np.gradient(height, step)
    slopes = np.stack([slope_x, -slope_y], axis=-1)  # rows go down, y goes up
    full = cv2.resize(slopes, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(full, -1.2, 1.2), dtype=np.float32)


def weave(shape: tuple[int, int], rng: np.random.Generator) -> Float32Array:
    """Relative reflectance (height, width): wear, weave and the pattern that sensors see in both."""
    fine = cv2.GaussianBlur(rng.standard_normal(shape, dtype=np.float32), (0, 0), 1.1) * 2.6
    coarse = cv2.GaussianBlur(rng.standard_normal((shape[0] // 2, shape[1] // 2), dtype=np.float32), (0, 0), 1.6) * 4.0
    medium = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    wear = _cloud(rng, shape, 110.0) + 0.6 * _cloud(rng, shape, 30.0)
    return np.asarray(np.clip(1.0 + 0.05 * wear + 0.06 * fine + 0.085 * medium, 0.3, 2.0), dtype=np.float32)


def dust(shape: tuple[int, int], decor: Decor, rng: np.random.Generator) -> Float32Array:
    """What specks and lint add to the reflectance, shape (height, width)."""
    out = np.zeros(shape, np.float32)
    height, width = shape
    for _ in range(int(_SPECKS * decor.dust)):
        at = (int(rng.integers(0, width * 16)), int(rng.integers(0, height * 16)))
        bright = float(0.02 * np.exp(1.1 * rng.standard_normal()))
        cv2.circle(out, at, int(16 * rng.uniform(0.6, 1.6)), min(bright, 0.3), -1, cv2.LINE_8, 4)
    for _ in range(int(_LINT * decor.dust)):
        start = rng.uniform((0.0, 0.0), (width, height))
        turn, length = rng.uniform(0.0, 6.28), rng.uniform(8.0, 34.0)
        t = np.linspace(0.0, 1.0, 8)
        angle = turn + 1.6 * rng.standard_normal() * t
        path = start + np.cumsum(np.stack([np.cos(angle), np.sin(angle)], axis=1) * length / 8.0, axis=0)
        bright = float(0.012 * np.exp(0.6 * rng.standard_normal()))
        cv2.polylines(out, [np.rint(path * 16).astype(np.int32)], False, bright, 1, cv2.LINE_8, 4)
    return cv2.GaussianBlur(out, (0, 0), 0.6).astype(np.float32)


def crumpled(shape: tuple[int, int], rng: np.random.Generator) -> Float32Array:
    """Slopes (height, width, 2) of cloth pushed together, as in the pot; sizes in pixels."""
    wide = (shape[0] * 2, shape[1])  # folds lie along the rim
    tall: Float32Array = (
        5.5 * _cloud(rng, wide, 60.0)
        - 3.4 * np.abs(_cloud(rng, wide, 34.0))
        - 1.5 * np.abs(_cloud(rng, wide, 17.0))
        + 0.35 * _cloud(rng, wide, 11.0)
    )
    narrow = cv2.resize(tall, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    down, right = np.gradient(cv2.GaussianBlur(narrow, (0, 0), 1.0))
    return np.asarray(np.clip(np.stack([right, -down], axis=-1), -1.5, 1.5), dtype=np.float32)


def _add_crease(
    height: Float32Array, x: Float32Array, y: Float32Array, strength: float, rng: np.random.Generator
) -> None:
    """A straight ridge of some length, most of them steep, as cloth keeps from being folded or pulled."""
    cx, cy = rng.uniform(-48.0, 48.0), rng.uniform(-10.0, 52.0)
    lean = float(np.pi / 2 + 0.45 * rng.standard_normal() if rng.random() < 0.8 else rng.uniform(0.0, np.pi))
    half, width = rng.uniform(3.0, 20.0), float(np.exp(rng.uniform(np.log(0.16), np.log(0.9))))
    sway_cm = rng.uniform(3.0, 9.0)
    tall = float(0.10 * strength * np.exp(0.75 * rng.standard_normal()) * width / 0.3)
    cosine, sine, margin = float(np.cos(lean)), float(np.sin(lean)), 3.0 * width + 0.3
    reach_x, reach_y = 1.4 * half * abs(cosine) + margin, 1.4 * half * abs(sine) + margin
    columns, rows = np.nonzero(np.abs(x[0] - cx) < reach_x)[0], np.nonzero(np.abs(y[:, 0] - cy) < reach_y)[0]
    if not len(columns) or not len(rows):
        return
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    dx, dy = x[:, part[1]] - cx, y[part[0]] - cy
    along = dx * cosine + dy * sine
    across = dy * cosine - dx * sine + 0.3 * np.sin(along / sway_cm)
    fades = np.exp(-((along / half) ** 4))
    height[part] += (tall * fades * np.exp(-((across / width) ** 2))).astype(np.float32)


def _cloud(rng: np.random.Generator, shape: tuple[int, int], size_px: float) -> Float32Array:
    """Smooth noise of unit variance with features of about ``size_px``."""
    small = rng.standard_normal((int(shape[0] / size_px) + 4, int(shape[1] / size_px) + 4)).astype(np.float32)
    large = cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(large / large.std(), dtype=np.float32)
