"""Crops of examples, turned, stretched and recoloured, and what the network is to say of them."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from flora_common.vision.path.convolutions import MOST
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import CODE_STEP, INPUT_PX_PER_CM, in_steps, mean_colour
from guide.canvas import PX_PER_CM, SHIFT, Floats, corners
from guide.examples import Example

SIDE: Final = 160
"""Of a crop, px: 13 cm."""
AT_APEX: Final = 0.6
"""Share of crops about the apex; the others are about any place of the stem."""
ASIDE_PX: Final = 55.0
TURN_DEG: Final = 15.0
STEM_PX, APEX_PX = 1.2, 1.3
"""Standard deviation of what is wanted about the stem's middle and the apex, px of the maps."""


def sample(example: Example, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """A crop and what is wanted of it.

    Returns:
        Input of the network, shape (4, SIDE, SIDE), and two maps, shape (2, SIDE / 2, SIDE / 2), both float32.
    """
    place = _moved(example.line, rng)
    plant, code = (
        cv2.warpAffine(v, place, (SIDE, SIDE), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for v in (example.plant, example.code)
    )
    colour = mean_colour(Evidence((0, 0), example.plant, example.code, 1.0))
    seen = in_steps(plant.astype(np.float32), code.astype(np.float32), colour)
    line = example.line @ place[:, :2].T + place[:, 2]
    seen = _recoloured(seen, rng).transpose(2, 0, 1)
    return np.clip(seen, 0.0, MOST).astype(np.float32), wanted((line + 0.5) / 2.0 - 0.5)


def wanted(line: Floats) -> Floats:
    """The maps of a stem, shape (n, 2), px of the maps; shape (2, SIDE / 2, SIDE / 2)."""
    half = SIDE // 2
    drawn = np.full((half, half), 255, np.uint8)
    cv2.polylines(drawn, corners(np.clip(line, -500.0, 500.0)), False, 0, 1, cv2.LINE_8, SHIFT)
    away = np.minimum(cv2.distanceTransform(drawn, cv2.DIST_L2, 5), 100.0)
    rows, columns = np.indices((half, half))
    to_apex = (columns - line[-1, 0]) ** 2 + (rows - line[-1, 1]) ** 2
    maps = [np.exp(-0.5 * (away / STEM_PX) ** 2), np.exp(-0.5 * to_apex / APEX_PX**2)]
    return np.stack(maps).astype(np.float32)


def _moved(line: Floats, rng: np.random.Generator) -> Floats:
    """The matrix, shape (2, 3), that puts a place of the plant into the middle of the crop."""
    middle = line[-1] if rng.random() < AT_APEX else line[rng.integers(len(line))]
    middle = middle + rng.normal(size=2) * ASIDE_PX
    scale = INPUT_PX_PER_CM / PX_PER_CM * np.exp(rng.uniform(-0.5, 0.5))
    place = cv2.getRotationMatrix2D((float(middle[0]), float(middle[1])), rng.normal() * TURN_DEG, scale)
    place[:, 2] += SIDE / 2 - middle
    if rng.random() < 0.5:
        place[0] = -place[0]
        place[0, 2] += SIDE - 1
    return place


def _recoloured(seen: Floats, rng: np.random.Generator) -> Floats:
    """Other colours, light, sharpness and noise; shape (SIDE, SIDE, 4)."""
    middle, unit = 0.5 * MOST, 32.0 / CODE_STEP
    plant, colours = seen[..., :1], seen[..., 1:] - middle
    if rng.random() < 0.25:
        colours = np.repeat(colours.mean(axis=2, keepdims=True), 3, axis=2)
    else:
        colours = colours @ (np.eye(3) + rng.normal(size=(3, 3)) * 0.12).T.astype(np.float32)
    colours = colours * np.exp(rng.normal() * 0.25) + rng.normal(size=3) * 0.15 * unit
    both = np.concatenate([plant * np.exp(rng.normal() * 0.3), colours], axis=2).astype(np.float32)
    if rng.random() < 0.3:
        both = cv2.GaussianBlur(both, (0, 0), float(rng.uniform(0.4, 1.3)))
    if rng.random() < 0.5:
        grain = rng.standard_normal((SIDE, SIDE, 3), dtype=np.float32)
        both[..., 1:] += grain * np.float32(rng.uniform(0, 0.15) * unit)
    if rng.random() < 0.1:
        holes = (rng.random((8, 8)) > 0.1).astype(np.float32)
        both[..., 0] *= holes.repeat(SIDE // 8, axis=0).repeat(SIDE // 8, axis=1)
    both[..., 1:] += middle
    return both
