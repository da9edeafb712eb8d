"""What a learned simulator gains, mended or corrected, for people: on a page, and as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from flora_lab import html_page
from flora_lab.diagnose.corrected_gain import CORRECTED
from flora_lab.diagnose.diagnosis import END
from flora_lab.diagnose.mended_simulator import BASE, CLOCK, MEAN, MEMORY, NO_MEMORY, STILL

_TITLES: Final = {
    BASE: "as learned",
    CLOCK: "clock set right",
    NO_MEMORY: "and a rest that forgets",
    MEMORY: "and a memory",
    CORRECTED: "with what it lacks",
    STILL: "nothing moves",
}


_WORDS: Final = {
    "mended": "Its plants are slowed down to real time, and what plants do besides under the lamps of the last hours "
    "is added, as a linear rule. Beside it stands the same rule without the lamps' past: what lies between both is "
    "memory.",
    "corrected": "What the effects that were found make of a mechanistic plant is added to its own.",
}


def _how(learned: Mapping[str, Any]) -> str:
    """What was done to it."""
    return "corrected" if any(CORRECTED in row for row in learned["tip_error_mm"].values()) else "mended"


def table(learned: Mapping[str, Any]) -> list[list[str]]:
    """Heads, and a row for each time; empty where nothing was mended."""
    errors: Mapping[str, Mapping[str, float]] = learned.get("tip_error_mm", {})
    if not errors:
        return []
    names = [name for name in _TITLES if any(name in row for row in errors.values())]
    head = ["tip error in mm", *(_TITLES[name] for name in names)]
    return [head, *([_time(when), *(_mm(row.get(name)) for name in names)] for when, row in errors.items())]


def pieces(learned: Mapping[str, Any], pictures: Mapping[str, bytes]) -> list[str]:
    """A section of the page; nothing where nothing was mended."""
    rows = table(learned)
    if not rows:
        return []
    how, judged_on = _how(learned), learned["judged_on"]
    out = [
        html_page.section(f"The learned simulator, {how}"),
        html_page.paragraph(f"{_WORDS[how]} Running free from the first stem; judged on {judged_on}."),
    ]
    if "learned" in pictures:
        caption = "The tip, measured and simulated from the first stem on."
        out.append(html_page.picture(pictures["learned"], "png", alt="tips over time", caption=caption))
    return [*out, html_page.table(rows[0], rows[1:])]


def lines(learned: Mapping[str, Any]) -> list[str]:
    """The same for a terminal."""
    rows = table(learned)
    if not rows:
        return []
    wide = [max(len(row[column]) for row in rows) + 2 for column in range(len(rows[0]))]
    text = [
        "".join(cell.rjust(w) if i else cell.ljust(w) for i, (cell, w) in enumerate(zip(row, wide, strict=True)))
        for row in rows
    ]
    return [f"the learned simulator, {_how(learned)}:", *text, f"judged on: {learned['judged_on']}", ""]


def _time(when: str) -> str:
    return {END: "the end", MEAN: "mean of the run"}.get(when, when.replace("h", " h"))


def _mm(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
