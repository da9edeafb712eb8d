"""What a diagnosis says of the extension's gain: for a terminal, and for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping

from flora_common.counted import listed
from flora_lab import html_page
from flora_lab.diagnose import controllers_told
from flora_lab.diagnose.diagnosis import Gain
from flora_lab.diagnose.figures import GAIN_NAMES


def groups_of(gain: Gain) -> list[tuple[str, dict[str, float]]]:
    """After how long, and the tip's errors then by simulator, mm."""
    groups = [("one step", gain.one_step)] if gain.one_step else []
    named = (
        ("the end" if after == "end" else f"{after.removesuffix('h')} h", e) for after, e in gain.free_running.items()
    )
    return [*groups, *named]


def where_worse(gain: Gain) -> str:
    """After how long the extended simulator is farther off than the one as it is, in a sentence; empty where never."""
    worse = [after for after, e in groups_of(gain) if e.get("extended", 0.0) > e.get("base", math.inf)]
    if not worse:
        return ""
    return f"After {listed(worse)} the extended simulator is farther off than the simulator as it is."


def lines(gain: Gain) -> list[str]:
    """For a terminal."""
    if not gain.free_running:
        return []
    groups = groups_of(gain)
    names = [name for name in GAIN_NAMES if name in gain.one_step]
    out = ["tip error in mm".ljust(24) + "".join(f"{name:>11}" for name in names)]
    for after, row in groups:
        out.append(after.ljust(24) + "".join(f"{row[which]:>11.2f}" for which in names if which in row))
    return [*out, f"judged on: {gain.judged_on}", *filter(None, [where_worse(gain)]), ""]


def pieces(gain: Gain, pictures: Mapping[str, bytes]) -> list[str]:
    """For the page."""
    if not gain.free_running and not gain.one_step and not gain.controller_fitness:
        return []
    out = [html_page.section("What the extension gains")]
    if gain.judged_on:
        out.append(html_page.paragraph(f"Judged on: {gain.judged_on}."))
    if "gain" in pictures:
        caption = "Error of the tip on runs that no fit has seen; the first stem alone is told. Less is better."
        picture = html_page.picture(pictures["gain"], "png", alt="errors by simulator and time", caption=caption)
        out.append(html_page.spaced(picture))
    groups = groups_of(gain)
    shown = [key for key in GAIN_NAMES if any(key in errors for _, errors in groups)]
    if groups:
        rows = [[after, *(_mm_or_none(errors.get(key)) for key in shown)] for after, errors in groups]
        out.append(html_page.table(["error of the tip after", *(GAIN_NAMES[key] for key in shown)], rows))
    if worse := where_worse(gain):
        out.append(html_page.paragraph(worse))
    return out + controllers_told.pieces(gain.controller_fitness, pictures)


def _mm_or_none(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} mm" if value < 9.995 else f"{value:.1f} mm"
