"""What of the lights the plant's own blades, stem and petioles keep from it and from the pot."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import Float32Array, FloatArray, IntArray
from flora_twin.render import mesh
from flora_twin.render.foliage import Foliage
from flora_twin.render.mesh import Leaf

THROUGH_BLADE_BGR: Final = np.array([0.08, 0.28, 0.16])
"""Share of light that comes through a blade. Estimate; leaves let little blue and red through."""
CELLS_PER_CM: Final = 6.0
REACH_CM: Final = 16.0
_LEAST_PENUMBRA_CM: Final = 0.06


def over_plant(
    blades: list[Leaf],
    places_cm: FloatArray,
    owner: IntArray,
    light_cm: FloatArray,
    light_radius_cm: float,
) -> FloatArray:
    """Share of a light's blue, green and red that reaches places of the plant past its blades, shape (n, 3).

    Blades are taken as flat, the light as a disc: shadows grow softer with the distance from the blade.

    Args:
        blades: what casts shadows; the number of a blade is its owner number.
        places_cm: shape (n, 3).
        owner: shape (n,), the blade that a place belongs to, which does not shade it, or -1.
        light_cm: shape (3,).
        light_radius_cm: of the disc.
    """
    to_light = light_cm - places_cm
    distance = np.linalg.norm(to_light, axis=1)
    passed = np.ones(len(places_cm))
    for number, leaf in enumerate(blades):
        along, up, middle = _flattened(leaf)
        towards = to_light @ up
        offset = leaf.base_cm - places_cm
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.nan_to_num((offset @ up) / towards, nan=-1.0, posinf=-1.0, neginf=-1.0)
        candidates = np.nonzero((share > 0.0) & (share < 0.98) & (owner != number))[0]
        if not len(candidates):
            continue
        t = share[candidates]
        meets = t[:, None] * to_light[candidates] - offset[candidates]
        u = (meets @ along) / leaf.length_cm
        v = np.abs(meets @ leaf.across) / leaf.length_cm
        penumbra = np.maximum(light_radius_cm * t / (1.0 - t), _LEAST_PENUMBRA_CM)
        inside = (mesh.half_width(u) * middle - v) * leaf.length_cm
        dark = np.clip(0.5 + inside / (2.0 * penumbra), 0.0, 1.0) * (u > -0.02) * (u < 1.0)
        # A place that nearly touches the blade is the blade's own foot.
        dark *= np.clip(t * distance[candidates] / 0.15 - 0.5, 0.0, 1.0)
        passed[candidates] *= 1.0 - dark
    return np.asarray(passed[:, None] * (1.0 - THROUGH_BLADE_BGR) + THROUGH_BLADE_BGR, dtype=np.float64)


def on_ground(foliage: Foliage, stem_radius_cm: float, light_cm: FloatArray, softness_cm: float) -> Float32Array:
    """Darkness, 0 to 1, that the plant casts on the plane y = 0, on a grid of cells x, z; see :func:`ground_cells`."""
    size = int(2 * REACH_CM * CELLS_PER_CM)
    picture = np.zeros((size, size), np.uint8)
    lower = foliage.line_cm[:, 1] < 0.9 * light_cm[1]
    stem = _fixed(ground_cells(_onto_ground(foliage.line_cm[lower], light_cm)))
    width = max(1, round(2.0 * stem_radius_cm * CELLS_PER_CM))
    cv2.polylines(picture, [stem], isClosed=False, color=255, thickness=width, lineType=cv2.LINE_8, shift=4)
    for leaf in foliage.blades:
        edge = mesh.outline(leaf)
        if edge[:, 1].max() < 0.9 * light_cm[1]:
            cv2.fillPoly(picture, [_fixed(ground_cells(_onto_ground(edge, light_cm)))], 255, cv2.LINE_8, 4)
    soft = cv2.GaussianBlur(picture, (0, 0), max(0.6, softness_cm * CELLS_PER_CM))
    return np.asarray(soft * np.float32(1.0 / 255.0), dtype=np.float32)


def ground_cells(places_cm: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Cells of the grid of :func:`on_ground` for places (x, z) in cm on the plane y = 0."""
    return (places_cm + np.float32(REACH_CM)) * np.float32(CELLS_PER_CM)


def _onto_ground(places_cm: FloatArray, light_cm: FloatArray) -> FloatArray:
    """Where rays from the light through places (n, 3) meet the plane y = 0, shape (n, 2): x and z."""
    stretch = light_cm[1] / (light_cm[1] - places_cm[:, 1])
    out = light_cm + (places_cm - light_cm) * stretch[:, None]
    return np.asarray(out[:, [0, 2]], dtype=np.float64)


def _fixed(cells: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
    return np.asarray(np.rint(np.clip(cells, -2000.0, 2000.0) * 16.0), dtype=np.int32)


def _flattened(leaf: Leaf) -> tuple[FloatArray, FloatArray, float]:
    """Direction of the bent midrib's chord, the normal that goes with it, and the narrowing by the fold."""
    bend = 0.25 * leaf.droop_rad
    up = leaf.up
    along = np.cos(bend) * leaf.along - np.sin(bend) * up
    return along, np.asarray(np.cross(leaf.across, along), dtype=np.float64), float(np.cos(leaf.fold_rad))
