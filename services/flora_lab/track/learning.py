"""The empty setup of a sequence: from background pictures, or from the photographs of the plant themselves.

Where nobody says which lamp shone in a photograph, the path method puts photographs together that look alike: it only
needs to know which show the setup in one state, not what that state is called.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import CameraSection, Light
from flora_common.vision import lamp_states
from flora_common.vision import setup as setup_matrices
from flora_common.vision.lamp_states import EmptySetup, LampState
from flora_common.vision.paper import PaperSettings
from flora_common.vision.path.reduced import reduced
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import Picture, Reduction
from flora_common.vision.setup import SetupMatrices
from flora_lab.lights import LookRule, ToldRule, light_in_picture, where_lamps_alternate
from flora_lab.sources import FilmPicture, PictureFile, Source
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Span

PATH_LEARNS_FROM: Final = 32
PAPER_LEARNS_FROM: Final = 60
"""Frames of each lamp state at most, evenly spread; more would only cost memory and time."""
LOOKS_DIFFERENT: Final = 10.0
"""Mean difference, in units of the logarithmic code, from which on two photographs show different lamp states.
Photographs of one state differ by 1 to 7 (plant, noise, drift), a lamp on the other side makes 15 and more."""
MOST_UNLIKE: Final = 24.0
"""A single place counts up to this."""

Small = npt.NDArray[np.int16]
"""Shape (height / 16, width / 16, 3)."""
OnFrame = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Sorted:
    """What is known of the frames of a span before any stem is looked for.

    Attributes:
        lights: by frame; those of bad pictures may be missing.
        alike: by frame, a number that frames of one appearance share; empty where nobody looked.
        lights_from: ``frames.csv``, ``told``, ``picture``, ``alternation`` (lamps were seen to alternate), ``nothing``.
    """

    lights: dict[int, Light]
    alike: dict[int, int] = field(default_factory=dict)
    lights_from: str = "frames.csv"


@dataclass(frozen=True, slots=True)
class Learnt:
    """An empty setup and where it comes from.

    Attributes:
        setup: for the path method an EmptySetup, for the published one matrices for all lamps or for each.
        made_by: ``background`` or ``frames``.
        pictures: how many pictures went in.
        states: how many lamp states are told apart.
    """

    setup: EmptySetup | SetupMatrices | dict[Light, SetupMatrices]
    made_by: str
    pictures: int
    states: int


def needs_a_look(source: Source, rule: ToldRule | LookRule, *, path: bool) -> bool:
    """Whether :func:`sort_frames` decodes every frame."""
    return source.lights is None and (path or not isinstance(rule, ToldRule))


def sort_frames(
    source: Source, span: Span, rule: ToldRule | LookRule, pool: Pool, *, path: bool, on_frame: OnFrame = lambda: None
) -> Sorted:
    """The lamp of every frame, and for the path method which frames look alike, where ``frames.csv`` does not say it.

    Raises:
        BadInput: spans that leave out a frame.
    """
    indices = span.indices(source.count)
    if source.lights is not None:
        return Sorted({i: source.lights[i] for i in indices})
    told = {i: rule(i) for i in indices} if isinstance(rule, ToldRule) else None
    if not needs_a_look(source, rule, path=path):
        assert told is not None
        return Sorted(told, lights_from="told")
    seen: dict[int, Light] = {}
    alike: dict[int, int] = {}
    groups = _Appearances()
    pictures = (frame.picture for frame in span.take(source.frames()))
    for index, glance in zip(indices, pool.map(glance_at, pictures), strict=False):
        on_frame()
        if glance is not None:
            seen[index] = glance[0]
            alike[index] = groups.number_of(glance[1])
    if told is not None:
        return Sorted(told, alike, "told")
    if rule == "picture":
        return Sorted(seen, alike, "picture")
    lights = where_lamps_alternate(seen, alike)
    return Sorted(lights, alike, "nothing" if set(lights.values()) <= {"dark"} else "alternation")


def glance_at(picture: PictureFile | FilmPicture) -> tuple[Light, Small] | None:
    """The lamp that a picture seems to show, and its logarithmic code made small; None if it cannot be used."""
    try:
        full = picture.load(1)
    except BadPicture:
        return None  # counted and reported when the frame is read
    coarse = lamp_states.coarse_code(full)
    size = (max(1, coarse.shape[1] // 4), max(1, coarse.shape[0] // 4))
    # in areas of 16 px noise has gone
    return light_in_picture(full), np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_AREA), dtype=np.int16)


def path_setup(
    source: Source,
    background: Sequence[PictureFile],
    camera: CameraSection,
    settings: PathSettings,
    frames: Sorted,
    *,
    on_frame: OnFrame = lambda: None,
) -> Learnt:
    """The empty setup for the path method.

    Raises:
        BadPicture: a background picture that cannot be used.
        BadInput: no background, and too few frames to learn from.
    """
    seen = reduced(camera, settings)
    if background:
        setup = lamp_states.from_background(picture.load(seen.reduction) for picture in background)
        return Learnt(setup, setup.made_by, setup.pictures, len(setup.states))
    states: list[LampState] = []
    for members in _enough(frames):
        pictures = _load(source, _spread(members, PATH_LEARNS_FROM), seen.reduction, on_frame)
        try:
            made = lamp_states.from_frames(pictures, anchor_px=seen.camera.anchor_px, widest_px=seen.widest_px)
            states.append(made)
        except BadPicture as problem:
            light = f"with light `{frames.lights[members[0]]}` " if source.lights is not None and members else ""
            why = "" if pictures else _why_not_the_first(source)
            raise BadInput(f"{source.name}: no background pictures, and {light}{problem}{why}") from problem
    setup = EmptySetup(states, "frames")
    return Learnt(setup, setup.made_by, setup.pictures, len(states))


def paper_setup(
    source: Source,
    background: Sequence[PictureFile],
    settings: PaperSettings,
    frames: Sorted,
    *,
    on_frame: OnFrame = lambda: None,
) -> Learnt:
    """L and H for the published method: from the background, or a pair for each lamp from the frames.

    Raises:
        BadPicture: a background picture that cannot be used.
        BadInput: no background, and a lamp with too few frames to learn from.
    """
    if background:
        made = setup_matrices.from_pictures(picture.load(settings.reduction) for picture in background)
        return Learnt(made, made.made_by, made.pictures, 1)
    learnt: dict[Light, SetupMatrices] = {}
    for light, members in _by_light(frames.lights).items():
        pictures = _load(source, _every_other(members, PAPER_LEARNS_FROM), settings.reduction, on_frame)
        if not pictures:
            continue  # all of them are bad pictures, so none of them will ask for it
        try:
            learnt[light] = setup_matrices.learn_from_frames(pictures)
        except BadPicture as problem:
            hint = "" if source.lights is not None else "; or say which lamp shone with --light-from"
            raise BadInput(
                f"{source.name}: no background pictures, and with light `{light}` {problem}{hint}"
            ) from problem
    if not learnt:
        why = _why_not_the_first(source)
        raise BadInput(f"{source.name}: no background pictures, and none of the frames can be used{why}")
    return Learnt(learnt, "frames", sum(s.pictures for s in learnt.values()), len(learnt))


class _Appearances:
    """Puts pictures together that look alike: each beside the first one that it resembles enough."""

    def __init__(self) -> None:
        self._first: list[Small] = []

    def number_of(self, small: Small) -> int:
        off = [_unlike(small, first) for first in self._first]
        nearest = int(np.argmin(off)) if off else -1
        if off and (off[nearest] < LOOKS_DIFFERENT or len(off) == lamp_states.MOST_STATES):
            return nearest
        self._first.append(small)
        return len(off)


def _unlike(small: Small, other: Small) -> float:
    """Mean difference of two pictures, exposure taken away; a plant, which is very different, counts little."""
    difference = small - other
    difference = difference - np.median(difference, axis=(0, 1))
    return float(np.minimum(np.abs(difference), MOST_UNLIKE).mean())


def _enough(frames: Sorted) -> list[list[int]]:
    """Frames of one lamp and one appearance each; those with too few to learn from are left out, if others remain."""
    groups: dict[tuple[Light, int], list[int]] = {}
    usable = [i for i in frames.lights if i in frames.alike] if frames.alike else list(frames.lights)
    for index in usable:
        # lamps that were only guessed from the picture tell nothing that the appearance does not
        light: Light = frames.lights[index] if frames.lights_from in ("frames.csv", "told") else "dark"
        groups.setdefault((light, frames.alike.get(index, 0)), []).append(index)
    large = [members for members in groups.values() if len(members) >= lamp_states.LEAST_FRAMES]
    if large:
        return large
    return [usable] if frames.alike else [max(groups.values(), key=len, default=[])]


def _by_light(lights: Mapping[int, Light]) -> dict[Light, list[int]]:
    groups: dict[Light, list[int]] = {}
    for index, light in lights.items():
        groups.setdefault(light, []).append(index)
    return groups


def _spread(members: Sequence[int], most: int) -> list[Sequence[int]]:
    """At most ``most`` runs of neighbours, of each of which one is to be used."""
    count = max(1, min(most, len(members)))
    edges = [round(k * len(members) / count) for k in range(count + 1)]
    return [members[a:b] for a, b in itertools.pairwise(edges)]


def _every_other(members: Sequence[int], most: int) -> list[Sequence[int]]:
    """Likewise, all of one length, which is a power of two."""
    step = 1
    while -(-len(members) // step) > most:
        step *= 2
    return [members[k : k + step] for k in range(0, len(members), step)]


def _why_not_the_first(source: Source) -> str:
    """Where no frame can be used, a clause that says what hinders the first."""
    try:
        next(source.frames()).load(1)
    except BadPicture as problem:
        return f"; the first: {problem}"
    return ""


def _load(source: Source, slots: Iterable[Sequence[int]], reduction: Reduction, on_frame: OnFrame) -> list[Picture]:
    """Of each slot the first picture that can be used."""
    slot_of = {index: number for number, slot in enumerate(slots) for index in slot}
    loaded: dict[int, Picture] = {}
    for frame in source.frames():
        number = slot_of.get(frame.index)
        if number is None or number in loaded:
            continue
        try:
            loaded[number] = frame.load(reduction)
        except BadPicture:
            continue  # counted and reported when the frame is read
        on_frame()
    return [loaded[number] for number in sorted(loaded)]
