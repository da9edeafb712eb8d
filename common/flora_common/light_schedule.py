"""Light by the clock alone, from text: what a virtual plant grows under, and what a light plan of a rig says."""

from __future__ import annotations

import bisect
import re
from collections.abc import Callable
from typing import Final

from flora_common.errors import BadInput
from flora_common.open_loop import HOUR_S, OpenLoopSection, open_loop_side
from flora_common.runs import LIGHTS, Light
from flora_common.suggest import clipped, did_you_mean

LightSchedule = Callable[[float], Light]
"""The lamp that shines from a time on, in seconds since the start."""

MOST_HOURS: Final = 24.0 * 60
"""Of a turn, and of a virtual plant's life."""


def parse_schedule(text: str) -> LightSchedule:
    """A light schedule from text.

    ``6h`` alternates left and right, six hours each, left first (the open loop of Wahby et al. 2018). ``right`` shines
    for ever. ``right 37h, left`` is a list: each light for its hours, the last one for ever.

    Raises:
        BadInput: none of these.
    """
    told = clipped(text)
    alternate = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*h\s*", text)
    if alternate:
        hours = float(alternate.group(1))
        if not 0.01 <= hours <= MOST_HOURS:
            raise BadInput(f"schedule `{told}`: alternate every 0.01 to {MOST_HOURS:g} h")
        turns = OpenLoopSection(hours)
        return lambda time_s: open_loop_side(time_s, turns)
    ends: list[float] = []
    lights: list[Light] = []
    end = 0.0
    entries = text.split(",")
    for number, entry in enumerate(entries, start=1):
        match = re.fullmatch(r"\s*([a-z]+)(?:\s+(\d+(?:\.\d+)?)\s*h)?\s*", entry)
        if match is None or (match.group(2) is None and number < len(entries)):
            raise BadInput(
                f"schedule `{told}`: entry {number} must read like `left 6h`, the last like `left`; or `6h` alone"
            )
        name = match.group(1)
        found = next((light for light in LIGHTS if light == name), None)
        if found is None:
            raise BadInput(f"schedule `{told}`: no light `{clipped(name)}`{did_you_mean(name, LIGHTS)}")
        end = end + float(match.group(2)) * HOUR_S if match.group(2) else float("inf")
        ends.append(end)
        lights.append(found)
    return lambda time_s: lights[min(bisect.bisect_right(ends, time_s), len(lights) - 1)]
