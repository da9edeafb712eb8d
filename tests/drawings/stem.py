"""Round things that are long and thin, drawn from their middle line with exact edges: stems and petioles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from drawings.textures import Picture
from flora_common.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Lit:
    """One light that falls on the plant.

    Attributes:
        towards: unit vector from plant to light: x right, y up, z to the camera.
        colour: shape (3,), BGR, linear.
        field: shape (h, w), its strength over the picture, at ``coarse`` of the picture's size.
        coarse: field pixels per picture pixel.
    """

    towards: FloatArray
    colour: Picture
    field: Picture
    coarse: float

    def strength(self, x_px: FloatArray, y_px: FloatArray) -> Picture:
        """Strength at places in the picture."""
        rows = np.clip((y_px * self.coarse).astype(np.int64), 0, self.field.shape[0] - 1)
        columns = np.clip((x_px * self.coarse).astype(np.int64), 0, self.field.shape[1] - 1)
        return self.field[rows, columns]

    def brighter(self, factor: float) -> Lit:
        """The same light, stronger by a factor."""
        return replace(self, colour=self.colour * np.float32(factor))


@dataclass(frozen=True, slots=True)
class ToPx:
    """Centimetres beside the anchor to pixels of the picture."""

    anchor_px: tuple[float, float]
    px_per_cm: float

    def __call__(self, points_cm: FloatArray) -> FloatArray:
        return np.asarray(points_cm) * (self.px_per_cm, -self.px_per_cm) + self.anchor_px


@dataclass(slots=True)
class Canvas:
    """A cut-out of the picture that the plant is drawn on: colour times cover, and cover; linear, BGR."""

    left: int
    top: int
    colour: Picture
    cover: Picture

    @classmethod
    def empty(cls, left: int, top: int, right: int, bottom: int) -> Canvas:
        shape = (max(bottom - top, 1), max(right - left, 1))
        return cls(left, top, np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32))


@dataclass(frozen=True, slots=True)
class Strip:
    """The pixels of a strip: rows and columns on the canvas, cover, place across (-1 left edge of the direction of
    travel, 1 right edge) and along (index into the line)."""

    rows: FloatArray
    columns: FloatArray
    cover: Picture
    across: Picture
    along: Picture


def draw_strip(
    canvas: Canvas,
    line_px: FloatArray,
    half_px: FloatArray,
    reflectance: Picture,
    lights: list[Lit],
    gloss: float = 0.05,
) -> None:
    """Draw a round strip.

    Args:
        canvas: drawn upon.
        line_px: shape (n, 2), the middle line in picture coordinates (pixel centres are whole numbers).
        half_px: shape (n,), half the width; the strip ends where the line ends.
        reflectance: shape (n, 3), BGR, along the line.
        lights: what falls on it.
        gloss: strength of the bright streak where it mirrors a light.
    """
    dense_px, half, colour = _dense(line_px, half_px, reflectance)
    for first, last, keep in _pieces(dense_px):
        strip = _strip_pixels(canvas, dense_px[first:last], half[first:last], keep)
        if strip is None:
            continue
        direction = np.gradient(dense_px[first:last], axis=0)
        direction /= np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-9)[:, None]
        index = np.clip(np.rint(strip.along).astype(np.int64), 0, last - first - 1)
        # right of the direction of travel: in the picture y points down, on the plant up
        side_x, side_y = -direction[index, 1] * strip.across, -direction[index, 0] * strip.across
        facing = np.sqrt(np.maximum(1.0 - strip.across**2, 0.0))
        x_px, y_px = strip.columns + canvas.left, strip.rows + canvas.top
        shade = np.zeros((strip.cover.size, 3), np.float32)
        shine = np.zeros((strip.cover.size, 3), np.float32)
        for light in lights:
            strength = light.strength(x_px, y_px)[:, None] * light.colour
            lean = side_x * light.towards[0] + side_y * light.towards[1] + facing * light.towards[2]
            shade += strength * (0.18 + 0.82 * np.clip(lean * 0.85 + 0.15, 0.0, None))[:, None]
            half_way = light.towards + np.array([0.0, 0.0, 1.0])
            half_way /= np.linalg.norm(half_way)
            mirror = side_x * half_way[0] + side_y * half_way[1] + facing * half_way[2]
            shine += strength * (np.clip(mirror, 0.0, 1.0) ** 30)[:, None]
        lit = colour[first:last][index] * shade + np.float32(gloss) * shine
        rows, columns = strip.rows.astype(np.int64), strip.columns.astype(np.int64)
        left = (1.0 - strip.cover)[:, None]
        canvas.colour[rows, columns] = canvas.colour[rows, columns] * left + lit * strip.cover[:, None]
        canvas.cover[rows, columns] = canvas.cover[rows, columns] * left[:, 0] + strip.cover


def _dense(line: FloatArray, half: FloatArray, colour: Picture) -> tuple[FloatArray, FloatArray, Picture]:
    """The line in steps of about two pixels, which keeps both ends."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    count = max(4, math.ceil(along[-1] / 2.0) + 1)
    at = np.linspace(0.0, along[-1], count)
    # the tip is round within its last half width: closer steps there
    at = np.unique(np.concatenate([at, np.linspace(max(0.0, along[-1] - 6.0), along[-1], 13)]))
    points = np.column_stack([np.interp(at, along, line[:, k]) for k in range(2)])
    tones = np.column_stack([np.interp(at, along, colour[:, k]) for k in range(3)])
    return points, np.interp(at, along, half), tones.astype(np.float32)


