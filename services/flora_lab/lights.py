"""Which lamp shone in a photograph, where no ``frames.csv`` says it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_common.errors import BadInput
from flora_common.runs import LIGHTS, Light
from flora_common.suggest import did_you_mean
from flora_common.vision.picture import Picture

LookRule = Literal["auto", "picture"]
"""Rules that need the pictures: ``picture`` asks each of them, ``auto`` believes them only where lamps alternate."""
LOOK_RULES: Final[tuple[LookRule, ...]] = ("auto", "picture")

_SATURATED = 250
_SMALLEST_SHARE = 0.002
_CLEARLY = 2.0


@dataclass(frozen=True, slots=True)
class ToldRule:
    """Lamps by frame number: the same one for all, or one per span.

    Attributes:
        spans: first frame, last frame (None: no end) and lamp.
    """

    spans: tuple[tuple[int, int | None, Light], ...]

    def __call__(self, index: int) -> Light:
        """The lamp in a frame.

        Raises:
            BadInput: no span holds it.
        """
        for first, last, light in self.spans:
            if first <= index and (last is None or index <= last):
                return light
        raise BadInput(f"--light-from: no span holds frame {index}; give one for every frame")


def parse_rule(text: str) -> ToldRule | LookRule:
    """The rule that ``--light-from`` names.

    Args:
        text: ``auto``; ``picture`` to ask each picture; ``left``, ``right``, ``dark`` or ``both`` for all frames; or
            spans of frame numbers, ends included, as in ``left:0-46,right:47-93``.

    Raises:
        BadInput: none of these, or spans that overlap.
    """
    for light in LIGHTS:
        if text == light:
            return ToldRule(((0, None, light),))
    for rule in LOOK_RULES:
        if text == rule:
            return rule
    if ":" not in text:
        known = (*LIGHTS, *LOOK_RULES, "left:0-46,right:47-93")
        raise BadInput(f"--light-from: `{text[:40]}`{did_you_mean(text, known)}")
    spans: list[tuple[int, int, Light]] = []
    for part in text.split(","):
        found = re.fullmatch(r"(\w+):(\d{1,9})-(\d{1,9})", part.strip())
        if not found:
            raise BadInput(f"--light-from: `{part[:40]}` is not a span such as left:0-46")
        first, last = int(found[2]), int(found[3])
        if last < first or any(first <= b and a <= last for a, b, _ in spans):
            raise BadInput(f"--light-from: span `{part[:40]}` is backwards or overlaps another")
        spans.append((first, last, _known(found[1])))
    return ToldRule(tuple(spans))


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


def where_lamps_alternate(seen: Mapping[int, Light], alike: Mapping[int, int]) -> dict[int, Light]:
    """The lamp of each picture by what most of the pictures that look like it show; ``dark`` unless lamps alternate.

    A bright thing that always stands on one side is no lamp. So the left lamp is only believed where there is another
    appearance of the setup in which the right one shines.

    Args:
        seen: by frame, what :func:`light_in_picture` says.
        alike: by frame, a number that pictures of one appearance share.
    """
    votes: dict[int, Counter[Light]] = {}
    for index, group in alike.items():
        votes.setdefault(group, Counter())[seen[index]] += 1
    by_group = {group: max(LIGHTS, key=lambda light: count[light]) for group, count in votes.items()}
    if not {"left", "right"} <= set(by_group.values()):
        return dict.fromkeys(alike, "dark")
    return {index: by_group[group] for index, group in alike.items()}


def _known(text: str) -> Light:
    for light in LIGHTS:
        if text == light:
            return light
    raise BadInput(f"--light-from: light `{text[:40]}`{did_you_mean(text, LIGHTS)}")
