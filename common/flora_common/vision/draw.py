"""Drawing on photographs: stem, anchor, obstacle, target and lamps, as in the paper's figure of the reality experiment.

All functions take and return pictures of shape (height, width, 3), uint8, blue-green-red, and leave their input as it
was. Lengths in cm are placed through the camera section, scaled to the picture at hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection, Light
from flora_common.shapes import Obstacle, Target
from flora_common.vision.picture import Picture

Colour = tuple[int, int, int]

YELLOW: Final[Colour] = (0, 215, 255)
CYAN: Final[Colour] = (255, 230, 60)
RED: Final[Colour] = (40, 40, 230)
GREY: Final[Colour] = (150, 150, 150)
WHITE: Final[Colour] = (255, 255, 255)
BLACK: Final[Colour] = (0, 0, 0)

_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_FINE_BITS: Final = 4  # OpenCV's drawing takes positions in 16ths of a pixel


class CmToPx:
    """Where a place in cm lies in a picture that may be smaller than the camera's full one.

    Args:
        camera: anchor and scale, in px of the full picture.
        width_px: width of the picture that is drawn on.
    """

    def __init__(self, camera: CameraSection, width_px: int) -> None:
        self._share = width_px / camera.width_px
        self._anchor = np.array(camera.anchor_px, dtype=np.float64)
        self.px_per_cm = camera.px_per_cm * self._share

    def __call__(self, points_cm: npt.ArrayLike) -> FloatArray:
        """Positions in px, y down; shape (n, 2) as given, cm, y up."""
        p = np.asarray(points_cm, dtype=np.float64).reshape(-1, 2) * np.array([1.0, -1.0])
        anchor = (self._anchor + 0.5) * self._share - 0.5
        px: FloatArray = anchor + p * self.px_per_cm
        return px


def overlay(
    picture: Picture,
    camera: CameraSection,
    *,
    points_cm: npt.ArrayLike | None = None,
    obstacle: Obstacle | None = None,
    target: Target | None = None,
    light: Light | None = None,
    caption: str = "",
) -> Picture:
    """A copy of the picture with all that is given drawn over it.

    Args:
        picture: the photograph, at any size.
        camera: anchor and scale.
        points_cm: stem, shape (n, 2), anchor first, tip last.
        obstacle: drawn as a translucent grey rectangle.
        target: drawn as a translucent red disc of its radius, with its outline.
        light: which lamp shines; the two circles at the top are filled yellow (on) or empty (off).
        caption: one line at the bottom left.
    """
    out = picture.copy()
    to_px = CmToPx(camera, picture.shape[1])
    thick = max(1, round(picture.shape[1] / 500))
    if obstacle is not None:
        draw_obstacle(out, to_px, obstacle, thick)
    if target is not None:
        draw_target(out, to_px, target, thick)
    draw_anchor(out, to_px, thick)
    if points_cm is not None:
        draw_stem(out, to_px, points_cm, thick)
    if light is not None:
        draw_lamps(out, light, thick)
    if caption:
        draw_caption(out, caption)
    return out


def draw_stem(out: Picture, to_px: CmToPx, points_cm: npt.ArrayLike, thick: int) -> None:
    """Polyline through the points, a dot on each, a larger one on the tip."""
    px = _fine(to_px(points_cm))
    cv2.polylines(out, [px.reshape(-1, 1, 2)], False, CYAN, thick, cv2.LINE_AA, _FINE_BITS)
    for i, point in enumerate(px):
        radius = (2.0 if i == len(px) - 1 else 1.2) * thick + 0.5
        cv2.circle(out, _xy(point), round(radius * 2**_FINE_BITS), YELLOW, -1, cv2.LINE_AA, _FINE_BITS)


def draw_anchor(out: Picture, to_px: CmToPx, thick: int) -> None:
    """A white cross where the stem leaves the soil."""
    x, y = np.rint(to_px([(0.0, 0.0)])[0]).astype(int)
    if abs(x) < 100_000 and abs(y) < 100_000:
        cv2.drawMarker(out, (int(x), int(y)), WHITE, cv2.MARKER_CROSS, 8 * thick, thick, cv2.LINE_AA)


def draw_obstacle(out: Picture, to_px: CmToPx, obstacle: Obstacle, thick: int) -> None:
    """The rectangle, half transparent, with its edge."""
    corners = _fine(to_px([(obstacle.left_cm, obstacle.top_cm), (obstacle.right_cm, obstacle.bottom_cm)]))
    first, second = _xy(corners[0]), _xy(corners[1])
    veil = out.copy()
    cv2.rectangle(veil, first, second, GREY, -1, cv2.LINE_AA, _FINE_BITS)
    cv2.addWeighted(veil, 0.55, out, 0.45, 0.0, dst=out)
    cv2.rectangle(out, first, second, GREY, thick, cv2.LINE_AA, _FINE_BITS)


def draw_target(out: Picture, to_px: CmToPx, target: Target, thick: int) -> None:
    """The disc, half transparent, with its edge."""
    centre = _xy(_fine(to_px([(target.x_cm, target.y_cm)]))[0])
    radius = round(target.radius_cm * to_px.px_per_cm * 2**_FINE_BITS)
    veil = out.copy()
    cv2.circle(veil, centre, radius, RED, -1, cv2.LINE_AA, _FINE_BITS)
    cv2.addWeighted(veil, 0.45, out, 0.55, 0.0, dst=out)
    cv2.circle(out, centre, radius, RED, thick, cv2.LINE_AA, _FINE_BITS)


def draw_lamps(out: Picture, light: Light, thick: int) -> None:
    """A circle at the top left and one at the top right: filled yellow where the lamp shines, empty where not."""
    width = out.shape[1]
    radius = max(4, round(width * 0.022))
    for name, x in (("left", 2 * radius), ("right", width - 1 - 2 * radius)):
        shines = light in (name, "both")
        if shines:
            cv2.circle(out, (x, 2 * radius), radius, YELLOW, -1, cv2.LINE_AA)
        cv2.circle(out, (x, 2 * radius), radius, YELLOW, max(1, thick), cv2.LINE_AA)


def draw_caption(out: Picture, caption: str) -> None:
    """One line at the bottom left, white on black, shrunk where it would not fit. OpenCV's letters are ASCII only."""
    text = caption.encode("ascii", "replace").decode()
    height, width = out.shape[:2]
    scale = min(1.5, max(0.35, width / 650))
    (text_width, text_height), below = cv2.getTextSize(text, _FONT, scale, 1)
    if text_width > width - 8:
        scale *= max(0.1, (width - 8) / text_width)
        (text_width, text_height), below = cv2.getTextSize(text, _FONT, scale, 1)
    cv2.rectangle(out, (0, height - text_height - below - 8), (text_width + 8, height), BLACK, -1)
    cv2.putText(out, text, (4, height - below - 4), _FONT, scale, WHITE, 1, cv2.LINE_AA)


