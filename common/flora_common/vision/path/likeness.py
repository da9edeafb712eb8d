"""Whether a picture shows the setup at all: black, blurred, foreign, moved or torn pictures do not.

The evidence of plant is freed of slow deviations from the empty setup, and so a picture of nothing, or one that has
moved by a centimetre, still leaves shapes that may pass for a stem. But the fine structure of the board, of lamps, pot
and rim is then gone from its place. So the structure of the picture is held against that of the empty setup, square
by square, where the setup has most of it: the correlation says whether it is the same, the gain whether it is as clear.
Noise is no structure: a bare board in a dim box has none to go by, and is not held against any picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, Float32Array
from flora_common.vision.lamp_states import COARSE, EmptySetup
from flora_common.vision.path.survey import Survey, median
from flora_common.vision.picture import Picture

REDUCED: Final = 2 * COARSE
FINE, BROAD = 1.0, 4.0
"""Structure is what lies between these two, standard deviations in px of the reduced picture."""
MOST_SIDE, LEAST_SIDE, ACROSS = 16, 6, 9
"""Of the squares, px of the reduced picture: so many across its shorter side, where that is not too many or too few."""
TELLING: Final = 0.35
"""Share of the squares that is looked at: those with most structure. In the others there is noise."""
LEAST_STRUCTURE: Final = 0.5
"""Standard deviation in code units: a setup with less has none to go by."""
GRAIN: Final = 0.7
"""What is finer than this standard deviation, px, is taken for noise; edges have little of it."""
NOISE_PASSES: Final = 0.127
"""Of white noise: its power between ``FINE`` and ``BROAD``, over its power below ``GRAIN`` (from the kernels)."""
OVER_NOISE: Final = 4.0
"""Power of a telling square, over that of the noise in it."""
MOST_NOISE: Final = 0.9
"""Share of a square's power that is put down to noise at most."""
LEAST_SQUARES: Final = 6
FEW_SQUARES, LEAST_SHOWN = 24, 3
"""So few have structure before a plain board that a plant may hide most of them: what it hides is not asked for, where
as many as the second are left."""
CLIP: Final = 40.0
BANDS, LEAST_OF_BAND = 5, 4
"""Level bands that a picture is cut into, and how many telling squares one needs to be judged by itself."""
SAME: Final = 0.5
"""Correlation from which a square counts as the setup's."""
SEARCHED: Final = 13
"""So far the setup is looked for in either direction, px of the reduced picture."""
FOUND, BETTER = 0.5, 1.2
"""Correlation from which the whole of it is found there, and how many times less it lacks there than where it was."""


@dataclass(frozen=True, slots=True)
class Likeness:
    """How much of the empty setup's structure a picture has.

    Attributes:
        correlation: median over the squares, -1..1.
        gain: median over the squares of how strong the structure is; 1 as in the empty setup, less where it is blurred.
        elsewhere: share of the squares that show something else.
        worst_band: the lowest median of the correlation over a level band of the picture. A JPEG file whose bits were
            flipped goes on moved, or tinted, from a row on.
        uneven: the largest step of the slow deviation from the setup, code units from one square to the next. Flash,
            exposure and lamps change little from one to the next; an arm, or fog, does.
        moved: how far the setup lies from where it was, in widths of the picture, by where its structure fits best; 0
            where it is not found. One pole, or a shelf, is like itself wherever it is moved along its length, so that
            squares tell less of this than the whole does.
    """

    correlation: float = 1.0
    gain: float = 1.0
    elsewhere: float = 0.0
    worst_band: float = 1.0
    uneven: float = 0.0
    moved: float = 0.0


