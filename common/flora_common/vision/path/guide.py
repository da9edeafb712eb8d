"""Where a network that has seen many drawn plants thinks that the stem and its apex are.

Rules tell a stem from leaves by what one knows of both; where young leaves stand round an apex, or a petiole goes on as
the stem does, they run out. The network (:mod:`.convolutions`) sees evidence and colours of several centimetres at
once, at 12 px per cm whatever the camera's scale, and tells for each place how likely it is the stem's middle, or the
apex. The guide's line is the cheapest way between anchor and apex over those (Dijkstra 1959). It is good to a
millimetre or two; edges are measured along it as along any other.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_common.geometry import arc_length, heading_at_end
from flora_common.vision.path import apex_error
from flora_common.vision.path.apex import SECTION_CM, drawn_to
from flora_common.vision.path.cheapest_ways import IndexArray, cheapest_ways
from flora_common.vision.path.convolutions import HEAD, LAYERS, MOST, MULTIPLE, Layer, Network
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.sampler import normals, places_along, values_at

WEIGHTS: Final = "guide.npz"
INPUT_PX_PER_CM: Final = 12.0
EVIDENCE_STEP, CODE_STEP = 2.0 * 48.0 / MOST, 8.0 * 32.0 / MOST
"""Code units of one step of the network's input; its colours are those of the plant's mean in the middle."""
IS_PLANT: Final = 15.0
LEAST_PLANT_PX: Final = 50
THINNED: Final = 2
"""One pixel in so many along either side tells the plant's colour."""
OFF_STEM: Final = 0.02
"""Likelihood that is added everywhere: how dear ways are where nothing looks like a stem."""
NEAR_CM: Final = 0.6
"""So far from where it was the apex is looked for."""
NEAR_SEEN_CM: Final = 4.0
"""So much to all sides of the tip is seen when the apex is looked for near where it was."""
SEEN_CM: Final = 40.0
"""So much to all sides of the anchor is seen in a whole picture: no plant of a box reaches farther, and a hand does."""
ABOUT_PEAK: Final = 2
"""Half a side of the square over which places are averaged, px of the maps."""
SMOOTHED_OVER: Final = 2
"""Steps of the way to either side over which it is evened."""
ELSEWHERE_CM: Final = 0.7
"""An apex farther than this from another place is not the one there."""
MOST_APICES, LEAST_SHARE = 5, 0.3
"""So many places are compared, and none that is less likely than this share of the likeliest."""
WEAKEST_OVER: Final = 13
"""Steps of a way over which its likelihood is averaged: 2 cm."""
_EVEN: Final = np.full(2 * SMOOTHED_OVER + 1, 1.0 / (2 * SMOOTHED_OVER + 1))
ALONG_CM: Final = 2.0 / INPUT_PX_PER_CM
"""A pixel of the maps."""
ASIDE_CM, ASIDE_SPREAD_CM, ASIDE_PLACES, ASIDE_TIMES = 0.7, 0.35, 17, 2
"""So far to either side of where it was the stem's middle is looked for, with this standard deviation, in so many
places, so many times: it moves by 0.3 cm from one picture to the next where it moves most."""
LEAST_ASIDE: Final = 1e-4
"""Square of a likelihood; where it is no greater to either side, the line stays where it is."""
STRAIGHT_ON_CM, STRAIGHT_ON_SHARE = 0.7, 0.4
"""An apex as far beyond another one and at least that share as likely makes that one doubtful."""
PLAIN_ALONG: Final = 0.4
"""A known stem is as sure as its apex where its way is likelier than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """What the network tells of a picture.

    Attributes:
        tip_px: the likeliest apex, (x, y) px of the full picture.
        sure: 0..1, how likely it is, and the way to it where that is least likely.
        line_px: shape (n, 2), from the anchor to it, px of the full picture.
        along: how likely the steps of the cheapest way there are the stem's middle; empty of a known stem that is only
            drawn to its apex.
        elsewhere: 0..1, how likely an apex is anywhere else, where no way may lead and no peak need be.
        off: shape (limits,), the chances that the stem ends farther off than each of
            :data:`flora_common.vision.path.apex_error.LIMITS_CM`; None where that was not looked at.
    """

    tip_px: FloatArray
    sure: float
    line_px: FloatArray
    along: FloatArray
    elsewhere: float = 0.0
    off: FloatArray | None = None


@cache
def network() -> Network:
    """The network as it comes with this package."""
    with resources.files(__package__).joinpath(WEIGHTS).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        return Network(
            {
                name: Layer(*(arrays[f"{name}.{part}"].astype(np.float32) for part in ("weight", "factor", "shift")))
                for name in (*LAYERS, HEAD)
            }
        )


class Maps:
    """How likely each place of a part of a picture is the stem's middle, and the apex.

    Args:
        evidence: of that part.
        px_per_cm: scale of the full picture.
        about_px: middle of the square that is wanted, (x, y) px of the full picture.
        within_cm: half a side of that square.

    Attributes:
        logits: of both, shape (2, height, width).
        stem, apex: how likely they are, each of shape (height, width).
    """

    def __init__(self, evidence: Evidence, px_per_cm: float, about_px: FloatArray, within_cm: float) -> None:
        colour = mean_colour(evidence)
        evidence = evidence.cut(about_px, within_cm * px_per_cm)
        height, width = evidence.plant.shape
        size = [max(2, round(v * INPUT_PX_PER_CM / px_per_cm)) for v in (width, height)]
        seen = network_input(evidence, colour, (size[0], size[1]))
        padded = np.pad(seen, ((0, 0), *((0, -v % MULTIPLE) for v in size[::-1])), mode="edge")
        logits = network()(padded)[:, : (size[1] + 1) // 2, : (size[0] + 1) // 2]
        self.logits: FloatArray = logits.astype(np.float64)
        self.stem, self.apex = 1.0 / (1.0 + np.exp(-self.logits))
        self._seen = seen
        self._step = np.array([width / size[0], height / size[1]]) * 2.0
        self._origin = np.array(evidence.origin_px, dtype=np.float64)

    def believed(self, logits: FloatArray) -> Maps:
        """The same part of the picture with other logits."""
        other = copy(self)
        other.__dict__.pop("_planes", None)
        other.logits = logits
        other.stem, other.apex = 1.0 / (1.0 + np.exp(-logits))
        return other

    def places(self) -> FloatArray:
        """Of all pixels, px of the full picture, shape (height, width, 2)."""
        rows, columns = np.indices(self.stem.shape)
        return self.to_px(np.stack([columns, rows], axis=-1))

    def logits_at(self, places_px: FloatArray) -> FloatArray:
        """Logits at places (height, width, 2) of the full picture, linear between pixels, beyond the edge as on it."""
        at = self.from_px(places_px).astype(np.float32)
        found = cv2.remap(
            self.logits.transpose(1, 2, 0), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found, dtype=np.float64).transpose(2, 0, 1)

    def to_px(self, places: FloatArray) -> FloatArray:
        """Places of the maps (..., 2) in px of the full picture."""
        return np.asarray((places + 0.5) * self._step - 0.5 + self._origin, dtype=np.float64)

    def from_px(self, places_px: FloatArray) -> FloatArray:
        """The reverse."""
        return np.asarray((places_px - self._origin + 0.5) / self._step - 0.5, dtype=np.float64)

    def stem_at(self, places_px: FloatArray) -> FloatArray:
        """How likely places (..., 2) of the full picture are the stem's middle, linear between pixels, 0 outside."""
        places = self.from_px(places_px)
        return values_at(self.stem.astype(np.float32), places[..., 0], places[..., 1])

    def views(self, line_px: FloatArray, along: FloatArray, sure: float, elsewhere: float) -> FloatArray:
        """What is seen from the end of a line, see :func:`.apex_error.views_of`.

        Args:
            line_px: from the anchor, shape (n, 2), px of the full picture.
            along: how likely its steps are the stem's middle.
            sure, elsewhere: how likely an apex is at its end, and anywhere else at most.
        """
        line = self.from_px(line_px)
        return apex_error.views_of(self._planes, line, along, sure, elsewhere, 0.5 * INPUT_PX_PER_CM)

    @cached_property
    def _planes(self) -> Float32Array:
        """What the network was shown, and its maps, the apex' as logarithm; shape (height, width, CHANNELS + 2)."""
        height, width = self.stem.shape
        seen = cv2.resize(self._seen.transpose(1, 2, 0), (width, height), interpolation=cv2.INTER_AREA)
        apex = cv2.dilate(np.log(np.maximum(apex_error.LEAST, self.apex)), np.ones((3, 3), np.uint8))
        return np.dstack([seen, self.stem, apex]).astype(np.float32)

    def peaks(self) -> list[tuple[int, int]]:
        """The likeliest apices, rows and columns, likeliest first."""
        top = (self.apex == cv2.dilate(self.apex, np.ones((5, 5), np.uint8))) & (
            self.apex >= LEAST_SHARE * self.apex.max()
        )
        places = np.argwhere(top)
        order = np.argsort(-self.apex[top], kind="stable")[:MOST_APICES]
        return [(int(row), int(column)) for row, column in places[order]]

    def nearest_peak(self, near_px: FloatArray, within_px: float) -> tuple[int, int]:
        """Row and column of the likeliest apex within a distance of a place of the full picture."""
        near = np.where(self._farther(near_px, within_px), -1.0, self.apex)
        row, column = np.unravel_index(int(np.argmax(near)), self.apex.shape)
        return int(row), int(column)

    def likeliest_beyond(self, place_px: FloatArray, away_px: float) -> float:
        """How likely an apex is at most, farther than that from a place of the full picture."""
        return float(np.where(self._farther(place_px, away_px), self.apex, 0.0).max())

    def _farther(self, place_px: FloatArray, away_px: float) -> BoolArray:
        """Which places of the maps are farther than that from a place of the full picture, shape of the maps."""
        height, width = self.apex.shape
        (at_x, at_y), (step_x, step_y) = self.from_px(place_px), self._step
        x, y = (np.arange(width) - at_x) * step_x, (np.arange(height) - at_y) * step_y
        return np.asarray(x**2 + y[:, None] ** 2 > away_px**2, dtype=np.bool_)

    def about(self, pixel: tuple[int, int]) -> FloatArray:
        """The place of a peak, px of the full picture, to a fraction of a pixel."""
        part = tuple(slice(max(0, k - ABOUT_PEAK), k + ABOUT_PEAK + 1) for k in pixel)
        weight = self.apex[part]
        rows, columns = np.indices(weight.shape)
        place = np.array([(weight * columns).sum(), (weight * rows).sum()]) / max(1e-12, float(weight.sum()))
        return self.to_px(place + np.array([part[1].start, part[0].start]))


