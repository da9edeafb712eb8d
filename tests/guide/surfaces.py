"""Surfaces in three dimensions, lit by a flash and a lamp, before a board: what a camera makes of them.

x right, y up, z towards the camera, cm; the origin is where the stem leaves the soil. Colours are reflectances in
linear light, shape (..., 3), blue, green, red. Surfaces are quadrangles that are painted from back to front.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import ByteArray
from guide.canvas import SHIFT, Floats, corners, patches

FINER: Final = 2
"""Pictures are painted so much larger: edges are smooth then."""
CELL_CM: Final = 0.3
"""What is nearer to a light hides what is behind it, in cells of this size."""
THICK_CM: Final = 0.45
BACK_LIT: Final = 0.45
"""Share of the light that comes through from the other side."""
LEAST_TOWARDS: Final = 0.15
"""A light that grazes the board is as one that is so far before it."""


@dataclass(frozen=True, slots=True)
class Light:
    """From one direction.

    Attributes:
        towards: unit vector to where it comes from.
        colour: shape (3,).
        blur_px: of its shadows on the board.
    """

    towards: Floats
    colour: Floats
    blur_px: float

    @property
    def on_board(self) -> float:
        """Cosine of its angle to the board's normal."""
        return max(LEAST_TOWARDS, float(self.towards[2]))


@dataclass(frozen=True, slots=True)
class View:
    """A camera that looks along -z.

    Attributes:
        size_px: width, height.
        anchor_px: where the origin is.
        px_per_cm: at z = 0.
        away_cm: of the camera.
        board_cm: of the board behind the plant.
    """

    size_px: tuple[int, int]
    anchor_px: tuple[float, float]
    px_per_cm: float
    away_cm: float
    board_cm: float

    def to_px(self, places: Floats) -> Floats:
        """Where places (..., 3) are seen, (..., 2), (x, y) px."""
        scale = self.px_per_cm * self.away_cm / (self.away_cm - places[..., 2])
        return np.stack(
            [self.anchor_px[0] + places[..., 0] * scale, self.anchor_px[1] - places[..., 1] * scale], axis=-1
        )