@dataclass(frozen=True, slots=True)
class Demands:
    """What a picture must at least have in common with the empty setup, and at most may not.

    Attributes:
        changed: share of the picture away from the plant that differs.
        correlation, worst_band, gain, elsewhere, uneven, moved: as in :class:`Likeness`.
    """

    changed: float
    correlation: float
    worst_band: float
    gain: float
    elsewhere: float
    uneven: float = math.inf
    moved: float = 0.0025

    def unmet(self, changed: float, likeness: Likeness) -> str:
        """Why a picture shows nothing that could be believed, one clause; empty where it does."""
        if likeness.moved > self.moved:
            return (
                f"the camera has moved by {likeness.moved:.1%} of the picture's width; put it back, or take background "
                "pictures anew"
            )
        if changed > self.changed:
            return f"{changed:.1%} of the picture differ from the empty setup; light, exposure or camera changed"
        if likeness.elsewhere > self.elsewhere:
            return (
                f"{likeness.elsewhere:.0%} of the setup cannot be recognised; camera moved, or the picture is damaged"
            )
        if likeness.correlation < self.correlation:
            return (
                f"the setup looks by {1.0 - likeness.correlation:.0%} otherwise than in the background pictures; "
                "camera or lamps moved, or the picture is damaged"
            )
        if likeness.worst_band < self.worst_band:
            return "part of the setup cannot be recognised; something stands before it, or the picture is torn"
        if likeness.gain < self.gain:
            return f"fine detail has {likeness.gain:.0%} of its contrast; dark, blurred or fogged"
        if likeness.uneven > self.uneven:
            return "part of the picture is lighter or darker than the empty setup; something large stands before it"
        return ""


USUAL: Final = Demands(changed=0.01, correlation=0.85, worst_band=0.75, gain=0.68, elsewhere=0.25)
OF_THE_FIRST: Final = Demands(changed=0.006, correlation=0.93, worst_band=0.85, gain=0.85, elsewhere=0.15, uneven=14.0)
OF_FRAMES: Final = Demands(changed=0.15, correlation=-1.0, worst_band=-1.0, gain=0.0, elsewhere=1.0)
"""A setup learnt from the plant's own pictures has ghosts of it."""


_Telling = tuple[npt.NDArray[np.intp], Float32Array, Float32Array, Float32Array]
"""Of a lamp state: which squares have structure, their structure, its power, and the structure of the whole."""


