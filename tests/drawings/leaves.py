"""Leaf blades of many shapes, as polygons with two lit halves, veins and a sheen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from drawings.stem import Canvas, Lit
from drawings.textures import Picture, Rng
from flora_common.arrays import FloatArray

SHAPES: Final = ("ellipse", "ovate", "lobed", "arrow", "lens", "strap", "seed leaf")


@dataclass(frozen=True, slots=True)
class Blade:
    """What does not change in a leaf's life.

    Attributes:
        shape: one of ``SHAPES``.
        upper, lower: outlines of the two halves in units of the length, shape (m, 2): along the midrib, off it.
        reflectance: shape (3,), BGR.
        tilt: of the two halves towards right and up, shape (2, 2): which light they take.
        bend_rad: of the midrib from foot to point, downward positive.
        veins: pairs of side veins.
        vein_tone: brightness of the veins relative to the blade.
        gloss: strength of the sheen.
    """

    shape: str
    upper: FloatArray
    lower: FloatArray
    reflectance: Picture
    tilt: FloatArray
    bend_rad: float
    veins: int
    vein_tone: float
    gloss: float


def grow_blade(shape: str, rng: Rng, reflectance: Picture) -> Blade:
    """A blade of this shape."""
    upper = _half_outline(shape, rng)
    lower = upper * [1.0, -rng.uniform(0.8, 1.2)]
    # back along the midrib, which bends
    rib = np.column_stack([np.linspace(0.95, 0.05, 12), np.zeros(12)])
    upper, lower = np.vstack([upper, rib]), np.vstack([lower, rib])
    return Blade(
        shape=shape,
        upper=upper,
        lower=lower,
        reflectance=(reflectance * np.exp(rng.normal(0, 0.12) + rng.normal(0, 0.05, 3))).astype(np.float32),
        tilt=rng.normal(0, 0.45, (2, 2)),
        bend_rad=float(rng.uniform(-0.2, 1.2)) if shape != "seed leaf" else float(rng.uniform(-0.2, 0.5)),
        veins=0 if shape in ("lens", "seed leaf") else int(rng.integers(3, 7)),
        vein_tone=float(rng.choice([0.75, 1.35])),
        gloss=float(rng.uniform(0.0, 0.15)),
    )


def _half_outline(shape: str, rng: Rng) -> FloatArray:
    x = np.linspace(0.0, 1.0, 48)
    if shape == "arrow":
        wide = rng.uniform(0.22, 0.40)
        back = rng.uniform(0.10, 0.28)
        corners = np.array(
            [(0, 0), (-back, 0.5 * wide), (-1.1 * back, wide), (0.15, 0.8 * wide), (0.55, 0.45 * wide), (1, 0)]
        )
        smooth = np.interp(np.linspace(0, 5, 120), np.arange(6), corners[:, 0])
        across = np.interp(np.linspace(0, 5, 120), np.arange(6), corners[:, 1])
        kernel = np.hanning(23) / np.hanning(23).sum()
        padded = [np.pad(v, 11, mode="edge") for v in (smooth, across)]
        outline = np.column_stack([np.convolve(v, kernel, mode="valid") for v in padded])
        outline[0], outline[-1] = (0, 0), (1, 0)
        return outline
    if shape == "ellipse":
        y = rng.uniform(0.18, 0.42) * np.sqrt(np.maximum(1 - (2 * x - 1) ** 2, 0))
    elif shape == "ovate":
        y = rng.uniform(0.22, 0.42) * np.sin(np.pi * x ** rng.uniform(0.55, 0.8))
    elif shape == "lobed":
        lobes = 1 + rng.uniform(0.25, 0.45) * np.cos(2 * np.pi * x * rng.integers(2, 5) + rng.uniform(2, 4))
        y = rng.uniform(0.25, 0.38) * np.sin(np.pi * x**0.8) ** 0.8 * lobes
    elif shape == "lens":
        y = rng.uniform(0.04, 0.09) * np.sin(np.pi * x) ** 1.3
    elif shape == "strap":
        y = rng.uniform(0.07, 0.14) * np.minimum(1, np.minimum(x * 5, (1 - x) * 3)) ** 0.7
    else:
        y = rng.uniform(0.20, 0.32) * np.maximum(1 - (2 * x - 1) ** 2, 0) ** 0.4
    return np.column_stack([x, y])


def place(
    points: FloatArray, blade: Blade, foot_cm: FloatArray, angle_rad: float, length_cm: float, flat: float
) -> FloatArray:
    """Points of the blade's own plane in cm beside the anchor.

    Args:
        points: shape (m, 2), units of the length: along the midrib, off it.
        blade: whose midrib bends.
        foot_cm: where the blade sits on its petiole.
        angle_rad: direction of the midrib at the foot, from the vertical to the right.
        length_cm: of the midrib.
        flat: 1 seen from its face, 0 edge-on.
    """
    x = points[:, 0]
    # downward: away from the vertical
    sense = 1.0 if math.sin(angle_rad) >= 0 else -1.0
    t = np.linspace(-0.35, 1.05, 60)
    heading = angle_rad + sense * blade.bend_rad * np.clip(t, 0.0, None)
    steps = np.column_stack([np.sin(heading), np.cos(heading)]) * (t[1] - t[0])
    rib = np.cumsum(steps, axis=0)
    rib -= [np.interp(0.0, t, rib[:, k]) for k in range(2)]
    along = np.column_stack([np.interp(x, t, rib[:, k]) for k in range(2)])
    turn = np.interp(x, t, heading)
    off = np.column_stack([np.cos(turn), -np.sin(turn)]) * (points[:, 1] * flat)[:, None]
    return foot_cm + (along + off) * length_cm


def draw_blade(
    canvas: Canvas,
    upper_px: FloatArray,
    lower_px: FloatArray,
    blade: Blade,
    lights: list[Lit],
    vein_px: list[FloatArray],
) -> None:
    """Draw a blade from the outlines of its halves (m, 2) and its veins (2, 2) in picture coordinates."""
    both = np.vstack([upper_px, lower_px])
    low = np.maximum(np.floor(both.min(axis=0)).astype(int) - 2, (canvas.left, canvas.top))
    high = np.minimum(
        np.ceil(both.max(axis=0)).astype(int) + 3,
        (canvas.left + canvas.cover.shape[1], canvas.top + canvas.cover.shape[0]),
    )
    width, height = (int(v) for v in high - low)
    if width < 2 or height < 2:
        return
    scale = 4 if width * height < 10_000 else 2
    middle = both.mean(axis=0)
    tones = [blade.reflectance * _lit(blade.tilt[k], lights, middle) for k in range(2)]
    sheen = sum(
        (light.colour * light.strength(*middle[:, None]) for light in lights), np.zeros(3, np.float32)
    ) * np.float32(blade.gloss)
    size = (height * scale, width * scale)
    ink = np.zeros(size, np.float32)
    cover = np.zeros(size, np.uint8)

    def corners(points: FloatArray) -> FloatArray:
        return np.rint(((points - low + 0.5) * scale - 0.5) * 16).astype(np.int32)

    cv2.fillPoly(cover, [corners(lower_px)], 1, cv2.LINE_8, 4)
    cv2.fillPoly(cover, [corners(upper_px)], 2, cv2.LINE_8, 4)
    ink[:] = 1.0
    for vein in vein_px:
        cv2.line(ink, *corners(vein).tolist(), blade.vein_tone, max(1, scale // 2), cv2.LINE_8, 4)
    halves = [
        cv2.resize((cover == k).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) for k in (2, 1)
    ]
    ink = cv2.resize(ink, (width, height), interpolation=cv2.INTER_AREA)
    spot = np.zeros((height, width), np.float32)
    if blade.gloss > 0.02:
        at = upper_px[len(upper_px) // 3] * 0.6 + middle * 0.4 - low
        reach = max(1.0, 0.10 * float(np.hypot(*(both.max(axis=0) - both.min(axis=0)))))
        y, x = np.ogrid[0:height, 0:width]
        spot = np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * reach**2)).astype(np.float32)
    alpha = halves[0] + halves[1]
    colour = (halves[0][..., None] * tones[0] + halves[1][..., None] * tones[1]) * ink[..., None]
    colour += (alpha * spot)[..., None] * sheen
    rows = slice(int(low[1]) - canvas.top, int(high[1]) - canvas.top)
    columns = slice(int(low[0]) - canvas.left, int(high[0]) - canvas.left)
    left = 1.0 - alpha
    canvas.colour[rows, columns] = canvas.colour[rows, columns] * left[..., None] + colour
    canvas.cover[rows, columns] = canvas.cover[rows, columns] * left + alpha


def _lit(tilt: FloatArray, lights: list[Lit], middle_px: FloatArray) -> Picture:
    """Light that a half takes up, shape (3,); what shines from behind comes through in part."""
    normal = np.array([tilt[0], tilt[1] + 0.3, 1.0])
    normal /= np.linalg.norm(normal)
    total = np.zeros(3, np.float32)
    for light in lights:
        lean = float(normal @ light.towards)
        share = 0.15 + (0.85 * lean if lean > 0 else -0.35 * lean)
        total += light.colour * light.strength(*middle_px[:, None]) * np.float32(share)
    return total


def vein_lines(blade: Blade) -> list[FloatArray]:
    """The midrib and the side veins in the blade's own plane, each (2, 2)."""
    lines = (
        [np.array([(a, 0.0), (a + 0.25, 0.0)]) for a in (0.0, 0.25, 0.5, 0.72)] if blade.shape != "seed leaf" else []
    )
    for k in range(blade.veins):
        start = 0.08 + 0.75 * k / blade.veins
        for half in (blade.upper, blade.lower):
            reach = start + 0.22
            near = np.abs(half[:, 0] - reach) < 0.05
            edge = float(half[near, 1][np.argmax(np.abs(half[near, 1]))])
            lines.append(np.array([(start, 0.0), (reach, 0.8 * edge)]))
    return lines
