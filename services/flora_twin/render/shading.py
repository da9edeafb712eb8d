"""Light that the plant's faces send to the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Float32Array, FloatArray
from flora_twin.box import Box
from flora_twin.render import lighting, shadows
from flora_twin.render.foliage import Foliage

UNDERSIDE: Final = np.array([1.35, 1.12, 1.25])
"""The lower side of a blade is paler. Estimate."""
THROUGH_BGR: Final = np.array([0.30, 0.62, 0.45])
"""Colour of light seen through a blade, relative to the blade's own. Estimate."""
STEM_GLOSS: Final = 0.035
_SHARPNESS: Final = 24.0


@dataclass(frozen=True, slots=True)
class Lit:
    """What shines on the plant, shape (3,) each: blue, green, red.

    Attributes:
        flash: colour of the flash times its level relative to normal; None while it is dark.
        lamps: the same of the left and the right lamp.
    """

    flash: FloatArray | None
    lamps: tuple[FloatArray | None, FloatArray | None]


def shade(foliage: Foliage, lit: Lit, leaf_gloss: float, eye_cm: FloatArray, box: Box) -> FloatArray:
    """Light from each face to the camera, shape (n, 3), blue, green, red.

    Args:
        foliage: the plant.
        lit: flash and lamps.
        leaf_gloss: share of light that blades mirror.
        eye_cm: the camera's place.
        box: where the lights are.
    """
    mesh = foliage.mesh
    place = mesh.corners_cm.mean(axis=1)
    view = eye_cm - place
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    seen_from_below = (mesh.flat > 0) & (np.einsum("ij,ij->i", mesh.normal, view) < 0)
    front = np.where(seen_from_below[:, None], -mesh.normal, mesh.normal)
    albedo = np.where(seen_from_below[:, None], mesh.albedo * UNDERSIDE, mesh.albedo)
    gloss = np.where(mesh.flat > 0, np.where(seen_from_below, 0.3, 1.0) * leaf_gloss, STEM_GLOSS)
    diffuse = np.full((len(place), 3), lighting.LEAK)
    mirrored = np.zeros((len(place), 3))
    if lit.flash is not None:
        level, towards = lighting.flash_at(place, box)
        passed = shadows.over_plant(foliage.blades, place, mesh.owner, box.flash_cm, lighting.FLASH_RADIUS_CM)
        direct = level[:, None] * passed * lit.flash
        diffuse += direct * _received(front, mesh.flat, towards)
        diffuse += (lighting.FLASH_BOUNCE * lighting.FLASH_LEVEL * (0.65 + 0.35 * passed)) * lit.flash
        mirrored += direct * _highlight(front, view, towards)
    for which, lamp in enumerate(lit.lamps):
        if lamp is not None:
            level, towards = lighting.lamp_at(place, which, box)
            passed = shadows.over_plant(foliage.blades, place, mesh.owner, box.lamps_cm[which], box.lamp_radius_cm)
            direct = level[:, None] * passed * lamp
            diffuse += direct * _received(front, mesh.flat, towards)
            diffuse += lighting.LAMP_BOUNCE * lighting.LAMP_LEVEL * lamp
            mirrored += direct * _highlight(front, view, towards)
    return np.asarray(diffuse * albedo + gloss[:, None] * mirrored, dtype=np.float64)


def _received(front: FloatArray, flat: FloatArray, towards: Float32Array) -> FloatArray:
    """Share of a light that a face sends on, shape (n, 3).

    Stems are bright past their edge, blades let some light through.
    """
    facing = np.einsum("ij,ij->i", front, towards)
    round_stem = np.maximum((facing + 0.40) / 1.40, 0.0)
    lit_side = (0.10 + 0.90 * facing)[:, None]
    far_side = (0.10 + 0.70 * np.maximum(-facing, 0.0))[:, None] * THROUGH_BGR
    blade = np.where(facing[:, None] > 0, lit_side, far_side)
    return np.asarray(np.where(flat[:, None] > 0, blade, round_stem[:, None]), dtype=np.float64)


def _highlight(front: FloatArray, view: FloatArray, towards: Float32Array) -> FloatArray:
    """Blinn's highlight, shape (n, 1), about 1 over a few degrees round the mirror's direction."""
    half = view + towards
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-6)
    cosine = np.maximum(np.einsum("ij,ij->i", front, half), 0.0)
    return np.asarray((_SHARPNESS / 4.0 * cosine**_SHARPNESS)[:, None], dtype=np.float64)
