"""How much each pixel looks like plant.

A photograph is divided by the empty setup under the same lamps (in logarithmic code, :mod:`..lamp_states`), and by its
own slow deviations from it, which are flash, exposure and lamp drift. What is left is the ratio of two reflectances per
channel, free of the lamp's tint. Plant is brighter than the board, or greener, or yellower; a shadow is only darker.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import COARSE, EmptySetup, coarse_code, level_difference, log_code
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import Picture, checked_array

Float32Array = npt.NDArray[np.float32]
ByteArray = npt.NDArray[np.uint8]

BLOCK: Final = 16
"""Side of the squares, in coarse pixels, whose median gives the slow deviation from the empty setup."""
CLEAR: Final = 5.0
"""In standard deviations: evidence from here on is plant rather than noise."""
LEAST_EVIDENCE: Final = 5.0
"""In code units: the same where the picture has hardly any noise, as texture that moves by a pixel would show."""

SMOOTHING_PX: Final = 0.7

# Rows: brightness, greenness, yellowness of a difference in blue, green, red.
_AXES: Final = np.array([[1 / 3, 1 / 3, 1 / 3], [-0.5, 1.0, -0.5], [-1.0, 0.5, 0.5]], np.float32)
GREEN_WEIGHT: Final = 1.5
YELLOW_WEIGHT: Final = 1.0
DARK_WEIGHT: Final = 0.2
"""Darkness counts little: shadows are dark, and a plant on a bright board differs in colour too."""
LEVELS: Final = 8
"""Noise is measured apart in so many bands of brightness."""
MOST_SHIFT_PX: Final = 2.0
"""A camera that has moved farther than this has moved; less is believed and taken into account."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The part of a picture in which the plant stands.

    Attributes:
        origin_px: place (x, y) of its first pixel in the full picture.
        plant: shape (height, width), 0 where there is none; in units of the logarithmic code.
        code: shape (height, width, 3), the picture itself in logarithmic code, a little smoothed: its brightness and
            colour tell a stem from a leaf that it crosses.
        noise: standard deviation of ``plant`` on the empty setup.
        changed: share of the picture outside the plant's surroundings that differs from the empty setup.
        plant_share: share of the picture that looks like plant, wherever it stands.
        blind: share of this part that is saturated in the empty setup or in the picture.
    """

    origin_px: tuple[int, int]
    plant: Float32Array
    code: Picture
    noise: float
    changed: float
    plant_share: float
    blind: float

    @property
    def empty(self) -> bool:
        return self.plant.size == 0

    @property
    def tone(self) -> Float32Array:
        """Brightness of the picture, shape (height, width)."""
        return np.asarray(cv2.transform(self.code, np.full((1, 3), 1 / 3)), dtype=np.float32)


class PlantFinder:
    """Turns photographs into evidence; keeps nothing from one to the next.

    Args:
        setup: the empty setup.
        camera: anchor and scale, in px of the full picture.
        settings: numbers of the method.

    Raises:
        BadInput: setup and camera disagree on the size, or no pixel is left in the window.
    """

    def __init__(self, setup: EmptySetup, camera: CameraSection, settings: PathSettings) -> None:
        size = (camera.width_px, camera.height_px)
        if setup.size_px != size:
            raise BadInput(
                f"the empty setup is known at {setup.size_px[0]}x{setup.size_px[1]} px, pictures are "
                f"{size[0]}x{size[1]} px; make its pictures anew"
            )
        self.setup, self.camera, self.settings = setup, camera, settings
        self._size = size
        self._box = window_box(camera, settings)

    def find(self, picture: Picture) -> Evidence:
        """Evidence of the plant that stands at the anchor.

        Args:
            picture: shape (height, width, 3), uint8, blue-green-red, full size.

        Raises:
            BadPicture: not an 8-bit colour picture of the camera's size.
        """
        checked_array(picture, where="picture")
        if (picture.shape[1], picture.shape[0]) != self._size:
            raise BadPicture(
                f"picture is {picture.shape[1]}x{picture.shape[0]} px, expected {self._size[0]}x{self._size[1]}"
            )
        coarse = coarse_code(picture)
        state, _ = self.setup.nearest(coarse)
        difference, middle = level_difference(coarse, state.coarse)
        slow = slow_deviation(difference)
        flat = (difference - _enlarged(slow, difference.shape[1], difference.shape[0])).astype(np.float32)
        shift = _shift_of(flat, state.coarse)
        if shift.any():
            flat += _moved(state.coarse, shift)
        score = plant_score(flat)
        quiet = _evened(score, state.coarse)
        noise = _noise_of(score)
        mask = (score > max(CLEAR * noise, LEAST_EVIDENCE)).astype(np.uint8)
        around, plant_share = self._surroundings(mask)
        changed = self._changed(flat, around)
        rows, columns = _bounds(around, self._box)
        if rows.start >= rows.stop or columns.start >= columns.stop:
            nothing = np.zeros((0, 0), np.float32)
            return Evidence((0, 0), nothing, np.zeros((0, 0, 3), np.uint8), noise, changed, plant_share, 0.0)
        # one level per channel was taken away before the slow deviation was measured
        slow += middle
        part, empty = log_code(picture[rows, columns]), state.code[rows, columns]
        fine = np.asarray(cv2.subtract(part, empty, dtype=cv2.CV_32F), dtype=np.float32)
        fine -= _slow_at(slow, rows, columns)
        if shift.any():
            fine += _moved(empty, shift * COARSE)
        fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), SMOOTHING_PX), dtype=np.float32)
        score = plant_score(fine) * cv2.LUT(np.asarray(empty[..., 1]), quiet)
        noise = _noise_of(score)
        _, plant = cv2.threshold(score, max(CLEAR * noise, LEAST_EVIDENCE), 0.0, cv2.THRESH_TOZERO)
        blind = float((part[::2, ::2, 1] > 252).mean())
        part = np.asarray(cv2.GaussianBlur(part, (0, 0), 1.0), dtype=np.uint8)
        return Evidence(
            (columns.start, rows.start), np.asarray(plant, dtype=np.float32), part, noise, changed, plant_share, blind
        )

    def _surroundings(self, mask: ByteArray) -> tuple[ByteArray, float]:
        """The pixels near what hangs together with the anchor, and the share of all plant-like pixels."""
        px_per_cm = self.camera.px_per_cm / COARSE
        box = np.zeros_like(mask)
        rows, columns = (slice(s.start // COARSE, -(-s.stop // COARSE)) for s in self._box)
        box[rows, columns] = mask[rows, columns]
        share = float(box.mean())
        reach = max(3, round(1.2 * px_per_cm) | 1)
        near = cv2.dilate(box, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
        place = nearest_in_window(self.camera, self.settings)
        x, y = (min(round(v / COARSE), size - 1) for v, size in zip(place, mask.shape[::-1], strict=True))
        cv2.circle(near, (x, y), max(2, round(self.settings.hidden_base_cm * px_per_cm)), 1, -1)
        _, labels = cv2.connectedComponents(near, connectivity=4)
        around = (labels == labels[y, x]).astype(np.uint8)
        if not (around & box).any():
            around[:] = 0
        return around, share

    def _changed(self, flat: Float32Array, around: ByteArray) -> float:
        """Share of the picture, away from the plant, that is not as the empty setup shows it."""
        size = np.abs(flat[::2, ::2]).max(axis=2)
        away = around[::2, ::2] == 0
        if not away.any():
            return 0.0
        return float((size[away] > 40).mean())


def plant_score(difference: Float32Array) -> Float32Array:
    """Evidence of plant from log ratios in blue, green, red; shape (height, width, 3) to (height, width).

    How far the reflectance is from the empty setup's: brighter, of another colour, and a little if it is darker.
    """
    bright, green, yellow = cv2.split(cv2.transform(difference, _AXES))
    bright = np.where(bright > 0, bright, DARK_WEIGHT * bright)
    return np.asarray(
        cv2.sqrt(bright * bright + (GREEN_WEIGHT * green) ** 2 + (YELLOW_WEIGHT * yellow) ** 2), dtype=np.float32
    )


def _evened(score: Float32Array, empty: Picture) -> Float32Array:
    """Bring the noise in all bands of brightness to one size; changes ``score``.

    Returns:
        Shape (256,), the factor for each level of the empty setup's green.
    """
    green = np.asarray(empty[..., 1])
    step = 256 // LEVELS
    band, sample = green[::2, ::2] // step, score[::2, ::2]
    usual = max(0.5, float(np.median(sample)))
    factors = np.ones(LEVELS, np.float32)
    for k in range(LEVELS):
        here = sample[band == k]
        if here.size > 300:
            factors[k] = min(1.0, usual / max(1e-3, float(np.median(here))))
    table = np.interp(np.arange(256), (np.arange(LEVELS) + 0.5) * step, factors).astype(np.float32)
    score *= cv2.LUT(green, table)
    return table


def _shift_of(flat: Float32Array, empty: Picture) -> Float32Array:
    """How far the picture lies from the empty setup, (x, y) in coarse pixels, by least squares on its gradient.

    Lucas and Kanade 1981, over the whole picture at once; what differs by more than edges can is left out.
    """
    grey = np.asarray(empty[..., 1], dtype=np.float32)
    gx, gy = (0.5 * cv2.Sobel(grey, cv2.CV_32F, *order, ksize=1) for order in ((1, 0), (0, 1)))
    off = flat[..., 1]
    use = (np.abs(off) < 30) & ((np.abs(gx) > 4) | (np.abs(gy) > 4)) & (grey < 250)
    x, y, d = gx[use], gy[use], off[use]
    if d.size < 200:
        return np.zeros(2, np.float32)
    normal = np.array([[x @ x, x @ y], [x @ y, y @ y]], dtype=np.float64) + 1e-3 * np.eye(2) * float(x @ x + y @ y)
    shift = -np.linalg.solve(normal, np.array([x @ d, y @ d], dtype=np.float64))
    if np.abs(shift).max() * COARSE > MOST_SHIFT_PX:
        return np.zeros(2, np.float32)
    return shift.astype(np.float32)


def _moved(empty: Picture, shift: Float32Array) -> Float32Array:
    """What must be added to a difference because the picture lies elsewhere by ``shift`` pixels."""
    x, y = (0.5 * cv2.Sobel(empty, cv2.CV_32F, *order, ksize=1) for order in ((1, 0), (0, 1)))
    return np.asarray(shift[0] * x + shift[1] * y, dtype=np.float32)


def slow_deviation(difference: npt.NDArray[np.int16]) -> Float32Array:
    """Medians over squares of the coarse difference, themselves median-filtered; shape (rows, columns, 3).

    A plant fills few of 5 x 5 neighbouring squares, so that it does not enter.
    """
    height, width = difference.shape[:2]
    rows, columns = max(1, height // BLOCK), max(1, width // BLOCK)
    side = min(BLOCK, height, width)
    squares = difference[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)
    squares = squares[:, ::2, :, ::2].transpose(0, 2, 1, 3, 4).reshape(rows, columns, -1, 3)
    medians = np.ascontiguousarray(np.median(squares, axis=2).astype(np.float32))
    return np.stack([cv2.medianBlur(np.ascontiguousarray(medians[..., k]), 5) for k in range(3)], axis=-1)


def window_box(camera: CameraSection, settings: PathSettings) -> tuple[slice, slice]:
    """Rows and columns of the full picture in which a plant may stand.

    Raises:
        BadInput: there are none.
    """
    x0, y0, x1, y1 = settings.window_px or (0, 0, camera.width_px, camera.height_px)
    lowest = camera.anchor_px[1] + settings.below_anchor_cm * camera.px_per_cm
    rows = slice(max(0, round(y0)), min(camera.height_px, round(y1) + 1, round(lowest) + 1))
    columns = slice(max(0, round(x0)), min(camera.width_px, round(x1) + 1))
    if rows.stop - rows.start < 4 or columns.stop - columns.start < 4:
        ax, ay = camera.anchor_px
        raise BadInput(
            f"no pixel of the {camera.width_px}x{camera.height_px} px picture lies both in the window and above the "
            f"anchor ({ax:g}, {ay:g}); correct anchor or window"
        )
    return rows, columns


def nearest_in_window(camera: CameraSection, settings: PathSettings) -> tuple[float, float]:
    """The place in the window that is nearest to the anchor, px; what lies between the two is not looked at."""
    rows, columns = window_box(camera, settings)
    x, y = camera.anchor_px
    return min(max(x, columns.start), columns.stop - 1), min(max(y, rows.start), rows.stop - 1)


def _bounds(around: ByteArray, box: tuple[slice, slice]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(around.any(axis=1)), np.flatnonzero(around.any(axis=0))
    if rows.size == 0:
        return slice(0, 0), slice(0, 0)
    return (
        slice(max(box[0].start, int(rows[0]) * COARSE), min(box[0].stop, (int(rows[-1]) + 1) * COARSE)),
        slice(max(box[1].start, int(columns[0]) * COARSE), min(box[1].stop, (int(columns[-1]) + 1) * COARSE)),
    )


def _enlarged(slow: Float32Array, width: int, height: int) -> Float32Array:
    return _slow_at(slow, slice(0, height * COARSE), slice(0, width * COARSE), step=COARSE)


def _slow_at(slow: Float32Array, rows: slice, columns: slice, step: int = 1) -> Float32Array:
    """The slow deviation at pixels of the full picture, linear between the middles of the squares."""
    side = BLOCK * COARSE
    shape = (len(range(rows.start, rows.stop, step)), len(range(columns.start, columns.stop, step)))
    scale = step / side
    # maps a pixel of the part onto the grid of squares
    x0 = (columns.start + 0.5 * step) / side - 0.5
    y0 = (rows.start + 0.5 * step) / side - 0.5
    grid = np.array([[scale, 0.0, x0], [0.0, scale, y0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    out = cv2.warpAffine(slow, grid, (shape[1], shape[0]), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(out, dtype=np.float32)


def _noise_of(score: Float32Array) -> float:
    """Standard deviation of the evidence's parts where there is no plant: most of a picture is empty."""
    return max(0.8, float(np.median(score[::3, ::3])) / 1.4)
