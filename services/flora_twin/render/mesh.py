"""Stem, petioles and leaves as small faces in space, with colour.

All leaves of a bean stand on petioles: the primary pair, heart-shaped, opposite each other at one node, and further up
the first trifoliate leaf, which unfolds as the plant grows. Sizes follow a logistic course in time; they are estimates
after photographs of Phaseolus vulgaris seedlings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.geometry import FloatArray

STEM_STRIPS: Final = 6
LEAF_ALONG: Final = 18
LEAF_ACROSS: Final = 12
_UP: Final = np.array([0.0, 1.0, 0.0])

STEM_BGR: Final = np.array([0.25, 0.62, 0.47])
STEM_FOOT_BGR: Final = np.array([0.36, 0.55, 0.52])
LEAF_BGR: Final = np.array([0.105, 0.42, 0.205])
YOUNG_LEAF_BGR: Final = np.array([0.16, 0.56, 0.36])


@dataclass(frozen=True, slots=True)
class Mesh:
    """Quadrilateral faces.

    Attributes:
        corners_cm: shape (n, 4, 3).
        normal: shape (n, 3), unit.
        albedo: shape (n, 3), blue, green, red.
        flat: shape (n,), 1 for leaf blades (they let light through), 0 for stems.
    """

    corners_cm: FloatArray
    normal: FloatArray
    albedo: FloatArray
    flat: FloatArray


@dataclass(frozen=True, slots=True)
class Leaf:
    """One blade: where it hangs, where it points, how large and how far unfolded it is."""

    base_cm: FloatArray
    along: FloatArray
    across: FloatArray
    length_cm: float
    fold_rad: float
    droop_rad: float
    albedo: FloatArray


def join(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    return Mesh(
        np.concatenate([m.corners_cm for m in meshes]),
        np.concatenate([m.normal for m in meshes]),
        np.concatenate([m.albedo for m in meshes]),
        np.concatenate([m.flat for m in meshes]),
    )


def tube(line_cm: FloatArray, radius_cm: FloatArray, albedo: FloatArray, eye_cm: FloatArray) -> Mesh:
    """The side of a round tube that the eye sees: strips across its width with the normals of a cylinder.

    Args:
        line_cm: middle line (n, 3).
        radius_cm: shape (n,).
        albedo: shape (n, 3).
        eye_cm: shape (3,).
    """
    tangent = np.gradient(line_cm, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    view = eye_cm - line_cm
    view -= (view * tangent).sum(axis=1, keepdims=True) * tangent
    view /= np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
    side = np.cross(tangent, view)
    edges = np.sin(np.linspace(-np.pi / 2, np.pi / 2, STEM_STRIPS + 1))
    depth = np.sqrt(1.0 - edges**2)
    offset = edges[None, :, None] * side[:, None, :] + depth[None, :, None] * view[:, None, :]
    grid = line_cm[:, None, :] + radius_cm[:, None, None] * offset
    middle = 0.25 * (offset[:-1, :-1] + offset[1:, :-1] + offset[:-1, 1:] + offset[1:, 1:])
    normal = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    colour = np.repeat(0.5 * (albedo[:-1] + albedo[1:])[:, None, :], STEM_STRIPS, axis=1)
    return _faces(grid, normal, colour, 0.0)


def blade(leaf: Leaf) -> Mesh:
    """A heart-shaped blade, folded along its midrib by ``fold_rad`` and bent downwards along it by ``droop_rad``."""
    u = np.linspace(0.0, 1.0, LEAF_ALONG + 1)
    v = np.linspace(-1.0, 1.0, LEAF_ACROSS + 1)
    width = 0.46 * _outline(u) * leaf.length_cm
    up = np.cross(leaf.across, leaf.along)
    bend = leaf.droop_rad * (u - 0.25)
    step = leaf.length_cm / LEAF_ALONG
    forward, fall = np.cos(bend) * step, -np.sin(bend) * step
    x = np.concatenate([[0.0], np.cumsum(0.5 * (forward[1:] + forward[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(0.5 * (fall[1:] + fall[:-1]))])
    # The lobes of the heart reach back past the petiole.
    back = 0.11 * leaf.length_cm * np.exp(-u / 0.10)[:, None] * np.abs(v)[None, :] ** 1.5
    lateral = width[:, None] * v[None, :] * np.cos(leaf.fold_rad)
    lift = width[:, None] * np.abs(v)[None, :] * np.sin(leaf.fold_rad)
    lift = lift + 0.02 * leaf.length_cm * np.sin(7.0 * u)[:, None] * np.abs(v)[None, :]
    grid = (
        leaf.base_cm
        + (x[:, None] - back)[..., None] * leaf.along
        + lateral[..., None] * leaf.across
        + (y[:, None] + lift)[..., None] * up
    )
    diagonal_a, diagonal_b = grid[1:, 1:] - grid[:-1, :-1], grid[:-1, 1:] - grid[1:, :-1]
    normal = np.cross(diagonal_a, diagonal_b)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    um, vm = 0.5 * (u[1:] + u[:-1])[:, None], np.abs(0.5 * (v[1:] + v[:-1]))[None, :]
    veins = 0.30 * np.exp(-((vm / 0.07) ** 2)) + 0.14 * (np.mod(um - 0.32 * vm, 0.17) < 0.035)
    colour = leaf.albedo * (1.0 + veins)[..., None] * (0.94 + 0.10 * np.sin(23.0 * um + 9.0 * vm))[..., None]
    return _faces(grid, normal, colour, 1.0)


def carried(direction: FloatArray, tangent: FloatArray) -> FloatArray:
    """A direction given for an upright stem, carried onto a stem with this tangent by the smallest rotation."""
    half = (direction @ tangent + direction[1]) / max(1.0 + float(tangent[1]), 1e-3)
    out = direction - half * (tangent + _UP) + 2.0 * direction[1] * tangent
    return np.asarray(out / np.linalg.norm(out), dtype=np.float64)


def _outline(u: FloatArray) -> FloatArray:
    """Half width of the blade along its midrib, at most 1."""
    shape = (u + 0.02) ** 0.42 * (1.0 - u) ** 0.85
    return np.asarray(shape / shape.max(), dtype=np.float64)


def _faces(grid: FloatArray, normal: FloatArray, albedo: FloatArray, flat: float) -> Mesh:
    corners = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    return Mesh(corners, normal.reshape(-1, 3), albedo.reshape(-1, 3), np.full(len(corners), flat))
