"""One photograph with what was found in it drawn over: can be done in any thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadPicture
from flora_common.geometry import arc_length, polyline_length, to_px
from flora_common.runs import CameraSection
from flora_common.shapes import Obstacle, Target
from flora_common.vision import draw
from flora_common.vision.picture import Picture
from flora_common.vision.reading import OK
from flora_lab.sources import FilmPicture, PictureFile
from flora_lab.track.readings import Reading

ORANGE: Final[draw.Colour] = (0, 140, 255)
BAND_MM: Final = 2.0
"""The band is drawn this many standard deviations to either side."""
BAND_STRENGTH: Final = 0.35
_FINE_BITS: Final = 4
_FINE: Final = 1 << _FINE_BITS

Box = tuple[int, int, int, int]
"""Left, top, right, bottom in px of the full picture; right and bottom lie outside."""


@dataclass(frozen=True, slots=True)
class View:
    """How a photograph is shown.

    Attributes:
        box: the part that is shown.
        scale: pixels drawn per pixel of the photograph.
        caption: whether a line of text is written at the bottom.
    """

    box: Box
    scale: float
    caption: bool = True

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the drawing; both even, as films need it."""
        width, height = self.box[2] - self.box[0], self.box[3] - self.box[1]
        return max(2, 2 * round(width * self.scale / 2)), max(2, 2 * round(height * self.scale / 2))


@dataclass(frozen=True, slots=True)
class DrawTask:
    """A photograph, its reading, and the views of it that are wanted."""

    picture: PictureFile | FilmPicture
    reading: Reading
    views: tuple[View, ...]


@dataclass(frozen=True, slots=True)
class DrawReadings:
    """Work for a pool: the drawings of a task, one per view; none if the photograph cannot be used."""

    camera: CameraSection
    obstacle: Obstacle | None
    target: Target | None

    def __call__(self, task: DrawTask) -> list[Picture]:
        try:
            picture = task.picture.load(1)
        except BadPicture:
            return []  # reported where it was read
        return [self.drawn(picture, task.reading, view) for view in task.views]

    def drawn(self, picture: Picture, reading: Reading, view: View) -> Picture:
        """A view of a photograph with everything drawn over it."""
        x0, y0, x1, y1 = view.box
        part = picture[y0:y1, x0:x1]
        method = cv2.INTER_AREA if view.scale < 1.0 else cv2.INTER_CUBIC
        part = np.asarray(cv2.resize(part, view.size_px, interpolation=method), dtype=np.uint8)
        place = CropToDrawing(view)
        seen = _camera_of(self.camera, view)
        out = draw.overlay(part, seen, obstacle=self.obstacle, target=self.target, light=reading.light)
        if reading.stem.points_cm is not None:
            self._draw_stem(out, reading, place)
        if view.caption:
            draw.draw_caption(out, caption_of(reading))
        return out

    def _draw_stem(self, out: Picture, reading: Reading, place: CropToDrawing) -> None:
        stem = reading.stem
        assert stem.points_cm is not None
        points = place(to_px(stem.points_cm, self.camera))
        line = points if stem.line_px is None else place(stem.line_px)
        colour = draw.CYAN if stem.outcome == OK else ORANGE
        if stem.uncertainty_mm is not None:
            per_mm = 0.1 * self.camera.px_per_cm * place.scale
            _draw_band(out, line, points, BAND_MM * per_mm * stem.uncertainty_mm, colour)
        cv2.polylines(out, [_fine(line)], False, colour, 1, cv2.LINE_AA, _FINE_BITS)
        # small where the plant is small: the dots are not to hide it
        length = float(polyline_length(line))
        size = min(max(1.0, length / 80.0), max(2.0, out.shape[1] / 300.0))
        for point in _fine(points)[:-1]:
            cv2.circle(out, _xy(point), round(size * _FINE), draw.YELLOW, -1, cv2.LINE_AA, _FINE_BITS)
        # a ring, so that the tip itself can be seen
        cv2.circle(out, _xy(_fine(points)[-1]), round(2.2 * size * _FINE), draw.YELLOW, 1, cv2.LINE_AA, _FINE_BITS)