class SetupLikeness:
    """Holds pictures against the empty setup.

    Args:
        setup: its lamp states.
        anchor_y_px: where the plant stands. Below, leaves may hang before the pot, and are not looked for.
    """

    def __init__(self, setup: EmptySetup, anchor_y_px: float) -> None:
        self._states: list[_Telling | None] = []
        for state in setup.states:
            whole, grain = _structure(state.coarse)
            squares, noise = _squares(whole), _noise(grain)
            power = (squares**2).mean(axis=1)
            order = np.argsort(-power, kind="stable")[: max(LEAST_SQUARES, round(TELLING * len(power)))]
            order = order[power[order] > np.maximum(LEAST_STRUCTURE**2, OVER_NOISE * noise[order])]
            known = len(order) >= LEAST_SQUARES
            self._states.append((order, squares[order], power[order], whole) if known else None)
        width, height = setup.size_px
        self._side, self._rows, self._columns = _grid(max(1, height // REDUCED), max(1, width // REDUCED))
        self._rows_above = int(anchor_y_px // (self._side * REDUCED))

    def of(self, survey: Survey) -> Likeness:
        """Likeness to the lamp state that the survey tells, where that is great; else to the one that is most like it.

        Full likeness where the setup has no structure.
        """
        whole, grain = _structure(survey.coarse)
        squares, noise = _squares(whole), _noise(grain)
        hidden = self._hidden(survey)
        likely = self._one(survey.number, squares, noise, hidden)
        if likely is None or OF_THE_FIRST.unmet(0.0, likely):
            all_states = (self._one(number, squares, noise, hidden) for number in range(len(self._states)))
            # most squares look alike under either lamp: those that differ tell the state, but a plant hides some
            likely = max(
                (one for one in all_states if one is not None),
                key=lambda one: (not USUAL.unmet(0.0, one), one.correlation + one.worst_band - one.elsewhere),
                default=Likeness(),
            )
        telling = self._states[survey.number]
        moved = _distance(telling[3], whole) if telling is not None else 0.0
        return replace(likely, uneven=_largest_step(survey.slow), moved=moved)

    def _one(self, number: int, squares: Float32Array, noise: Float32Array, hidden: BoolArray) -> Likeness | None:
        """Likeness to one lamp state; None where that has no structure."""
        telling = self._states[number]
        if telling is None:
            return None
        order, empty, power, _ = telling
        shown = ~hidden[order]
        if len(order) < FEW_SQUARES and np.count_nonzero(shown) >= LEAST_SHOWN:
            order, empty, power = order[shown], empty[shown], power[shown]
        here = squares[order]
        common = (here * empty).mean(axis=1)
        own = (here**2).mean(axis=1)
        own -= np.minimum(noise[order], MOST_NOISE * own)
        correlation = np.minimum(1.0, common / np.sqrt(own * power + 1e-6))
        bare = ~hidden[order] & (order // self._columns < self._rows_above)
        return Likeness(
            float(median(correlation)),
            float(median(common / power)),
            float((correlation < SAME).mean()),
            self._worst_band(correlation[bare], order[bare]),
        )

    def _hidden(self, survey: Survey) -> BoolArray:
        """For each square, whether plant stands before it."""
        out = np.zeros((self._rows, self._columns), dtype=np.bool_)
        y, x = np.nonzero(survey.plant[::2, ::2])
        row, column = y // self._side, x // self._side
        inside = (row < self._rows) & (column < self._columns)
        out[row[inside], column[inside]] = True
        return out.ravel()

    def _worst_band(self, correlation: Float32Array, order: npt.NDArray[np.intp]) -> float:
        band = (order // self._columns) * BANDS // self._rows
        worst = 1.0
        for k in range(BANDS):
            some = correlation[band == k]
            if some.size >= LEAST_OF_BAND:
                worst = min(worst, float(median(some)))
        return worst


def _largest_step(slow: Float32Array) -> float:
    """From one square to the next one beside or below it, in any channel; shape (rows, columns, 3)."""
    steps = (np.abs(np.diff(slow, axis=axis)) for axis in (0, 1))
    return max(float(step.max(initial=0.0)) for step in steps)


def _distance(empty: Float32Array, here: Float32Array) -> float:
    """How far a picture's structure lies from the empty setup's, in its widths; 0 where it is not found."""
    margins = cv2.copyMakeBorder(empty, *(4 * (SEARCHED,)), cv2.BORDER_CONSTANT, value=0.0)
    likeness = np.asarray(cv2.matchTemplate(margins, here, cv2.TM_CCORR_NORMED), dtype=np.float32)
    _, most, _, (x, y) = cv2.minMaxLoc(likeness)
    if most < FOUND or 1.0 - float(likeness[SEARCHED, SEARCHED]) < BETTER * (1.0 - most):
        return 0.0
    return math.hypot(_peak(likeness[y], x) - SEARCHED, _peak(likeness[:, x], y) - SEARCHED) / int(here.shape[1])


def _peak(values: Float32Array, greatest: int) -> float:
    """Where a parabola through the greatest value and its neighbours is greatest."""
    if not 0 < greatest < len(values) - 1:
        return float(greatest)
    before, here, after = (float(v) for v in values[greatest - 1 : greatest + 2])
    bend = before - 2.0 * here + after
    return greatest + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)


def _structure(coarse: Picture) -> tuple[Float32Array, Float32Array]:
    """Of the picture reduced once more: its structure, and what is finer, which noise is."""
    half = (max(1, coarse.shape[1] // 2), max(1, coarse.shape[0] // 2))
    grey = cv2.resize(np.ascontiguousarray(coarse[..., 1]), half, interpolation=cv2.INTER_AREA).astype(np.float32)
    fine = cv2.GaussianBlur(grey, (0, 0), FINE) - cv2.GaussianBlur(grey, (0, 0), BROAD)
    return np.clip(fine, -CLIP, CLIP), grey - cv2.GaussianBlur(grey, (0, 0), GRAIN)


def _noise(grain: Float32Array) -> Float32Array:
    """The power of noise among the structure of each square."""
    return np.asarray(NOISE_PASSES * (_squares(grain) ** 2).mean(axis=1), dtype=np.float32)


def _grid(height: int, width: int) -> tuple[int, int, int]:
    """Side of the squares, px of the reduced picture, and how many rows and columns of them there are."""
    side = min(height, width, int(np.clip(min(height, width) // ACROSS, LEAST_SIDE, MOST_SIDE)))
    return side, height // side, width // side


def _squares(structure: Float32Array) -> Float32Array:
    """Shape (squares, pixels of each)."""
    side, rows, columns = _grid(*structure.shape)
    whole = structure[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.ascontiguousarray(whole.transpose(0, 2, 1, 3).reshape(rows * columns, side * side))
