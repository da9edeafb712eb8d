"""What the tracker knows from the pictures before, and what it keeps of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.vision.path import length
from flora_common.vision.path.apex import Apex, Followed, judged
from flora_common.vision.path.chain import Before
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.nearby import Nearby
from flora_common.vision.path.rivals import Rivals
from flora_common.vision.picture import Reduction
from flora_common.vision.reading import JUMPED, OK, PictureOutcome

LEAST_SEEN: Final = 0.35
FORGETS_S: Final = 900.0
"""Where the stem was counts half after this time."""
DOUBTS_BELIEVED: Final = 3
"""After so many pictures in a row that say so it is the stem all the same."""
ASTRAY_BELIEVED: Final = 12
"""The same where the apex before is still to be seen, and looks as it did."""
NEW_FOR: Final = 3
"""So many whole pictures, under lamps that change, tell where the end is that is followed from then on."""
LINE_KEPT_EVERY: Final = 4
"""Points of the line that memory keeps: one in so many, some 6 px apart."""


class Memory(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What the tracker knows from the pictures before; small enough to be written after each.

    Its px are those of pictures as they are looked at.

    Attributes:
        line_px: the stem, anchor first, tip last.
        length: belief on its length.
        seen: share of it that was seen.
        doubts: readings in a row that lay elsewhere, or showed too little to be believed.
        apex: how it looks round the tip, and where that is; None where the picture's edge is too near.
        elsewhere: pictures in a row in which something ended farther off than a stem grows, and was not believed.
        sure: whether it was clear, in some picture by itself, which part of the plant is the stem.
        near: what lets the stem be held to, and looked at nearby only; None where nothing but the whole can tell.
        petiole: for how many more clear pictures the line is doubted, because it was a petiole's.
        rivals: how likely its end and others have been lately.
        reduction: of the pictures as they are looked at; what is remembered of another one is of no use.
    """

    line_px: list[tuple[float, float]]
    length: LengthState
    seen: float = 1.0
    doubts: int = 0
    apex: Apex | None = None
    elsewhere: int = 0
    sure: bool = True
    near: Nearby | None = None
    petiole: int = 0
    rivals: Rivals | None = None
    reduction: Reduction = 1


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What a picture tells beside the line.

    Attributes:
        measured_cm: length of the stem in this picture by itself.
        followed: the apex of the picture before in this one.
        length, apex, elsewhere, sure, near, petiole, rivals: see :class:`Memory`.
        rivals_alone: rivals as this picture by itself tells them; None where it was looked at nearby only.
    """

    length: LengthState
    measured_cm: float
    followed: Followed
    apex: Apex | None
    near: Nearby | None
    elsewhere: int = 0
    sure: bool = True
    petiole: int = 0
    rivals: Rivals | None = None
    rivals_alone: Rivals | None = None


def before_of(memory: Memory | None, time_s: float) -> Before | None:
    """The stem that a picture taken at a time is held against; None where nothing is known of it."""
    if memory is None or not memory.sure:
        return None
    trust = float(np.clip((memory.seen - LEAST_SEEN) / (1.0 - 2.0 * LEAST_SEEN), 0.0, 1.0))
    trust /= 1.0 + (max(0.0, time_s - memory.length.time_s) / FORGETS_S) ** 2
    return Before(np.array(memory.line_px), trust)


def doubted_for(memory: Memory | None) -> int:
    """Pictures in a row in which something ended elsewhere than before, and was not believed."""
    return 0 if memory is None else max(memory.elsewhere, memory.doubts)


def is_little_known(memory: Memory | None) -> bool:
    """Whether what is followed is known from so few whole pictures that one more of them still decides."""
    return memory is not None and memory.rivals is not None and memory.rivals.looks < NEW_FOR


def remembered(
    memory: Memory | None,
    line_px: FloatArray,
    state: State,
    outcome: PictureOutcome,
    seen: float,
    *,
    doubted: bool,
    reduction: Reduction,
) -> Memory | None:
    """What is known after a picture.

    Args:
        memory: what was known before it.
        line_px: the stem in it, shape (n, 2).
        state: what else it tells.
        outcome: of the reading.
        seen: share of the stem that was seen.
        doubted: whether it may be no stem at all.
        reduction: of the pictures.
    """
    if memory is None and doubted:
        return None
    astray, rivals = state.followed.is_astray(line_px[-1]), state.rivals
    if memory is not None and (doubted or astray or outcome == JUMPED or seen < LEAST_SEEN):
        count = memory.doubts + 1
        if count < (ASTRAY_BELIEVED if astray else DOUBTS_BELIEVED):
            known = _as_of_now(memory, state) if astray else memory
            return msgspec.structs.replace(known, doubts=count, rivals=state.rivals)
        # of a new place the length is known, but not what the old one's history says of it; nor is that of its end
        belief = LengthState(state.length.time_s, state.measured_cm)
        rivals = state.rivals_alone if astray or outcome == JUMPED else rivals
    else:
        belief = state.length
    line = _points(np.concatenate([line_px[:-1:LINE_KEPT_EVERY], line_px[-1:]]))
    near = state.near if outcome == OK or state.elsewhere else None
    apex = state.apex and judged(state.apex, is_sure=outcome == OK)
    return Memory(
        line,
        belief,
        seen,
        apex=apex,
        elsewhere=state.elsewhere,
        sure=state.sure,
        near=near,
        petiole=state.petiole,
        rivals=rivals,
        reduction=reduction,
    )


def _as_of_now(memory: Memory, state: State) -> Memory:
    """What was known before a picture in which the apex was seen once more."""
    return msgspec.structs.replace(
        memory,
        line_px=_points(state.followed.drawn(np.array(memory.line_px))),
        length=length.predicted(memory.length, state.length.time_s),
        apex=state.apex,
    )


def _points(line_px: FloatArray) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in line_px]