def mean_colour(evidence: Evidence) -> Float32Array:
    """The code's mean where there is plant, shape (3,); everywhere where there is hardly any."""
    code, there = evidence.code[::THINNED, ::THINNED], evidence.plant[::THINNED, ::THINNED] > IS_PLANT
    known = code[there] if np.count_nonzero(there) > LEAST_PLANT_PX else code.reshape(-1, 3)
    return np.asarray(known.mean(axis=0, dtype=np.float64), dtype=np.float32)


def network_input(evidence: Evidence, colour: Float32Array, size: tuple[int, int]) -> Float32Array:
    """What the network is shown of a part of a picture.

    Args:
        evidence: of that part.
        colour: of the plant.
        size: (width, height) at :data:`INPUT_PX_PER_CM`.

    Returns:
        Shape (4, height, width), whole numbers in 0..255: evidence, and the colours of the code against the plant's.
    """
    how = cv2.INTER_AREA if size[0] < evidence.plant.shape[1] else cv2.INTER_LINEAR
    plant = cv2.resize(evidence.plant, size, interpolation=how)
    code = np.asarray(cv2.resize(evidence.code, size, interpolation=how), dtype=np.float32)
    shown = in_steps(np.asarray(plant, dtype=np.float32), code, colour)
    return np.ascontiguousarray(np.rint(shown).transpose(2, 0, 1))


