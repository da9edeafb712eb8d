"""Which lamp shone in a photograph, where no ``frames.csv`` says it."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from flora_common.errors import BadInput
from flora_common.runs import LIGHTS, Light
from flora_common.suggest import did_you_mean
from flora_common.vision.picture import Picture

LightRule = Callable[[int, Picture], Light]
"""From a frame's index and its picture (at any size) to the lamp that shines."""

_SATURATED = 250
_SMALLEST_SHARE = 0.002
_CLEARLY = 2.0


def parse_rule(text: str) -> LightRule:
    """The rule that ``--light-from`` names.

    Args:
        text: ``left``, ``right``, ``dark`` or ``both`` for all frames; ``picture`` to look at each picture; or spans
            of frame numbers, ends included, as in ``left:0-46,right:47-93``.

    Raises:
        BadInput: none of these, or spans that overlap.
    """
    for light in LIGHTS:
        if text == light:
            return lambda index, picture, light=light: light  # type: ignore[misc]
    if text == "picture":
        return lambda index, picture: light_in_picture(picture)
    if ":" not in text:
        raise BadInput(
            f"--light-from: `{text[:40]}`{did_you_mean(text, (*LIGHTS, 'picture', 'left:0-46,right:47-93'))}"
        )
    return _Spans(text)


class _Spans:
    def __init__(self, text: str) -> None:
        self._spans: list[tuple[int, int, Light]] = []
        for part in text.split(","):
            found = re.fullmatch(r"(\w+):(\d{1,9})-(\d{1,9})", part.strip())
            if not found:
                raise BadInput(f"--light-from: `{part[:40]}` is not a span such as left:0-46")
            first, last = int(found[2]), int(found[3])
            if last < first or any(first <= b and a <= last for a, b, _ in self._spans):
                raise BadInput(f"--light-from: span `{part[:40]}` is backwards or overlaps another")
            self._spans.append((first, last, _known(found[1])))

    def __call__(self, index: int, picture: Picture) -> Light:
        for first, last, light in self._spans:
            if first <= index <= last:
                return light
        raise BadInput(f"--light-from: no span holds frame {index}; give one for every frame")


def light_in_picture(picture: Picture) -> Light:
    """The lamp that shines, by the saturated pixels of each half: a lamp in view is the brightest thing there.

    A half counts as lit from 0.2 % saturated pixels (green) on; where both do, one must have twice the other's to be
    the only one. Lamps that are out of view, or very bright things that are no lamps, deceive it.
    """
    saturated = picture[:, :, 1] >= _SATURATED
    half = saturated.shape[1] // 2
    left, right = float(np.mean(saturated[:, :half] if half else saturated)), float(np.mean(saturated[:, half:]))
    if max(left, right) < _SMALLEST_SHARE:
        return "dark"
    if left >= _CLEARLY * right:
        return "left"
    if right >= _CLEARLY * left:
        return "right"
    return "both"


def _known(text: str) -> Light:
    for light in LIGHTS:
        if text == light:
            return light
    raise BadInput(f"--light-from: light `{text[:40]}`{did_you_mean(text, LIGHTS)}")