@dataclass
class Surfaces:
    """Quadrangles of all surfaces of a plant."""

    _quads: list[Floats] = field(default_factory=list)
    _front: list[Floats] = field(default_factory=list)
    _back: list[Floats] = field(default_factory=list)

    def sheet(self, grid: Floats, front: Floats, back: Floats) -> None:
        """A surface with two sides.

        Args:
            grid: shape (n, m, 3), its points.
            front: shape (n - 1, m - 1, 3), colours where its normal, along n cross along m, points to the camera.
            back: where it points away.
        """
        quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
        self._quads.append(quads.reshape(-1, 4, 3))
        for kept, colours in ((self._front, front), (self._back, back)):
            kept.append(np.broadcast_to(colours, (*quads.shape[:2], 3)).reshape(-1, 3))

    def tube(self, axis: Floats, radius_cm: Floats, colours: Floats, sides: int = 8) -> None:
        """A stem, a stalk or a bud.

        Args:
            axis: shape (n, 3).
            radius_cm: shape (n,).
            colours: shape (n, 3) or (3,).
            sides: all round.
        """
        tangent = np.gradient(axis, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-9
        aside = np.cross(tangent, [0.31, 0.17, 0.93])
        aside /= np.linalg.norm(aside, axis=1, keepdims=True) + 1e-9
        round_ = np.linspace(0.0, 2.0 * np.pi, sides + 1)
        rim = (
            np.cos(round_)[None, :, None] * aside[:, None]
            + np.sin(round_)[None, :, None] * np.cross(tangent, aside)[:, None]
        )
        colours = np.broadcast_to(colours, (len(axis), 3))[:-1, None]
        self.sheet(axis[:, None] + radius_cm[:, None, None] * rim, colours, colours)

    def places(self) -> Floats:
        """All corners, shape (n, 3)."""
        return np.concatenate(self._quads).reshape(-1, 3)

    def photographed(
        self, board: Floats, view: View, lights: tuple[Light, ...], ambient: float
    ) -> tuple[Floats, Floats]:
        """The picture, and the same without a plant, both linear, shape (height, width, 3).

        Args:
            board: reflectance, shape (height, width, 3).
            view: of the camera.
            lights: with their shadows.
            ambient: light from everywhere.
        """
        quads, front, back = (np.concatenate(v).astype(np.float64) for v in (self._quads, self._front, self._back))
        normal = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
        middle = quads.mean(axis=1)
        to_camera = np.array([0.0, 0.0, view.away_cm]) - middle
        away = (normal * to_camera).sum(axis=1) < 0
        normal[away] *= -1.0
        colour = np.where(away[:, None], back, front)
        shine = np.full((len(middle), 3), ambient) * (0.8 + 0.25 * normal[:, 1:2])
        empty = ambient * board.astype(np.float64)
        full = empty.copy()
        for light in lights:
            cosine = normal @ light.towards
            strength = np.where(cosine > 0, cosine, -BACK_LIT * cosine) * np.where(_hidden(middle, light), 0.15, 1.0)
            shine += strength[:, None] * light.colour
            on_board = board * light.colour * light.on_board
            empty += on_board
            full += on_board * (1.0 - 0.85 * _shadow(quads, light, view))[..., None]
        lit = colour * shine
        shape = tuple(v * FINER for v in view.size_px)
        large = cv2.resize(full.astype(np.float32), shape, interpolation=cv2.INTER_LINEAR)
        (seen,) = corners((view.to_px(quads) + 0.5) * FINER - 0.5)
        for k in np.argsort(middle[:, 2] + 1e-3 * normal[:, 2]):
            cv2.fillConvexPoly(large, seen[k], lit[k].tolist(), cv2.LINE_8, SHIFT)
        return cv2.resize(large, view.size_px, interpolation=cv2.INTER_AREA), empty.astype(np.float32)


def _hidden(places: Floats, light: Light) -> ByteArray:
    """Which places another part of the plant keeps from a light, shape (n,)."""
    aside = np.cross(light.towards, [0.1, 0.2, 0.97])
    aside /= np.linalg.norm(aside)
    cells = np.floor(places @ np.stack([aside, np.cross(light.towards, aside)], axis=1) / CELL_CM).astype(int)
    cells -= cells.min(axis=0)
    depth = places @ light.towards
    nearest = np.full(cells.max(axis=0) + 1, -np.inf)
    np.maximum.at(nearest, tuple(cells.T), depth)
    return nearest[tuple(cells.T)] - depth > THICK_CM


def _shadow(quads: Floats, light: Light, view: View) -> Floats:
    """What a light does not reach of the board, shape (height, width), 0..1."""
    far = (quads[..., 2:] + view.board_cm) / light.on_board
    mask = np.zeros(view.size_px[::-1], np.uint8)
    (seen,) = corners(view.to_px(quads - far * light.towards))
    for quad in np.clip(seen, -(1 << 20), 1 << 20):
        cv2.fillConvexPoly(mask, quad, 255, cv2.LINE_8, SHIFT)
    return cv2.GaussianBlur(mask, (0, 0), light.blur_px).astype(np.float32) / 255.0


def texture(rng: np.random.Generator, size_px: tuple[int, int]) -> Floats:
    """A board of any colour, smooth or not, shape (height, width, 3)."""
    shape = size_px[::-1]
    grey = float(np.exp(rng.uniform(np.log(0.03), np.log(0.75))))
    tint = np.exp(rng.normal(size=3) * rng.choice([0.04, 0.2]))
    size = rng.uniform(0, 0.12)
    rough = sum(patches(rng, shape, cell, size * rng.random()) for cell in (4.0, 20.0, 90.0))
    board = grey * tint * np.exp(rough)[..., None]
    if rng.random() < 0.3:  # a pole, a seam or a label
        x, y = int(rng.uniform(0, shape[1])), int(rng.uniform(0, shape[0]))
        wide, high = (
            (int(rng.uniform(2, 40)), shape[0])
            if rng.random() < 0.6
            else (int(rng.uniform(20, 90)), int(rng.uniform(2, 60)))
        )
        board[max(0, y - high) : y + high, x : x + wide] *= np.exp(rng.normal() * 0.7)
    return np.clip(board, 0.01, 0.95).astype(np.float32)
