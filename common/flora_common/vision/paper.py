"""The published way from a photograph to a ten-point stem.

Source: Wahby et al. 2018, "A Robot to Shape your Natural Plant", section "Stem motion tracking", step by step; the
names L, H, R, P, theta_1, theta_2, a, c, h, g and S are the paper's. Inside, positions are px of the full picture with
y down, a pixel's centre at whole numbers (as OpenCV draws); results are cm with y up and the anchor at (0, 0).

Where the text leaves a choice, this is what is done here:

- *Resolution.* The paper samples a 3280 px wide picture at 1/8, hence at 410 px. Pictures here are 1640 px wide, so the
  same sampling is a reduction by 4.
- *theta_2 = 30 px* is taken in px of the 3280 px picture and scaled to the picture at hand. There, 30 px are about
  8 mm and a bean of 20 cm has its ten heights 22 mm apart: every band stands for its own height. Taken in px of the
  reduced picture it would be a band of 13 cm, two thirds of that bean in each of its points.
- *Heights.* As printed, y(i) = y_a + i/9 |y_a - y_g| for i = 2…9 puts point 9 on the height of the tip, which is
  point 10, and leaves a double step at the base. "Evenly distributed between the tip and anchor" needs (i - 1)/9.
- *First frame.* There is no earlier tip; the anchor stands in for it, for that is where a seedling appears.
- *Ties.* The largest distance is often shared by several pixels, such as the top row of a stem. The middle one in x is
  taken: the first one found would lie half a stem's width to the left.
- *A height without pixels* within theta_2 has no mean. Its x is interpolated in height between the nearest heights
  that have one (anchor and tip always do), and the quality is lower for it.
- *Window.* Soil and pot lie below the anchor and are never stem: the window always ends above the anchor's height.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import cv2
import msgspec
import numpy as np

from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection, Px
from flora_common.shapes import STEM_POINTS
from flora_common.vision.picture import Picture, Reduction, checked_array, full_px, reduced_size
from flora_common.vision.reading import JUMPED, OK, TOUCHES_EDGE, PictureOutcome, StemReading, no_stem
from flora_common.vision.setup import SetupMatrices, green

# Green values are whole 255ths held as float32: 51/255 against theta_1 = 0.2 must come out as a tie, not by rounding.
_TIE: Final = 1e-6


class PaperSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Every number of the method; the defaults are the published ones.

    Attributes:
        theta_1: how far outside [L, H] a green value must lie to be plant, 0..1.
        theta_2_px: half height of the band whose pixels are averaged, in px of a picture ``reference_width_px`` wide.
        reference_width_px: width of the picture that ``theta_2_px`` speaks of; set it to the camera's own width to
            give ``theta_2_px`` in its px.
        reduction: pictures are looked at in 1/reduction of their size; 4 for 1640 px, 8 for 3280 px.
        window_px: region of interest (x0, y0, x1, y1) in px of the full picture, edges included; all if left out.
        smallest_component_px: connected groups of fewer stem pixels (8 neighbours, reduced picture) are dropped before
            the tip is looked for. Not in the published method, hence off (0). It keeps single noisy pixels from being
            taken for the tip, and loses a thin stem that is broken into pieces.
        jump_cm: a tip farther than this from the one before is reported as ``jumped``. The stem is given all the same.
    """

    theta_1: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.2
    theta_2_px: Annotated[float, msgspec.Meta(gt=0.0, le=20_000.0)] = 30.0
    reference_width_px: Annotated[int, msgspec.Meta(ge=16, le=20_000)] = 3280
    reduction: Reduction = 4
    window_px: tuple[Px, Px, Px, Px] | None = None
    smallest_component_px: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    jump_cm: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] = 3.0


