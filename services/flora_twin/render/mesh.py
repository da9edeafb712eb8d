"""Stem, petioles and leaves as small faces in space, with colour.

All leaves of a bean stand on petioles: the primary pair, heart-shaped, opposite each other at one node, and further up
the first trifoliate leaf, which unfolds as the plant grows. Sizes follow a logistic course in time; they are estimates
after photographs of Phaseolus vulgaris seedlings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray, IntArray

STEM_STRIPS: Final = 6
STEM_OWNER: Final = -1
"""Owner of faces that belong to no blade."""
_UP: Final = np.array([0.0, 1.0, 0.0])
_HALF_WIDTH: Final = 0.46
"""Half of a blade's width, in lengths."""
_FINE_BLADE_CM: Final = 1.4


@dataclass(frozen=True, slots=True)
class Mesh:
    """Quadrilateral faces.

    Attributes:
        corners_cm: shape (n, 4, 3).
        normal: shape (n, 3), unit; of blades, away from their upper side.
        albedo: shape (n, 3), blue, green, red.
        flat: shape (n,), 1 for leaf blades (they let light through), 0 for stems.
        owner: shape (n,), number of the blade that a face belongs to, or :data:`STEM_OWNER`.
    """

    corners_cm: FloatArray
    normal: FloatArray
    albedo: FloatArray
    flat: FloatArray
    owner: IntArray


@dataclass(frozen=True, slots=True)
class Leaf:
    """One blade: where it hangs, where it points, how large and how far unfolded it is.

    Attributes:
        base_cm: shape (3,), end of its petiole.
        along, across: unit vectors (3,) of midrib and width at its base.
        length_cm: of the midrib.
        fold_rad: angle of its halves with the plane of ``along`` and ``across``.
        droop_rad: bend of the midrib over its length, downwards.
        albedo: shape (3,), blue, green, red.
        ruffle: height of the waves at its edge, in lengths.
        phase_rad: of those waves.
    """

    base_cm: FloatArray
    along: FloatArray
    across: FloatArray
    length_cm: float
    fold_rad: float
    droop_rad: float
    albedo: FloatArray
    ruffle: float = 0.02
    phase_rad: float = 0.0

    @property
    def up(self) -> FloatArray:
        """Unit vector (3,) away from the upper side at the base."""
        return np.asarray(np.cross(self.across, self.along), dtype=np.float64)