class CropToDrawing:
    """From px of the photograph to px of a view of it."""

    def __init__(self, view: View) -> None:
        self._corner = np.array(view.box[:2], dtype=np.float64)
        extent = np.array([view.box[2] - view.box[0], view.box[3] - view.box[1]])
        self._scale = np.array(view.size_px) / extent
        self.scale = float(self._scale.mean())

    def __call__(self, px: FloatArray) -> FloatArray:
        return np.asarray((px - self._corner + 0.5) * self._scale - 0.5, dtype=np.float64)


def whole(size_px: tuple[int, int], *, least_width_px: int) -> View:
    """The whole photograph; small ones enlarged, so that a thin line does not hide the stem."""
    return View((0, 0, *size_px), float(max(1, -(-least_width_px // size_px[0]))))


def plant_view(readings: Sequence[Reading], camera: CameraSection, *, longest_px: int, caption: bool) -> View:
    """The part in which the plant stands in any of the readings, with a rim.

    Args:
        readings: all that will be shown.
        camera: anchor, scale and size.
        longest_px: length of the drawing's longer side.
        caption: whether it is written into the drawing.
    """
    anchor = np.array(camera.anchor_px)
    places = [anchor[None, :]]
    for r in readings:
        if r.stem.line_px is not None:
            places.append(r.stem.line_px)
        elif r.stem.points_cm is not None:
            places.append(to_px(r.stem.points_cm, camera))
    every = np.concatenate(places)
    low, high = every.min(axis=0), every.max(axis=0)
    rim = max(0.15 * float((high - low).max()), camera.px_per_cm, 12.0)
    # not narrower than two thirds of its height, nor lower than half its width: strips are hard to look at
    extent = high - low + 2.0 * rim
    missing = np.maximum(0.0, np.array([2.0 / 3.0 * extent[1], 0.5 * extent[0]]) - extent) / 2.0
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(low - rim - missing), 0, size - 2).astype(int)
    high = np.clip(np.ceil(high + rim + missing), low + 2, size).astype(int)
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    return View(box, longest_px / float(max(high - low)), caption)


def caption_of(reading: Reading) -> str:
    """Name, time, outcome and quality of a reading."""
    stem = reading.stem
    text = f"{reading.name}  {reading.time_s / 3600:.2f} h  {stem.outcome}"
    if stem.points_cm is not None:
        text += f"  quality {stem.quality:.2f}"
    if stem.uncertainty_mm is not None:
        text += f"  tip +-{stem.uncertainty_mm[-1]:.1f} mm"
    if stem.folded:
        text += "  folded"
    return text if stem.outcome == OK or not stem.reason else f"{text}: {stem.reason}"


def _camera_of(camera: CameraSection, view: View) -> CameraSection:
    """The camera as if it had taken only what the view shows."""
    x0, y0, x1, y1 = view.box
    return CameraSection((camera.anchor_px[0] - x0, camera.anchor_px[1] - y0), camera.px_per_cm, x1 - x0, y1 - y0)


def _draw_band(out: Picture, line: FloatArray, points: FloatArray, radius: FloatArray, colour: draw.Colour) -> None:
    """A faint veil about the line, as wide as each of the ten points is uncertain."""
    s = arc_length(line)
    nearest = np.argmin(((points[:, None, :] - line[None, :, :]) ** 2).sum(axis=2), axis=1)
    order = np.argsort(s[nearest], kind="stable")
    wide = np.interp(s, s[nearest][order], radius[order])
    mask = np.zeros(out.shape[:2], np.uint8)
    for place, r in zip(_fine(line), np.clip(wide, 0.0, 2000.0), strict=True):
        cv2.circle(mask, _xy(place), round(float(r) * _FINE), 255, -1, cv2.LINE_8, _FINE_BITS)
    inside = mask > 0
    out[inside] = np.rint((1.0 - BAND_STRENGTH) * out[inside] + BAND_STRENGTH * np.array(colour)).astype(np.uint8)


def _fine(px: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """Positions in 16ths of a pixel; what lies absurdly far outside is held near, where drawing cannot overflow."""
    return np.rint(np.clip(px, -50_000.0, 50_000.0) * _FINE).astype(np.int32)


def _xy(point: np.ndarray[tuple[int, ...], np.dtype[np.int32]]) -> tuple[int, int]:
    return int(point[0]), int(point[1])