class PaperTracker:
    """The method over a sequence of pictures; its only memory is the previous tip.

    Args:
        setup: L and H at the reduced resolution.
        camera: anchor and scale, in px of the full picture.
        settings: the numbers of the method.

    Attributes:
        tip_px: previous tip in px of the full picture, or None. May be set, to go on from a stored reading.

    Raises:
        BadInput: the window holds no pixel above the anchor, or ``setup`` belongs to another picture size.
    """

    def __init__(self, setup: SetupMatrices, camera: CameraSection, settings: PaperSettings | None = None) -> None:
        self.settings = settings if settings is not None else PaperSettings()
        self.camera = camera
        self.tip_px: tuple[float, float] | None = None
        self._size = reduced_size((camera.width_px, camera.height_px), self.settings.reduction)
        self._x_px, self._y_px = (full_px(np.arange(n, dtype=np.float64), self.settings.reduction) for n in self._size)
        self._window = self._window_slices()
        self._theta_2 = self.settings.theta_2_px * camera.width_px / self.settings.reference_width_px
        self.set_setup(setup)

    def set_setup(self, setup: SetupMatrices) -> None:
        """Use other setup matrices from now on (where each lamp state has its own).

        Raises:
            BadInput: they belong to another picture size.
        """
        if setup.size_px != self._size:
            raise BadInput(
                f"setup matrices are for {setup.size_px[0]}x{setup.size_px[1]} px, pictures are "
                f"{self._size[0]}x{self._size[1]} px at 1/{self.settings.reduction}; make the setup matrices anew"
            )
        self.setup = setup

    def stem_mask(self, picture: Picture) -> BoolArray:
        """The set P as a mask over the reduced picture, window and component guard applied.

        Raises:
            BadPicture: not an 8-bit colour picture of the size of the setup matrices.
        """
        checked_array(picture, where="picture")
        if (picture.shape[1], picture.shape[0]) != self._size:
            raise BadPicture(
                f"picture is {picture.shape[1]}x{picture.shape[0]} px, expected {self._size[0]}x{self._size[1]}"
            )
        rows, columns = self._window
        mask = np.zeros(picture.shape[:2], dtype=np.bool_)
        mask[rows, columns] = outside_setup(
            green(picture[rows, columns]),
            self.setup.L[rows, columns],
            self.setup.H[rows, columns],
            self.settings.theta_1,
        )
        if self.settings.smallest_component_px > 1:
            mask = drop_small_components(mask, self.settings.smallest_component_px)
        return mask

    def read(self, picture: Picture) -> StemReading:
        """The stem in one picture, which must follow the one read before.

        Args:
            picture: shape (height, width, 3), uint8, blue-green-red, already at 1/reduction of the full size.

        Raises:
            BadPicture: not an 8-bit colour picture of the size of the setup matrices. The memory is unchanged.
        """
        row, column = np.nonzero(self.stem_mask(picture))
        if row.size == 0:
            return no_stem("no pixel in the window differs from the empty setup")
        x, y = self._x_px[column], self._y_px[row]
        anchor = (float(self.camera.anchor_px[0]), float(self.camera.anchor_px[1]))
        previous = self.tip_px
        index, choice = choose_tip(x, y, anchor, previous if previous is not None else anchor)
        tip = (float(x[index]), float(y[index]))
        raw, seen = ten_points(x, y, anchor, tip, self._theta_2)
        # Adding zero turns the anchor's -0.0 into 0.0, which reads better in tables.
        points_cm = (smooth(raw) - raw[0]) * np.array([1.0, -1.0]) / self.camera.px_per_cm + 0.0
        outcome, reason = self._judge(int(row[index]), int(column[index]), tip, previous)
        self.tip_px = tip
        return StemReading(
            outcome,
            float(seen.mean()),
            points_cm,
            tip,
            reason,
            stem_pixels=int(row.size),
            tip_choice=choice,
        )

    def _judge(
        self, row: int, column: int, tip: tuple[float, float], previous: tuple[float, float] | None
    ) -> tuple[PictureOutcome, str]:
        rows, columns = self._window
        if row == rows.start or column in (columns.start, columns.stop - 1):
            return TOUCHES_EDGE, "the tip lies on the edge of the window, the plant may go on beyond it"
        if previous is not None:
            moved_cm = math.dist(tip, previous) / self.camera.px_per_cm
            if moved_cm > self.settings.jump_cm:
                return JUMPED, f"the tip is {moved_cm:.1f} cm from the one before"
        return OK, ""

    def _window_slices(self) -> tuple[slice, slice]:
        """Rows and columns of the reduced picture whose centres lie in the window and above the anchor."""
        x0, y0, x1, y1 = self.settings.window_px or (-math.inf, -math.inf, math.inf, math.inf)
        columns = np.flatnonzero((self._x_px >= x0) & (self._x_px <= x1))
        rows = np.flatnonzero((self._y_px >= y0) & (self._y_px <= y1) & (self._y_px < self.camera.anchor_px[1]))
        if rows.size == 0 or columns.size == 0:
            ax, ay = self.camera.anchor_px
            size = f"{self.camera.width_px}x{self.camera.height_px}"
            raise BadInput(
                f"no pixel of the {size} px picture lies both in the window and above the anchor ({ax:g}, {ay:g}); "
                "correct anchor or window"
            )
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def outside_setup(R: Float32Array, L: Float32Array, H: Float32Array, theta_1: float) -> BoolArray:
    """Where (R < L - theta_1) or (R > H + theta_1), all in [0, 1]; on the limit itself is not outside."""
    outside: BoolArray = (L - (theta_1 + _TIE) > R) | (H + (theta_1 + _TIE) < R)
    return outside