def _pieces(line: FloatArray) -> Iterator[tuple[int, int, tuple[float, float]]]:
    """Parts that do not fold back on themselves, so that the later lies over the earlier with clean edges.

    Yields:
        First and last point of a part, the last not included, and the share of it, in points from its first, that is
        its own: neighbours overlap by a little, so that each pixel at the joint belongs to exactly one of them.
    """
    heading = np.unwrap(np.arctan2(*np.diff(line, axis=0).T[::-1]))
    overlap, joints = 3, [0]
    for i in range(1, heading.size - 2 * overlap):
        if abs(heading[i] - heading[joints[-1]]) > 1.8 and i - joints[-1] > 2 * overlap:
            joints.append(i)
    for start, end in zip(joints, [*joints[1:], len(line)], strict=True):
        first, last = max(0, start - overlap), min(len(line), end + overlap + 1)
        own = -1.0 if start == 0 else float(start - first), np.inf if end == len(line) else float(end - first)
        yield first, last, own


def _strip_pixels(canvas: Canvas, line: FloatArray, half: FloatArray, own: tuple[float, float]) -> Strip | None:
    """Pixels of the canvas that the strip touches; each takes the nearest place on the line."""
    label = np.full(canvas.cover.shape, -1.0, np.float32)
    at = line - (canvas.left, canvas.top)
    corners = np.rint(at * 16).astype(np.int64).tolist()
    for i in range(len(corners) - 1):
        thick = math.ceil(2 * max(half[i], half[i + 1])) + 3
        cv2.line(label, corners[i], corners[i + 1], float(i), thick, cv2.LINE_8, 4)
    box_low = np.maximum(np.floor(at.min(axis=0) - half.max() - 4).astype(np.int64), 0)
    box_high = np.ceil(at.max(axis=0) + half.max() + 5).astype(np.int64)
    part = label[box_low[1] : max(box_high[1], 0), box_low[0] : max(box_high[0], 0)]
    rows, columns = np.nonzero(part >= 0)
    if rows.size == 0:
        return None
    guess = part[rows, columns].astype(np.int64)
    x, y = (columns + box_low[0]).astype(np.float64), (rows + box_low[1]).astype(np.float64)
    start, step = at[:-1], np.diff(at, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-12)
    reach = math.ceil((half.max() + 2.5) / 2.0) + 3
    best = np.full(rows.size, np.inf)
    along, side = np.zeros(rows.size), np.zeros(rows.size)
    for k in range(-reach - (12 if len(line) > 14 else 0), reach + 1):
        i = np.clip(guess + k, 0, len(start) - 1)
        dx, dy = x - start[i, 0], y - start[i, 1]
        t = np.clip((dx * step[i, 0] + dy * step[i, 1]) / length2[i], 0.0, 1.0)
        far = (dx - t * step[i, 0]) ** 2 + (dy - t * step[i, 1]) ** 2
        better = far < best
        best[better] = far[better]
        along[better] = (i + t)[better]
        side[better] = np.sign(step[i, 0] * dy - step[i, 1] * dx)[better]
    distance = np.sqrt(best)
    width = np.interp(along, np.arange(len(half)), half)
    cover = np.clip(width + 0.5 - distance, 0.0, np.minimum(1.0, 2 * width))
    # nothing beyond the two ends
    first_over = ((x - at[0, 0]) * step[0, 0] + (y - at[0, 1]) * step[0, 1]) / math.sqrt(length2[0])
    last_over = ((x - at[-1, 0]) * step[-1, 0] + (y - at[-1, 1]) * step[-1, 1]) / math.sqrt(length2[-1])
    cover = cover * np.where(along < 1.0, np.clip(first_over + 0.5, 0, 1), 1.0)
    cover = cover * np.where(along > len(at) - 4.0, np.clip(0.5 - last_over, 0, 1), 1.0)
    keep = (cover > 0.004) & (along >= own[0]) & (along < own[1])
    across = np.clip(side * distance / np.maximum(width, 0.3), -1.0, 1.0)
    return Strip(
        y[keep],
        x[keep],
        cover[keep].astype(np.float32),
        across[keep].astype(np.float32),
        along[keep].astype(np.float32),
    )
