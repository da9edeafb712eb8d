"""The first look at a photograph, at a quarter of its size: lamp state, slow deviations, and where the plant stands.

A photograph is held against the empty setup under the lamps that it resembles most (in logarithmic code,
:mod:`..lamp_states`), and freed of its own slow deviations from it, which are flash, exposure and lamp drift. This is
done for the whole picture, whatever part of it is looked at more closely afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Array, ByteArray, Float32Array, FloatArray, Int16Array
from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import COARSE, EmptySetup, LampState, coarse_code
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import Picture, checked_array

BLOCK: Final = 16
"""Side of the squares, in coarse pixels, whose median gives the slow deviation from the empty setup."""
CLEAR: Final = 5.0
"""In standard deviations: evidence from here on is plant rather than noise."""
LEAST_EVIDENCE: Final = 5.0
"""In code units: the same where the picture has hardly any noise, as texture that moves by a pixel would show."""
GREEN_WEIGHT: Final = 1.5
YELLOW_WEIGHT: Final = 1.0
DARK_WEIGHT: Final = 0.2
"""Darkness counts little: shadows are dark, and a plant on a bright board differs in colour too."""
# Rows: brightness, greenness, yellowness of a difference in blue, green, red, by how much they count.
_AXES: Final = np.array(
    [
        [1 / 3, 1 / 3, 1 / 3],
        [-0.5 * GREEN_WEIGHT, GREEN_WEIGHT, -0.5 * GREEN_WEIGHT],
        [-YELLOW_WEIGHT, 0.5 * YELLOW_WEIGHT, 0.5 * YELLOW_WEIGHT],
    ],
    np.float32,
)
LEVELS: Final = 8
"""Noise is measured apart in so many bands of brightness."""
SAMPLED, LEAST_OF_LEVEL = 4, 75
"""By one pixel in so many along either side, and only where there are so many."""
MOST_SHIFT_PX: Final = 2.0
"""A camera that has moved farther than this has moved; less is believed and taken into account."""
SATURATED: Final = 250
"""In code units: a green of the empty setup from here on may be clipped, and its edges do not tell a shift."""
LEAST_SHIFT_PX: Final = 0.04
"""Less changes the evidence of the sharpest edges by half a code unit, which noise does, too."""
CHANGED: Final = 40.0
"""Code units, over squares of four coarse pixels, for single ones in the dark differ by as much."""
CHANGED_OVER_NOISE: Final = 4.0
"""So many times what a square of that brightness usually differs by, for in the darkest places these do, too."""
WORTH_A_LOOK: Final = 0.003
"""Share of changed squares from which noise is measured: most pictures have none at all."""
HANGS_TOGETHER: Final = 2
"""Mark of pixels that hang together with the anchor's."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a photograph shows at a quarter of its size.

    Attributes:
        picture: the photograph itself, shape (height, width, 3), uint8, blue-green-red.
        coarse: it at a quarter of its size, in logarithmic code.
        number: of the lamp state that it resembles most, among those of the setup.
        state: that state.
        slow: shape (rows, columns, 3), slow deviation from it in code units, in squares of ``BLOCK`` coarse pixels.
        shift: (x, y) by which the picture lies elsewhere, coarse pixels.
        flat: shape of ``coarse`` with three channels, code units: how it differs from the state, free of ``slow`` and
            of ``shift``.
        even: shape (256,), factor on the evidence for each level of the empty setup's green.
        plant: shape of ``coarse``, 1 where a pixel looks like plant and hangs together with the anchor.
        around: the same shape, 1 in the surroundings of that.
        changed: share of the picture outside ``around`` that differs from the empty setup.
        noise: standard deviation of the evidence where there is no plant.
    """

    picture: Picture
    coarse: Picture
    number: int
    state: LampState
    slow: Float32Array
    shift: Float32Array
    flat: Float32Array
    even: Float32Array
    plant: ByteArray
    around: ByteArray
    changed: float
    noise: float

    @property
    def plant_pixels(self) -> int:
        """How many pixels of the photograph are plant that hangs together with the anchor."""
        return COARSE**2 * int(cv2.countNonZero(self.plant))


class Surveyor:
    """Surveys photographs; keeps nothing from one to the next.

    Args:
        setup: the empty setup.
        camera: anchor and scale, in px of the full picture.
        settings: numbers of the method.

    Raises:
        BadInput: setup and camera disagree on the size, or no pixel is left in the window.

    Attributes:
        box: rows and columns of the picture in which a plant may stand.
    """

    def __init__(self, setup: EmptySetup, camera: CameraSection, settings: PathSettings) -> None:
        size = (camera.width_px, camera.height_px)
        if setup.size_px != size:
            raise BadInput(
                f"the empty setup is known at {setup.size_px[0]}x{setup.size_px[1]} px, pictures are "
                f"{size[0]}x{size[1]} px; make its pictures anew"
            )
        self.box = window_box(camera, settings)
        self._setup, self._camera, self._settings, self._size = setup, camera, settings, size
        self._empty = [_Empty(state) for state in setup.states]
        reach = max(3, round(1.2 * camera.px_per_cm / COARSE) | 1)
        self._disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))

    def survey(self, picture: Picture) -> Survey:
        """The photograph at a quarter of its size, beside the empty setup.

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
        nearest, _ = self._setup.nearest(coarse)
        number = self._setup.states.index(nearest)
        empty = self._empty[number]
        difference = np.asarray(cv2.subtract(coarse, empty.state.coarse, dtype=cv2.CV_16S), dtype=np.int16)
        slow = slow_deviation(difference)
        height, width = coarse.shape[:2]
        spread = enlarged(slow, slice(0, height), slice(0, width), BLOCK)
        flat = np.asarray(cv2.subtract(difference, spread, dtype=cv2.CV_32F), dtype=np.float32)
        shift = empty.shift_of(flat)
        if shift.any():
            flat = moved(flat, empty.gradient, shift)
        score = plant_score(flat)
        even = empty.evened(score)
        score = np.asarray(cv2.multiply(score, cv2.LUT(empty.green, even)), dtype=np.float32)
        noise = noise_of(score)
        mask = (score > max(CLEAR * noise, LEAST_EVIDENCE)).view(np.uint8)
        plant, around = self._surroundings(mask)
        changed = empty.changed(flat, around)
        return Survey(picture, coarse, number, empty.state, slow, shift, flat, even, plant, around, changed, noise)

    def bounds(self, survey: Survey) -> tuple[slice, slice]:
        """Rows and columns of the full picture in which the plant and its surroundings lie; empty where it has none."""
        rows, columns = (np.flatnonzero(survey.around.any(axis=axis)) for axis in (1, 0))
        if rows.size == 0:
            return slice(0, 0), slice(0, 0)
        return (
            slice(max(self.box[0].start, int(rows[0]) * COARSE), min(self.box[0].stop, (int(rows[-1]) + 1) * COARSE)),
            slice(
                max(self.box[1].start, int(columns[0]) * COARSE), min(self.box[1].stop, (int(columns[-1]) + 1) * COARSE)
            ),
        )

    def _surroundings(self, mask: ByteArray) -> tuple[ByteArray, ByteArray]:
        """What hangs together with the anchor, and the pixels near it."""
        px_per_cm = self._camera.px_per_cm / COARSE
        box = np.zeros_like(mask)
        rows, columns = (slice(s.start // COARSE, -(-s.stop // COARSE)) for s in self.box)
        box[rows, columns] = mask[rows, columns]
        near = cv2.dilate(box, self._disc)
        place = nearest_in_window(self._camera, self._settings)
        x, y = (min(round(v / COARSE), size - 1) for v, size in zip(place, mask.shape[::-1], strict=True))
        cv2.circle(near, (x, y), max(2, round(self._settings.hidden_base_cm * px_per_cm)), 1, -1)
        cv2.floodFill(near, None, (x, y), HANGS_TOGETHER)
        around = np.asarray(near == HANGS_TOGETHER, dtype=np.bool_).view(np.uint8)
        plant = np.asarray(cv2.bitwise_and(around, box), dtype=np.uint8)
        if not plant.any():
            around = np.zeros_like(mask)
        return plant, around


class _Empty:
    """The empty setup under one lamp state, with what every survey needs of it."""

    def __init__(self, state: LampState) -> None:
        self.state = state
        self.green = np.ascontiguousarray(state.coarse[..., 1])
        self.gradient = gradient(state.coarse)
        x, y = (np.ascontiguousarray(g[..., 1]) for g in self.gradient)
        self._edges = np.flatnonzero(((np.abs(x) > 4) | (np.abs(y) > 4)) & (self.green < SATURATED))
        self._x, self._y = x.ravel()[self._edges], y.ravel()[self._edges]
        self._step = 256 // LEVELS
        band = (self.green[::SAMPLED, ::SAMPLED] // self._step).ravel()
        self._bands = [np.flatnonzero(band == k) for k in range(LEVELS)]

    def evened(self, score: Float32Array) -> Float32Array:
        """The factor for each level of green, shape (256,), that brings the noise in all bands to one size."""
        sample = score[::SAMPLED, ::SAMPLED].ravel()
        usual = max(0.5, float(median(sample)))
        factors = np.ones(LEVELS, np.float32)
        for k, places in enumerate(self._bands):
            if places.size > LEAST_OF_LEVEL:
                factors[k] = min(1.0, usual / max(1e-3, float(median(sample[places]))))
        return np.interp(np.arange(256), (np.arange(LEVELS) + 0.5) * self._step, factors).astype(np.float32)

    def changed(self, flat: Float32Array, around: ByteArray) -> float:
        """Share of the picture, away from the plant, that is not as the empty setup shows it."""
        height, width = (n // 2 for n in around.shape)
        squares = cv2.resize(flat[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        blue, green, red = (np.abs(squares[..., k]) for k in range(3))
        off = np.maximum(np.maximum(blue, green), red)
        away = around[: 2 * height : 2, : 2 * width : 2] == 0
        count = max(1, int(np.count_nonzero(away)))
        is_changed = away & (off > CHANGED)
        if np.count_nonzero(is_changed) > WORTH_A_LOOK * count:
            band = self.green[: 2 * height : 2, : 2 * width : 2] // self._step
            for k in range(LEVELS):
                usual = off[away & (band == k)]
                if usual.size > LEAST_OF_LEVEL:
                    is_changed &= (band != k) | (off > CHANGED_OVER_NOISE * float(median(usual)))
        return int(np.count_nonzero(is_changed)) / count

    def shift_of(self, flat: Float32Array) -> Float32Array:
        """How far the picture lies from the empty setup, (x, y) in coarse pixels, by least squares on its gradient.

        Lucas and Kanade 1981, over the whole picture at once; what differs by more than edges can is left out.
        """
        off = flat.reshape(-1, 3)[self._edges, 1]
        use = np.abs(off) < 30
        x, y, d = self._x[use], self._y[use], off[use]
        if d.size < 200:
            return np.zeros(2, np.float32)
        normal = np.array([[x @ x, x @ y], [x @ y, y @ y]], dtype=np.float64) + 1e-3 * np.eye(2) * float(x @ x + y @ y)
        shift = -np.linalg.solve(normal, np.array([x @ d, y @ d], dtype=np.float64))
        if not LEAST_SHIFT_PX < np.abs(shift).max() * COARSE < MOST_SHIFT_PX:
            return np.zeros(2, np.float32)
        return shift.astype(np.float32)


def plant_score(difference: Float32Array) -> Float32Array:
    """Evidence of plant from log ratios in blue, green, red; shape (height, width, 3) to (height, width).

    How far the reflectance is from the empty setup's: brighter, of another colour, and a little if it is darker.
    """
    # one plane at a time: taking three apart takes longer than all the rest
    bright, green, yellow = (cv2.transform(difference, axis) for axis in _AXES[:, None])
    bright = cv2.max(bright, -DARK_WEIGHT * np.asarray(bright, dtype=np.float32))
    # not cv2.magnitude: its last digits depend on where in memory the planes lie, and the same pictures must give the
    # same bytes
    square = np.asarray(bright * bright, dtype=np.float32)
    for colour in (green, yellow):
        square += colour * colour
    return np.sqrt(square, out=square)


def noise_of(score: Float32Array) -> float:
    """Standard deviation of the evidence's parts where there is no plant: most of a picture is empty."""
    return max(0.8, float(median(score[::3, ::3].ravel())) / 1.4)


def median(values: Array) -> FloatArray:
    """The median over the last axis, in a tenth of the time that numpy's own takes."""
    ordered = np.sort(values, axis=-1)
    count = ordered.shape[-1]
    low, high = ordered[..., (count - 1) // 2], ordered[..., count // 2]
    return np.asarray(0.5 * (low.astype(np.float64) + high), dtype=np.float64)


def gradient(empty: Picture) -> tuple[Float32Array, Float32Array]:
    """Along x and along y, per pixel, of all channels."""
    x, y = (cv2.Sobel(empty, cv2.CV_32F, *order, ksize=1, scale=0.5) for order in ((1, 0), (0, 1)))
    return np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)


def moved(
    difference: Float32Array, empty_gradient: tuple[Float32Array, Float32Array], shift: Float32Array
) -> Float32Array:
    """The difference of a picture that lies elsewhere by ``shift`` pixels, as if it did not."""
    x, y = empty_gradient
    out = cv2.scaleAdd(y, float(shift[1]), cv2.scaleAdd(x, float(shift[0]), difference))
    return np.asarray(out, dtype=np.float32)


def slow_deviation(difference: Int16Array) -> Float32Array:
    """Medians over squares of the coarse difference, themselves median-filtered; shape (rows, columns, 3).

    A plant fills few of 5 x 5 neighbouring squares, so that it does not enter.
    """
    height, width = difference.shape[:2]
    rows, columns = max(1, height // BLOCK), max(1, width // BLOCK)
    side = min(BLOCK, height, width)
    squares = difference[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)
    squares = squares[:, ::2, :, ::2].transpose(0, 2, 4, 1, 3).reshape(rows, columns, 3, -1)
    medians = median(squares).astype(np.float32)
    return np.stack([cv2.medianBlur(np.ascontiguousarray(medians[..., k]), 5) for k in range(3)], axis=-1)


def enlarged(slow: Float32Array, rows: slice, columns: slice, side: int) -> Float32Array:
    """The slow deviation at pixels of a part of the picture, linear between the middles of squares of a side, px."""
    part, start = slow, []
    for axis, pixels in enumerate((rows, columns)):
        first = max(0, pixels.start // side - 1)
        wanted = np.arange(first, (pixels.stop - 1) // side + 2)
        part = np.take(part, np.minimum(wanted, slow.shape[axis] - 1), axis=axis)
        start.append(pixels.start - first * side)
    large = cv2.resize(part, (part.shape[1] * side, part.shape[0] * side), interpolation=cv2.INTER_LINEAR)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    return np.asarray(large[start[0] : start[0] + height, start[1] : start[1] + width], dtype=np.float32)


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