def drop_small_components(mask: BoolArray, smallest_px: int) -> BoolArray:
    """The mask without its 8-connected groups of fewer than ``smallest_px`` pixels."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    keep = statistics[:, cv2.CC_STAT_AREA] >= smallest_px
    keep[0] = False  # label 0 is everything that is not stem
    kept: BoolArray = keep[labels]
    return kept


def choose_tip(
    x: FloatArray, y: FloatArray, anchor: tuple[float, float], previous: tuple[float, float]
) -> tuple[int, Literal["c", "h"]]:
    """Index of the tip g among the stem pixels, and which of the two candidates it is.

    c maximises |x_a - x| + |y_a - y|, h maximises |y_a - y|; h is taken if it is nearer to the previous tip, else c.
    """
    rise = np.abs(anchor[1] - y)
    c = _middle_of_largest(np.abs(anchor[0] - x) + rise, x)
    h = _middle_of_largest(rise, x)
    if math.dist(previous, (x[h], y[h])) < math.dist(previous, (x[c], y[c])):
        return h, "h"
    return c, "c"


def ten_points(
    x: FloatArray, y: FloatArray, anchor: tuple[float, float], tip: tuple[float, float], theta_2: float
) -> tuple[FloatArray, BoolArray]:
    """The stem description S before smoothing.

    Args:
        x, y: the set P, shape (n,), px.
        anchor, tip: px.
        theta_2: half height of the band that is averaged, px.

    Returns:
        Points of shape (10, 2) in px, anchor first and tip last; and of shape (10,), which heights have pixels of P
        within theta_2. The others (anchor and tip apart) are interpolated.
    """
    height = np.linspace(anchor[1], tip[1], STEM_POINTS)
    near = np.abs(y[None, :] - height[:, None]) < theta_2
    count = near.sum(axis=1)
    mean_x: FloatArray = np.asarray(near @ x, dtype=np.float64) / np.maximum(count, 1)
    seen: BoolArray = count > 0
    mean_x[0], mean_x[-1] = anchor[0], tip[0]
    known = seen.copy()
    known[0] = known[-1] = True
    places = np.arange(STEM_POINTS)
    mean_x[~known] = np.interp(places[~known], places[known], mean_x[known])
    return np.column_stack([mean_x, height]), seen


def smooth(points: FloatArray) -> FloatArray:
    """Smoothing via iterative averaging: each point becomes the mean of its two neighbours.

    Three passes, over points 2, 4, 6, 8, then 3, 5, 7, 9, then 2, 4, 6, 8 (numbered from 1); anchor and tip stay.
    Within a pass no point is another's neighbour, so their order does not matter.

    Args:
        points: shape (10, 2), any unit.
    """
    out = np.array(points, dtype=np.float64)
    for first in (1, 2, 1):
        inner = np.arange(first, STEM_POINTS - 1, 2)
        out[inner] = 0.5 * (out[inner - 1] + out[inner + 1])
    return out


def _middle_of_largest(value: FloatArray, x: FloatArray) -> int:
    tied = np.flatnonzero(value >= value.max() - _TIE)
    by_x = tied[np.argsort(x[tied], kind="stable")]
    return int(by_x[(by_x.size - 1) // 2])