def contact_sheet(
    pictures: Sequence[Picture],
    *,
    columns: int,
    captions: Sequence[str] | None = None,
    tile_width_px: int | None = None,
) -> Picture:
    """Pictures side by side, row by row, each with its caption.

    Args:
        pictures: at least one; they are brought to one width and need not be of one size.
        columns: how many beside each other.
        captions: one per picture.
        tile_width_px: width of each; that of the first picture if None.

    Raises:
        ValueError: no pictures, no columns, or another number of captions.
    """
    if not pictures or columns < 1:
        raise ValueError("a contact sheet needs at least one picture and one column")
    if captions is not None and len(captions) != len(pictures):
        raise ValueError(f"{len(captions)} captions for {len(pictures)} pictures")
    width = tile_width_px if tile_width_px is not None else pictures[0].shape[1]
    tiles = []
    for i, picture in enumerate(pictures):
        height = max(1, round(picture.shape[0] * width / picture.shape[1]))
        method = cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_LINEAR
        tile = np.array(cv2.resize(picture, (width, height), interpolation=method), dtype=np.uint8)
        if captions is not None and captions[i]:
            draw_caption(tile, captions[i])
        tiles.append(tile)
    tallest = max(tile.shape[0] for tile in tiles)
    rows = math.ceil(len(tiles) / columns)
    sheet = np.zeros((rows * tallest, min(columns, len(tiles)) * width, 3), dtype=np.uint8)
    for i, tile in enumerate(tiles):
        top, left = (i // columns) * tallest, (i % columns) * width
        sheet[top : top + tile.shape[0], left : left + width] = tile
    return sheet


def _fine(px: FloatArray) -> npt.NDArray[np.int32]:
    """Positions in 16ths of a pixel; what lies absurdly far outside is held near, where drawing cannot overflow."""
    held = np.clip(np.nan_to_num(px, nan=0.0), -100_000.0, 100_000.0)
    return np.rint(held * 2**_FINE_BITS).astype(np.int32)


def _xy(point: npt.NDArray[np.int32]) -> tuple[int, int]:
    return int(point[0]), int(point[1])