def join(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    return Mesh(
        np.concatenate([m.corners_cm for m in meshes]),
        np.concatenate([m.normal for m in meshes]),
        np.concatenate([m.albedo for m in meshes]),
        np.concatenate([m.flat for m in meshes]),
        np.concatenate([m.owner for m in meshes]),
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
    return _faces(grid, normal, colour, 0.0, STEM_OWNER)


def blade(leaf: Leaf, owner: int) -> Mesh:
    """A heart-shaped blade with midrib, veins and a wavy edge; small ones have fewer faces."""
    along, across = (22, 14) if leaf.length_cm > _FINE_BLADE_CM else (8, 6)
    grid, u, v = _grid(leaf, along, across)
    diagonal_a, diagonal_b = grid[1:, 1:] - grid[:-1, :-1], grid[:-1, 1:] - grid[1:, :-1]
    normal = np.cross(diagonal_a, diagonal_b)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    um, vm = 0.5 * (u[1:] + u[:-1])[:, None], 0.5 * (v[1:] + v[:-1])[None, :]
    rib = np.exp(-((vm / 0.075) ** 2))
    between = np.mod(um - 0.36 * np.abs(vm), 0.155) / 0.155
    vein = np.exp(-(((between - 0.5) / 0.16) ** 2)) * (np.abs(vm) < 0.9)
    patches = 0.07 * np.sin(9.0 * um + 3.1 * vm + leaf.phase_rad) * np.cos(6.0 * vm - 2.0 * leaf.phase_rad)
    colour = leaf.albedo * (0.95 + 0.42 * rib + 0.16 * vein + patches)[..., None]
    # Between the veins the blade bulges: its normals tip to either side of every vein.
    lean = 0.16 * (between - 0.5) * np.sign(between - 0.5 + 1e-9) ** 2
    normal = normal + lean[..., None] * leaf.along
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return _faces(grid, normal, colour, 1.0, owner)


def outline(leaf: Leaf) -> FloatArray:
    """The edge of a blade, shape (n, 3)."""
    grid, _, _ = _grid(leaf, 12, 4)
    return np.concatenate([grid[:, 0], grid[-1, 1:-1], grid[::-1, -1], grid[0, -2:0:-1]])


def half_width(u: FloatArray) -> FloatArray:
    """Half width of a blade along its midrib (0 to 1), in lengths; 0 beyond its ends."""
    inside = np.clip(u, 0.0, 1.0)
    return np.asarray(_HALF_WIDTH * _outline(inside) * (u > -0.1) * (u < 1.0), dtype=np.float64)


def carried(direction: FloatArray, tangent: FloatArray) -> FloatArray:
    """A direction given for an upright stem, carried onto a stem with this tangent by the smallest rotation."""
    half = (direction @ tangent + direction[1]) / max(1.0 + float(tangent[1]), 1e-3)
    out = direction - half * (tangent + _UP) + 2.0 * direction[1] * tangent
    return np.asarray(out / np.linalg.norm(out), dtype=np.float64)


def _grid(leaf: Leaf, along: int, across: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners (along + 1, across + 1, 3) of a blade's faces, and where they lie along and across it."""
    u, v = np.linspace(0.0, 1.0, along + 1), np.linspace(-1.0, 1.0, across + 1)
    width = _HALF_WIDTH * _outline(u) * leaf.length_cm
    bend = leaf.droop_rad * (u - 0.25)
    step = leaf.length_cm / along
    forward, fall = np.cos(bend) * step, -np.sin(bend) * step
    x = np.concatenate([[0.0], np.cumsum(0.5 * (forward[1:] + forward[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(0.5 * (fall[1:] + fall[:-1]))])
    # The lobes of the heart reach back past the petiole.
    back = 0.11 * leaf.length_cm * np.exp(-u / 0.10)[:, None] * np.abs(v)[None, :] ** 1.5
    # The halves are not alike, and the midrib is not straight.
    skew = 1.0 + 0.09 * np.sin(leaf.phase_rad) * np.sign(v)
    sway = 0.05 * leaf.length_cm * np.sin(leaf.phase_rad + 1.0) * (u - u * u)
    lateral = width[:, None] * (v * skew)[None, :] * np.cos(leaf.fold_rad) + sway[:, None]
    lift = width[:, None] * np.abs(v)[None, :] * np.sin(leaf.fold_rad)
    waves = np.sin(9.0 * u[:, None] + leaf.phase_rad + 1.3 * np.sign(v)[None, :])
    lift = lift + leaf.ruffle * leaf.length_cm * waves * np.abs(v)[None, :] ** 1.5
    grid = (
        leaf.base_cm
        + (x[:, None] - back)[..., None] * leaf.along
        + lateral[..., None] * leaf.across
        + (y[:, None] + lift)[..., None] * leaf.up
    )
    return np.asarray(grid, dtype=np.float64), u, v


def _outline(u: FloatArray) -> FloatArray:
    """Half width of the blade along its midrib, at most 1."""
    shape = (u + 0.02) ** 0.42 * (1.0 - u) ** 0.85
    return np.asarray(shape / _WIDEST, dtype=np.float64)


_WIDEST: Final = float(np.max((np.linspace(0.0, 1.0, 201) + 0.02) ** 0.42 * (1.0 - np.linspace(0.0, 1.0, 201)) ** 0.85))


def _faces(grid: FloatArray, normal: FloatArray, albedo: FloatArray, flat: float, owner: int) -> Mesh:
    corners = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    n = len(corners)
    return Mesh(
        corners, normal.reshape(-1, 3), albedo.reshape(-1, 3), np.full(n, flat), np.full(n, owner, dtype=np.int64)
    )
