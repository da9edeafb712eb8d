"""Other plants beside the one at the anchor: whether something rises there, and whether the line goes over to it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import arc_length, unit
from flora_common.runs import CameraSection
from flora_common.vision.path.sampler import places_along
from flora_common.vision.path.strands import End, Strand

RISES_CM, UPRIGHT = 1.2, 0.8
"""So much is seen of another stem at least, and it leans by less."""
FOOT_CM, BESIDE_CM, FOOT_LONG_CM = 1.0, 1.0, 0.3
"""Its foot is no higher above the anchor's height than the first, farther aside than the second, and what is seen of it
in one piece as long as the third: leaves hide parts of it. Of 210 good first pictures of fresh plants one is doubted
so."""
ALIKE: Final = 0.5
"""In shares of the stem's: how clear and thick it is at least."""
LEADS_FOOT_CM, LEADS_RISES_CM, LEADS_ALIKE = 2.0, 0.9, 0.2
"""The same of one to which the line goes over: higher up, shorter, fainter, for that is another sign of it."""
LEADS_CM, ALONG_CM, ALONG_FOR_CM = 8.0, 1.0, 0.5
"""So far it leads on from what is seen of it. A line within the second of that, over the third, goes over to it."""
NEXT_CM, NEXT_OFF_CM, NEXT_TURN, HEADING_CM = 2.5, 0.5, 0.8, 1.5
"""The next piece of it begins no farther ahead of its top and no farther aside, and goes on at an angle of no less a
cosine; ahead is where the last of it, over the fourth, leads."""
STEPS_CM_RAD, CHORD_CM, EVERY_CM = ((1.0, 0.5), (1.6, 0.7)), 0.3, 0.1
"""A line steps aside that is turned by so much from how it goes so far below, and as much above; told of chords of the
second, every third. Of 174 good first pictures of fresh plants the most is 0.19 and 0.29 rad."""
BESIDE: Final = "something else rises beside the anchor as a stem does"
GOES_OVER: Final = "the line goes over to what may be another plant beside the anchor"


def another_stem(
    line_px: FloatArray, strength: float, width_px: float, pieces: Sequence[Strand], camera: CameraSection
) -> bool:
    """Whether something else rises from the height of the anchor, its foot as thick and as clear as the stem: another
    plant.

    Args:
        line_px: the stem, shape (n, 2).
        strength, width_px: of it: evidence along it, and across.
        pieces: all that look like stem.
        camera: anchor and scale.
    """
    scale = camera.px_per_cm
    return any(
        float(np.median(foot.strength)) > ALIKE * strength
        and float(np.median(foot.width)) > ALIKE * width_px
        and _up_from(foot.points, pieces, scale)[1] > RISES_CM * scale
        for foot in _rising(line_px, pieces, camera, FOOT_LONG_CM, FOOT_CM)
    )


def goes_over(line_px: FloatArray, strength: float, pieces: Sequence[Strand], camera: CameraSection) -> bool:
    """Whether a line may leave the plant at the anchor for another one.

    It does where it goes on as a stem beside the anchor leads, or where it steps aside: it lies level for a little, and
    goes on as it was. Stems grow round bends, and hang down, but do not step aside.

    Args:
        line_px, strength, pieces, camera: as of :func:`another_stem`.
    """
    scale = camera.px_per_cm
    s = arc_length(line_px)
    even = places_along(line_px, s, np.arange(0.0, float(s[-1]), EVERY_CM * scale))
    return _steps_aside(even) or any(
        float(np.median(piece.strength)) > LEADS_ALIKE * strength
        and _is_along(even, _up_from(piece.points, pieces, scale)[0], scale)
        for piece in _rising(line_px, pieces, camera, LEADS_RISES_CM, LEADS_FOOT_CM)
    )


def _rising(
    line_px: FloatArray, pieces: Iterable[Strand], camera: CameraSection, long_cm: float, foot_cm: float
) -> Iterator[Strand]:
    """The pieces that rise beside the anchor and are none of the line's, from their feet up."""
    scale, (x, y) = camera.px_per_cm, camera.anchor_px
    for piece in pieces:
        low = piece if piece.points[0, 1] > piece.points[-1, 1] else piece.reversed()
        foot = low.points[0]
        rise = foot - low.points[min(len(low.points) - 1, round(RISES_CM * scale))]
        if (
            piece.length > long_cm * scale
            and low.ends[0] is not End.LEAF
            and abs(foot[0] - x) > BESIDE_CM * scale
            and y - foot[1] < foot_cm * scale
            and abs(rise[0]) < UPRIGHT * rise[1]
            and float(np.hypot(*(line_px - foot).T).min()) > BESIDE_CM * scale
        ):
            yield low


def _up_from(stem_px: FloatArray, pieces: Iterable[Strand], px_per_cm: float) -> tuple[FloatArray, float]:
    """A piece of stem with those that go on from its top, one after the other: leaves hide parts of it. And how much of
    it is seen, px."""
    reach_px, seen_px = HEADING_CM * px_per_cm, float(arc_length(stem_px)[-1])
    left = {
        number: [(way, _leads(way, reach_px)) for way in (piece.points, piece.points[::-1])]
        for number, piece in enumerate(pieces)
    }
    while True:
        top, ahead = stem_px[-1], -_leads(stem_px[::-1], reach_px)
        following = []
        for number, ways in left.items():
            for way, leads in ways:
                off = way[0] - top
                far, aside = float(off @ ahead), abs(float(off[0] * ahead[1] - off[1] * ahead[0]))
                if 0.0 < far < NEXT_CM * px_per_cm and aside < NEXT_OFF_CM * px_per_cm and leads @ ahead > NEXT_TURN:
                    following.append((far, number, way))
        if not following:
            return stem_px, seen_px
        _, number, way = min(following, key=lambda one: one[:2])
        stem_px, seen_px = np.concatenate([stem_px, way]), seen_px + float(arc_length(way)[-1])
        del left[number]


def _leads(points_px: FloatArray, reach_px: float) -> FloatArray:
    """Where the first of them lead, up to so far from where they begin, of length 1."""
    near = points_px[np.hypot(*(points_px - points_px[0]).T) <= reach_px]
    return unit(near[-1] - near[0])


def _is_along(even_px: FloatArray, stem_px: FloatArray, px_per_cm: float) -> bool:
    """Whether a line, told every :data:`EVERY_CM`, goes along a stem, or along where that leads from its top."""
    onwards = np.arange(0.0, LEADS_CM * px_per_cm, 2.0)[:, None] * unit(stem_px[-1] - stem_px[0])
    places = np.concatenate([stem_px[::2], stem_px[-1] + onwards])
    away = np.hypot(*(even_px[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1)
    return bool(np.count_nonzero(away < ALONG_CM * px_per_cm) * EVERY_CM > ALONG_FOR_CM)


def _steps_aside(even_px: FloatArray) -> bool:
    """Whether a line, told every :data:`EVERY_CM`, is turned aside over a short way and back."""
    chord = round(CHORD_CM / EVERY_CM)
    step = even_px[chord:] - even_px[:-chord]
    angle = np.unwrap(np.arctan2(step[:, 0], -step[:, 1]))
    for far_cm, least_rad in STEPS_CM_RAD:
        apart = round(far_cm / EVERY_CM)
        here = angle[apart:-apart]
        below, above = here - angle[: len(here)], here - angle[2 * apart :]
        turned = np.minimum(np.abs(below), np.abs(above))
        if turned[np.sign(below) == np.sign(above)].max(initial=0.0) > least_rad:
            return True
    return False
