"""How much each pixel looks like plant.

A part of a photograph is divided by the empty setup under the same lamps (in logarithmic code, :mod:`..lamp_states`),
and by its own slow deviations from it, both as :mod:`.survey` found them. What is left is the ratio of two
reflectances per channel, free of the lamp's tint. Plant is brighter than the board, greener, or yellower; a shadow is
only darker.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Float32Array, FloatArray
from flora_common.vision.lamp_states import COARSE, log_code
from flora_common.vision.path.survey import (
    BLOCK,
    CLEAR,
    LEAST_EVIDENCE,
    Survey,
    Surveyor,
    enlarged,
    gradient,
    moved,
    noise_of,
    plant_score,
)
from flora_common.vision.picture import Picture

SMOOTHING_PX: Final = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The part of a picture in which the plant stands.

    Attributes:
        origin_px: place (x, y) of its first pixel in the full picture.
        plant: shape (height, width), 0 where there is none; in units of the logarithmic code.
        code: shape (height, width, 3), the picture itself in logarithmic code, a little smoothed: its brightness and
            colour tell a stem from a leaf that it crosses.
        noise: standard deviation of ``plant`` on the empty setup.
        lamps: number of the lamp state that the whole picture resembles most.
        changed: share of the whole picture outside the plant's surroundings that differs from the empty setup.
        plant_pixels: how many pixels of the whole picture are plant that hangs together with the anchor.
    """

    origin_px: tuple[int, int]
    plant: Float32Array
    code: Picture
    noise: float
    lamps: int = 0
    changed: float = 0.0
    plant_pixels: int = 0

    @property
    def empty(self) -> bool:
        return self.plant.size == 0

    def cut(self, middle_px: FloatArray, reach_px: float) -> Evidence:
        """The part of it that lies about a place (x, y), px of the full picture; never empty where this is not."""
        x, y = middle_px - np.array(self.origin_px)
        height, width = self.plant.shape
        columns, rows = (
            slice(min(max(0, round(at - reach_px)), size - 1), max(1, min(size, round(at + reach_px) + 1)))
            for at, size in ((x, width), (y, height))
        )
        origin = self.origin_px[0] + columns.start, self.origin_px[1] + rows.start
        return replace(self, origin_px=origin, plant=self.plant[rows, columns], code=self.code[rows, columns])

    def mirrored(self) -> Evidence:
        """The same with its sides exchanged, in the same place."""
        return replace(
            self, plant=np.ascontiguousarray(self.plant[:, ::-1]), code=np.ascontiguousarray(self.code[:, ::-1])
        )

    def mirrored_px(self, places_px: FloatArray) -> FloatArray:
        """Where places (..., 2), px of the full picture, are once it is mirrored."""
        middle = np.array([2.0 * self.origin_px[0] + self.plant.shape[1] - 1.0, 0.0])
        return np.asarray(middle + places_px * [-1.0, 1.0], dtype=np.float64)

    @property
    def least(self) -> float:
        """What has less evidence than this is noise."""
        return max(CLEAR * self.noise, LEAST_EVIDENCE)

    @property
    def tone(self) -> Float32Array:
        """Brightness of the picture, shape (height, width)."""
        return np.asarray(cv2.transform(self.code, np.full((1, 3), 1 / 3)), dtype=np.float32)


class PlantFinder(Surveyor):
    """Turns photographs into evidence, after a survey of each; made as a surveyor is."""

    def find(self, picture: Picture) -> Evidence:
        """Evidence of the plant that stands at the anchor; arguments and errors as in :meth:`survey`."""
        return self.all_of(self.survey(picture))

    def all_of(self, survey: Survey) -> Evidence:
        """Evidence of the plant that stands at the anchor, wherever it is in the picture."""
        return self.part(survey, *self.bounds(survey))

    def part(self, survey: Survey, rows: slice, columns: slice, noise: float | None = None) -> Evidence:
        """Evidence in a part of the full picture; its noise is measured there where none is given."""
        if rows.start >= rows.stop or columns.start >= columns.stop:
            nothing = np.zeros((0, 0), np.float32)
            code = np.zeros((0, 0, 3), np.uint8)
            return Evidence((0, 0), nothing, code, survey.noise, survey.number, survey.changed, survey.plant_pixels)
        code, empty = log_code(survey.picture[rows, columns]), survey.state.code[rows, columns]
        slow = enlarged(survey.slow, rows, columns, BLOCK * COARSE)
        fine = np.asarray(cv2.subtract(cv2.subtract(code, empty, dtype=cv2.CV_32F), slow), dtype=np.float32)
        if survey.shift.any():
            fine = moved(fine, gradient(empty), survey.shift * COARSE)
        score = plant_score(np.asarray(cv2.GaussianBlur(fine, (0, 0), SMOOTHING_PX), dtype=np.float32))
        score *= np.asarray(cv2.LUT(np.ascontiguousarray(empty[..., 1]), survey.even), dtype=np.float32)
        if noise is None:
            noise = noise_of(score)
        code = np.asarray(cv2.GaussianBlur(code, (0, 0), 1.0), dtype=np.uint8)
        origin = columns.start, rows.start
        found = Evidence(origin, score, code, noise, survey.number, survey.changed, survey.plant_pixels)
        _, over = cv2.threshold(score, found.least, 0.0, cv2.THRESH_TOZERO)
        return replace(found, plant=np.asarray(over, dtype=np.float32))
