"""The comparison as text for a terminal and as numbers for scripts."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

from flora_lab.paper.pipeline import SIDES, Side
from flora_lab.paper.published import Published
from flora_lab.paper.results import Results
from flora_lab.paper.rows import Row, Values
from flora_lab.simulator.store import software

FORMAT: Final = "flora-paper-numbers-1"
NOTHING: Final = "-"
COLUMNS: Final[Mapping[Side, str]] = {"paper": "its recipe here", "own": "our recipe"}
HEAD: Final = ("", "paper", COLUMNS["paper"], COLUMNS["own"])
WIDE: Final = 44


def number(value: float | None, unit: str) -> str:
    """One number without its unit."""
    if value is None:
        return NOTHING
    if unit == "%":
        return f"{value:.1f}"
    if value == int(value):
        return f"{value:,.0f}"
    return f"{value:.3g}"


def values_text(values: Values | None, unit: str) -> str:
    """Numbers with their unit."""
    if values is None or all(value is None for value in values):
        return NOTHING
    return f"{', '.join(number(value, unit) for value in values)}{f' {unit}' if unit else ''}"


def published_text(one: Published) -> str:
    """What the paper tells."""
    return f"{one.sign} {values_text(one.values, one.unit)}".strip()


def cells(row: Row) -> list[str]:
    """A row's cells: what, paper, either recipe."""
    unit = row.published.unit
    return [row.published.what, published_text(row.published), *(values_text(row.ours.by(s), unit) for s in SIDES)]


def text(compared: Sequence[Row]) -> str:
    """The whole table, as plain text."""
    lines = [list(HEAD), *(cells(row) for row in compared)]
    wide = [max(len(line[k]) for line in lines) for k in (1, 2, 3)]
    out, section = [], ""
    for row, line in zip([None, *compared], lines, strict=True):
        if row is not None and row.published.section != section:
            section = row.published.section
            out.append(f"\n{section}")
        what, *rest = textwrap.wrap(line[0], WIDE) or [""]
        numbers = "  ".join(cell.rjust(w) for cell, w in zip(line[1:], wide, strict=True))
        out.append(f"  {what:<{WIDE}}  {numbers}".rstrip())
        out += [f"    {more}" for more in rest]
    return "\n".join(out) + "\n"


def as_json(results: Results, compared: Sequence[Row]) -> dict[str, Any]:
    """Every number, null where there is none."""
    scale = results.asked.scale
    return {
        "format": FORMAT,
        "software": software(),
        "scale": scale.name,
        "seed": results.asked.seed,
        "rows": [
            {
                "key": row.published.key,
                "section": row.published.section,
                "what": row.published.what,
                "unit": row.published.unit,
                "sign": row.published.sign,
                "paper": list(row.published.values),
                "paper_recipe": _list(row.ours.by("paper")),
                "own_recipe": _list(row.ours.by("own")),
                "note": row.ours.note,
            }
            for row in compared
        ],
        "dataset": {count.step: {"stems": count.stems, "vectors": count.vectors} for count in results.data.count},
        "took_s": dict(results.took_s),
    }


def _list(values: Values | None) -> list[float | None] | None:
    return None if values is None else list(values)
