"""From the grown stem to the rows of a track: camera, clock, tracking errors, gaps.

Errors of a coordinate are white from row to row, plus a slow wobble that leans and bends the stem as a whole. In form 1
the white part has heavy tails and is shared by neighbouring points, and the wobble has fast and slow parts.
"""

from __future__ import annotations

import math

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.shapes import STEM_POINTS
from flora_common.tracks import Track

from .individuals import Spread, drift
from .kernel import by_height
from .scene import HOUR_S, LIGHT_CODES, ROW_S, STEPS_PER_ROW, Scene

CAMERA_HEIGHT_CM = 20.0
LONGEST_MISS_CM = 2.5


def recorded(scene: Scene, spread: Spread | None = None, rng: np.random.Generator | None = None) -> Track:
    """Grow a scene and record it; without errors of tracking where ``rng`` is missing."""
    lines, used, lit = scene.grow()
    points = by_height(_seen(scene, lines), used, STEM_POINTS)
    rows = len(points)
    if spread is not None and rng is not None:
        _add_errors(points, spread, rng)
    keep = np.ones(rows, dtype=bool)
    if rng is not None:
        _miss_tips(points, scene.record.miss_share, rng)
        keep = _without_gaps(rows, scene.record.gap_share, rng)
    temperature = scene.temperature_c[::STEPS_PER_ROW]
    if rng is not None:
        temperature = temperature + rng.normal(0.0, 0.1, rows)
    time_s = np.arange(rows) * ROW_S
    lights = scene.recorded_codes(lit)
    return Track(
        time_s[keep],
        tuple(LIGHT_CODES[int(code)] for code in lights[keep]),
        points[keep],
        {"temperature_c": np.round(temperature[keep], 2)},
    )


def _seen(scene: Scene, lines: FloatArray) -> FloatArray:
    """The stem in the picture plane, shape (rows, most, 2): perspective, then roll and scale about the anchor."""
    x, y, z = lines[..., 0], lines[..., 1], lines[..., 2]
    if scene.camera_cm > 0.0:
        nearer = scene.camera_cm / (scene.camera_cm - z)
        x, y = x * nearer, CAMERA_HEIGHT_CM + (y - CAMERA_HEIGHT_CM) * nearer
    record = scene.record
    share = np.arange(len(lines)) * ROW_S / HOUR_S / 72.0
    angle = np.radians(record.roll_deg + record.drift_deg * share)[:, None]
    cos, sin = record.scale * np.cos(angle), record.scale * np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _add_errors(points: FloatArray, spread: Spread, rng: np.random.Generator) -> None:
    rows = len(points)
    shape = (rows, STEM_POINTS - 1, 2)
    if spread.heavy:
        own = rng.standard_t(4.0, shape) / math.sqrt(2.0)
        white = own.copy()
        white[:, 1:] += 0.7 * own[:, :-1]
        white /= np.sqrt(np.mean(white**2))
    else:
        white = rng.standard_normal(shape)
    points[:, 1:] += spread.white_cm * white
    height = np.linspace(0.0, 1.0, STEM_POINTS)[1:]
    steps = rows * STEPS_PER_ROW
    for shape_of in (height, 2.0 * height * (1.0 - height) / 0.5):
        for axis in range(2):
            path = drift(rng, steps, spread.wobble_h)[::STEPS_PER_ROW]
            if spread.heavy:
                path = 0.6 * path + 0.6 * drift(rng, steps, 0.3)[::STEPS_PER_ROW]
                path += 0.5 * drift(rng, steps, 12.0)[::STEPS_PER_ROW]
            points[:, 1:, axis] += spread.wobble_cm * path[:, None] * shape_of


def _miss_tips(points: FloatArray, share: float, rng: np.random.Generator) -> None:
    """A leaf taken for the tip: some rows have theirs one or two centimetres off."""
    for row in np.nonzero(rng.random(len(points)) < share)[0]:
        points[row, -1] += rng.uniform(-LONGEST_MISS_CM, LONGEST_MISS_CM, 2)


def _without_gaps(rows: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """Rows that were photographed, as a mask; the first is there."""
    keep = np.ones(rows, dtype=bool)
    while share > 0.0 and keep.mean() > 1.0 - share:
        start = int(rng.integers(1, rows))
        keep[start : start + int(rng.integers(6, 37))] = False
    return keep
