"""From frames to readings: pictures are looked at in parallel and followed in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from flora_common.errors import BadPicture
from flora_common.runs import Light
from flora_common.vision.reading import StemReading, bad_picture
from flora_lab.sources import FilmPicture, Frame, PictureFile
from flora_lab.track.methods import Look, Method
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Reading


@dataclass(frozen=True, slots=True)
class Unusable:
    """In the place of what a picture shows: why it could not be used."""

    reason: str


@dataclass(frozen=True, slots=True)
class DecodeAndLook:
    """Work for a pool: from a stored picture to what it shows, or :class:`Unusable`."""

    look: Look

    def __call__(self, picture: PictureFile | FilmPicture) -> Any:
        try:
            return self.look(picture.load(self.look.reduction))
        except BadPicture as problem:
            return Unusable(str(problem))


def follow_frames(
    frames: Iterator[Frame], method: Method, pool: Pool, *, lights: Mapping[int, Light], interval_s: float
) -> Iterator[Reading]:
    """What came of every frame, in order.

    A picture that cannot be used gives the outcome ``bad_picture`` and does not end the sequence.

    Args:
        frames: in order of time.
        method: goes on from its memory.
        pool: decodes and looks.
        lights: by frame; those that are missing are taken for ``dark``.
        interval_s: between frames whose time is not known.
    """
    underway: deque[tuple[int, str, float, dict[str, float]]] = deque()

    def pictures() -> Iterator[PictureFile | FilmPicture]:
        for frame in frames:
            time_s = frame.time_s if frame.time_s is not None else frame.index * interval_s
            underway.append((frame.index, frame.name, time_s, frame.covariates))
            yield frame.picture

    for sight in pool.map(DecodeAndLook(method.look), pictures()):
        index, name, time_s, covariates = underway.popleft()
        light = lights.get(index, "dark")
        yield Reading(index, name, time_s, light, covariates, _stem(method, sight, light, time_s))


def _stem(method: Method, sight: Any, light: Light, time_s: float) -> StemReading:
    if isinstance(sight, Unusable):
        return bad_picture(sight.reason)
    try:
        return method.follow(sight, light, time_s)
    except BadPicture as problem:
        return bad_picture(str(problem))