def in_steps(plant: Float32Array, code: Float32Array, colour: Float32Array) -> Float32Array:
    """Evidence and colours in steps of the network's input, shape (height, width, 4), cut to 0..255, not yet whole.

    Training shows the network the same (``tests/guide``).
    """
    off = (code - colour) / np.float32(CODE_STEP) + np.float32(0.5 * MOST)
    return np.asarray(np.clip(np.dstack([plant / np.float32(EVIDENCE_STEP), off]), 0.0, MOST), dtype=np.float32)


def everywhere(evidence: Evidence, anchor_px: FloatArray, px_per_cm: float) -> tuple[Way, ...]:
    """The likeliest apices of a picture and the ways to them, likeliest first; at least one.

    Args:
        evidence: of the plant.
        anchor_px: where the stem begins, (x, y) px of the full picture.
        px_per_cm: scale.
    """
    return ways(Maps(evidence, px_per_cm, anchor_px, SEEN_CM), anchor_px, px_per_cm)


def ways(maps: Maps, anchor_px: FloatArray, px_per_cm: float) -> tuple[Way, ...]:
    """The likeliest apices of a picture and the ways to them, likeliest first; at least one.

    Args:
        maps: of the picture.
        anchor_px: where the stem begins, (x, y) px of the full picture.
        px_per_cm: scale.
    """
    anchor = np.asarray(anchor_px, dtype=np.float64)
    height, width = maps.stem.shape
    x, y = maps.from_px(anchor)
    start = int(np.clip(round(y), 0, height - 1)), int(np.clip(round(x), 0, width - 1))
    ends = maps.peaks()
    band = cv2.dilate(maps.stem, np.ones((3, 3), np.uint8))
    found = []
    for end, way in zip(ends, cheapest_ways(1.0 / (maps.stem + OFF_STEM), start, ends), strict=True):
        if way is None:
            found.append(Way(maps.about(end), 0.0, np.stack([anchor, maps.about(end)]), np.zeros(2)))
            continue
        along = np.asarray(band[way[:, 0], way[:, 1]], dtype=np.float64)
        tip = maps.about(end)
        line = _evened(maps.to_px(_centred(maps.stem, way)), tip, anchor)
        elsewhere = maps.likeliest_beyond(tip, ELSEWHERE_CM * px_per_cm)
        sure = float(maps.apex[end]) * weakest(along)
        off = apex_error.perceptron().chances(maps.views(line, along, sure, elsewhere))
        found.append(Way(tip, sure, line, along, elsewhere, off))
    return tuple(sorted(found, key=lambda one: -one.sure))


