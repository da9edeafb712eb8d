"""What the empty setup looks like under each lamp state, for telling a plant from it by ratio.

The published method keeps the smallest and largest green value over all lamp states (:mod:`.setup`); beside a lamp this
interval is so wide that a stem passes through it unseen. Here each lamp state keeps a picture of its own. A photograph
is held against the state that it resembles most, so nobody need say which lamp shone.

Pictures are compared in a logarithmic code: under light ``I`` a surface of reflectance ``r`` gives ``I r``, so that the
difference of two codes is the logarithm of a ratio of reflectances, whatever the lamp's tint and strength.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import cv2
import numpy as np

from flora_common.arrays import Int16Array
from flora_common.errors import BadPicture
from flora_common.vision import still_plant
from flora_common.vision.picture import Picture, checked_array

MadeBy = Literal["background", "frames"]

DARK_LEVEL: Final = 12.0
"""Level (of 255) below which the code turns linear: noise in the dark would otherwise look like contrast."""
CODE_PER_NEPER: Final = 255.0 / float(np.log1p(255.0 / DARK_LEVEL))
COARSE: Final = 4
"""The first look at a picture is at this fraction of its size."""
SAME_STATE: Final = 1.0
"""Mean difference in code units, noise and exposure taken away, up to which two empty pictures show one lamp state."""
MOST_STATES: Final = 8
LEAST_FRAMES: Final = 5
MOVES: Final = 30.0
"""In code units: where the most plant-like of the frames stand out by this, a plant comes and goes."""
_BAND_ROWS: Final = 64

_TABLE: Final = np.round(CODE_PER_NEPER * np.log1p(np.arange(256) / DARK_LEVEL)).astype(np.uint8)


def log_code(picture: Picture) -> Picture:
    """Levels in logarithmic code, ``255 ln(1 + v/12) / ln(1 + 255/12)``; same shape, uint8."""
    return np.asarray(cv2.LUT(picture, _TABLE), dtype=np.uint8)


def coarse_code(picture: Picture) -> Picture:
    """The picture at a quarter of its size, in logarithmic code."""
    size = (max(1, picture.shape[1] // COARSE), max(1, picture.shape[0] // COARSE))
    return log_code(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8))


@dataclass(frozen=True, eq=False)
class LampState:
    """The empty setup under one lamp state.

    Attributes:
        code: shape (height, width, 3), full size, logarithmic code.
        coarse: the same at a quarter of the size.
        pictures: how many went in.
    """

    code: Picture
    coarse: Picture
    pictures: int

    @cached_property
    def small(self) -> Int16Array:
        """A sixteenth of the size, to compare lamp states by."""
        return _smaller(self.coarse)


class EmptySetup:
    """All lamp states of a setup.

    Args:
        states: at least one, of one size.
        made_by: ``background`` (pictures without a plant) or ``frames`` (learnt from the plant's own pictures).

    Attributes:
        states, made_by: as given.
        size_px: (width, height) of the pictures.

    Raises:
        BadPicture: no states.
    """

    def __init__(self, states: Sequence[LampState], made_by: MadeBy) -> None:
        if not states:
            raise BadPicture("no background pictures; take some of the setup without a plant, in every lamp state")
        self.states = tuple(states)
        self.made_by: MadeBy = made_by
        self.size_px = (states[0].code.shape[1], states[0].code.shape[0])

    @property
    def pictures(self) -> int:
        """How many pictures went in, over all states."""
        return sum(state.pictures for state in self.states)

    def nearest(self, coarse: Picture) -> tuple[LampState, float]:
        """The state that a picture, through :func:`coarse_code`, resembles most, and how far it is from it.

        The second is a mean difference in code units, noise and exposure taken away; see :data:`SAME_STATE`.
        """
        small = _smaller(coarse)
        sizes = [_mean_size(small, state.small) for state in self.states]
        nearest = int(np.argmin(sizes))
        return self.states[nearest], sizes[nearest]


def from_background(pictures: Iterable[Picture]) -> EmptySetup:
    """Lamp states from pictures of the setup without a plant; pictures that look alike are averaged.

    Args:
        pictures: at least one, all of one size, full resolution, in any order.

    Raises:
        BadPicture: none at all, or of different sizes.
    """
    groups: list[_Group] = []
    for number, picture in enumerate(pictures, start=1):
        checked_array(picture, where=f"background picture {number}")
        if groups and picture.shape != groups[0].shape:
            raise BadPicture(
                f"background picture {number}: {picture.shape[1]}x{picture.shape[0]} px, "
                f"the first has {groups[0].shape[1]}x{groups[0].shape[0]}"
            )
        coarse = coarse_code(picture)
        small = _smaller(coarse)
        sizes = [_mean_size(small, _smaller(group.coarse)) for group in groups]
        nearest = int(np.argmin(sizes)) if sizes else -1
        if sizes and (sizes[nearest] < SAME_STATE or len(groups) == MOST_STATES):
            groups[nearest].add(picture)
        else:
            groups.append(_Group(picture, coarse))
    return EmptySetup([group.state() for group in groups], "background")


def from_frames(frames: Sequence[Picture], *, anchor_px: tuple[float, float], widest_px: float) -> LampState:
    """A lamp state from pictures that show the plant, all taken under it.

    At each pixel the frames are put in order of how plant-like they are, and the least plant-like but few are averaged:
    a place shows what it looks like empty as soon as the plant is away from it in a quarter of the frames. The foot of
    a stem never is: it is told by where it leads (:mod:`.still_plant`), and its surroundings are put in its place.

    Args:
        frames: at least 5, all of one size, full resolution, spread over the whole stretch of time.
        anchor_px: where the stem leaves the soil.
        widest_px: no stem is wider.

    Raises:
        BadPicture: too few frames, or of different sizes.
    """
    if len(frames) < LEAST_FRAMES:
        raise BadPicture(
            f"{len(frames)} frames are too few to learn the empty setup from; {LEAST_FRAMES} at least, or take "
            "background pictures"
        )
    for number, frame in enumerate(frames):
        checked_array(frame, where=f"frame {number}")
        if frame.shape != frames[0].shape:
            raise BadPicture(
                f"frame {number}: {frame.shape[1]}x{frame.shape[0]} px, the first has "
                f"{frames[0].shape[1]}x{frames[0].shape[0]}"
            )
    empty = np.empty_like(frames[0])
    moves = np.empty(empty.shape[:2], np.uint8)
    last = len(frames) - 1
    low, high, most = round(0.05 * last), max(1, round(0.25 * last)), round(0.95 * last)
    for top in range(0, empty.shape[0], _BAND_ROWS):
        rows = slice(top, top + _BAND_ROWS)
        band = np.stack([log_code(frame[rows]) for frame in frames])
        likeness = still_plant.greenness(band) + band.sum(axis=-1, dtype=np.float32) / 9.0
        order = np.argsort(likeness, axis=0, kind="stable")
        empty[rows] = np.rint(np.take_along_axis(band, order[low : high + 1, ..., None], axis=0).mean(axis=0))
        spread = np.take_along_axis(likeness, order[[high, most]], axis=0)
        moves[rows] = (spread[1] - spread[0]) > MOVES
    still_plant.replace(empty, np.asarray(cv2.medianBlur(moves, 5), dtype=np.uint8), anchor_px, widest_px)
    size = (max(1, empty.shape[1] // COARSE), max(1, empty.shape[0] // COARSE))
    return LampState(empty, np.asarray(cv2.resize(empty, size), dtype=np.uint8), len(frames))


class _Group:
    """Pictures of one lamp state; sums, so that averaging needs no memory per picture."""

    def __init__(self, picture: Picture, coarse: Picture) -> None:
        self.coarse = coarse
        self.shape = picture.shape
        self._sum = log_code(picture).astype(np.uint16)
        self._count = 1

    def add(self, picture: Picture) -> None:
        if self._count < 255:  # more would overflow the sums and tell nothing new
            self._sum += log_code(picture)
            self._count += 1

    def state(self) -> LampState:
        mean = ((self._sum + self._count // 2) // self._count).astype(np.uint8)
        size = (self.coarse.shape[1], self.coarse.shape[0])
        coarse = np.asarray(cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        return LampState(mean, coarse, self._count)


def _smaller(coarse: Picture) -> Int16Array:
    """A quarter of the coarse size, eight times the code, in which noise has nearly gone; shape (3, pixels)."""
    size = (max(1, coarse.shape[1] // 4), max(1, coarse.shape[0] // 4))
    # whole squares of four by four are averaged in half the time
    whole = coarse[: max(1, 4 * (coarse.shape[0] // 4)), : max(1, 4 * (coarse.shape[1] // 4))]
    small = cv2.resize(whole.astype(np.int16) * 8, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.reshape(-1, 3).T, dtype=np.int16)


def _mean_size(small: Int16Array, other: Int16Array) -> float:
    """Mean absolute difference in code units, exposure taken away; a plant, which is very different, counts little."""
    difference = small - other
    some = np.sort(difference[:, ::2], axis=1)
    difference -= some[:, some.shape[1] // 2, None]
    # numpy sums small integers faster than it takes their mean
    return int(np.minimum(np.abs(difference), 8 * 24).sum(dtype=np.int64)) / (8.0 * difference.size)