def weakest(along: FloatArray) -> float:
    """How likely a way is the stem's where it is least likely, its lowest part left out, which a rim may hide."""
    part = min(len(along), WEAKEST_OVER)
    means = np.convolve(along, np.ones(part) / part, mode="valid")
    return float(means[min(len(means) - 1, len(along) // 3) :].min())


def near(evidence: Evidence, line_px: FloatArray, px_per_cm: float) -> Way:
    """The likeliest apex near the end of the stem before, and that stem drawn to it.

    Args:
        evidence: of the part of the picture round the stem.
        line_px: the stem in the picture before, shape (n, 2), px of the full picture.
        px_per_cm: scale.
    """
    maps = Maps(evidence, px_per_cm, line_px[-1], NEAR_SEEN_CM)
    pixel = maps.nearest_peak(line_px[-1], NEAR_CM * px_per_cm)
    tip = maps.about(pixel)
    line, along = in_middle(maps, drawn_to(line_px, tip, SECTION_CM * px_per_cm), px_per_cm)
    sure = float(maps.apex[pixel]) * min(1.0, weakest(along) / PLAIN_ALONG)
    return Way(tip, 0.0 if _goes_on(maps, pixel, line, px_per_cm) else sure, line, along)


def _goes_on(maps: Maps, pixel: tuple[int, int], line_px: FloatArray, px_per_cm: float) -> bool:
    """Whether what is likely stem leads straight on from the end of a line to another apex, of which only the whole
    picture tells more."""
    tip, heading = line_px[-1], heading_at_end(line_px, STRAIGHT_ON_CM * px_per_cm)
    for other in maps.peaks():
        way = maps.about(other) - tip
        ahead_cm = float(way @ heading) / px_per_cm
        aside_cm = abs(float(way[0] * heading[1] - way[1] * heading[0])) / px_per_cm
        if ahead_cm > max(STRAIGHT_ON_CM, aside_cm) and maps.apex[other] >= STRAIGHT_ON_SHARE * maps.apex[pixel]:
            places = tip + np.linspace(0.0, 1.0, math.ceil(ahead_cm / ALONG_CM))[:, None] * way
            if float(np.median(maps.stem_at(places))) > PLAIN_ALONG:
                return True
    return False


def in_middle(maps: Maps, line_px: FloatArray, px_per_cm: float) -> tuple[FloatArray, FloatArray]:
    """A line that was the stem's middle, moved to where that is now, its end as it is; and how likely it is that.

    Only what lies in the maps is moved, from where the line comes into them for the last time.

    Args:
        maps: of a part of the picture.
        line_px: shape (n, 2), px of the full picture.
        px_per_cm: scale.

    Returns:
        The line, of the same shape; and the likelihood along what lies in the maps, every :data:`ALONG_CM`.
    """
    s = arc_length(line_px)
    count = max(2, round(float(s[-1]) / (ALONG_CM * px_per_cm)))
    at = np.linspace(0.0, float(s[-1]), count)
    places = places_along(line_px, s, at)
    there, size = maps.from_px(places), np.array(maps.stem.shape[::-1])
    outside = np.flatnonzero(((there < 0.0) | (there > size - 1.0)).any(axis=1))
    first = int(outside[-1]) + 1 if outside.size else 0
    if count - first < 3:
        return line_px, np.zeros(1)
    at, places = at[first:], places[first:]
    offsets = np.linspace(-ASIDE_CM, ASIDE_CM, ASIDE_PLACES) * px_per_cm
    from_end = np.minimum(np.arange(len(at)), np.arange(len(at))[::-1])
    nearer = np.exp(-0.5 * (offsets / (ASIDE_SPREAD_CM * px_per_cm)) ** 2)
    moved = places
    for _ in range(ASIDE_TIMES):
        across = normals(moved)
        likely = maps.stem_at(moved[:, None] + offsets[:, None] * across[:, None])
        weights = likely**2 * nearer + LEAST_ASIDE
        aside = (weights * offsets).sum(axis=1) / weights.sum(axis=1)
        aside = np.convolve(np.pad(aside, SMOOTHED_OVER, mode="edge"), _EVEN, mode="valid")
        aside *= np.minimum(1.0, from_end / (2.0 * SMOOTHED_OVER))
        moved = moved + aside[:, None] * across
    shift = np.column_stack([np.interp(s, at, (moved - places)[:, k], left=0.0) for k in range(2)])
    return line_px + shift, maps.stem_at(moved)


def _centred(likely: FloatArray, way: IndexArray) -> FloatArray:
    """Places (x, y) in the middle of what is likely about each pixel of a way."""
    offsets = np.arange(-ABOUT_PEAK, ABOUT_PEAK + 1)
    rows, columns = np.meshgrid(offsets, offsets, indexing="ij")
    down, right = (way[:, k, None] + v.ravel() for k, v in enumerate((rows, columns)))
    inside = (down >= 0) & (down < likely.shape[0]) & (right >= 0) & (right < likely.shape[1])
    weight = np.where(inside, likely[np.where(inside, down, 0), np.where(inside, right, 0)], 0.0) ** 2 + 1e-9
    total = weight.sum(axis=1)
    return np.column_stack([(weight * right).sum(axis=1) / total, (weight * down).sum(axis=1) / total])


def _evened(line: FloatArray, tip: FloatArray, anchor: FloatArray) -> FloatArray:
    """The line without its steps from pixel to pixel, from anchor to tip."""
    ends = len(line) > 2 * SMOOTHED_OVER
    inner = line[SMOOTHED_OVER:-SMOOTHED_OVER] if ends else line[:0]
    raw = np.concatenate([anchor[None], inner, tip[None]])
    reach = min(SMOOTHED_OVER, (len(raw) - 1) // 2)
    if reach < 1:
        return raw
    padded = np.concatenate([np.repeat(raw[:1], reach, axis=0), raw, np.repeat(raw[-1:], reach, axis=0)])
    kernel = np.ones(2 * reach + 1) / (2 * reach + 1)
    smooth = np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(2)])
    smooth[0], smooth[-1] = anchor, tip
    return smooth
