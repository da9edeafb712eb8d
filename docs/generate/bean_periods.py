"""How long the cycles of circumnutating beans are: figures of docs/results/rhythms-of-real-plants.md.

    .venv/bin/python docs/generate/bean_periods.py motor_meta_and_cycle_periods.xlsx

The table comes with Ohad et al.'s data (merozlab/ohad-2026-cn-mech-twine); its sheet ``meta-data CN_delay`` has one row
per event and the successive periods of a plant, in minutes, from column I on. An .xlsx is a zip of XML: to read it
nothing else is needed.
"""

from __future__ import annotations

import re
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np

SHEET: Final = "meta-data CN_delay"
PLANT_COLUMN: Final = "A"
FIRST_PERIOD_COLUMN: Final = "I"
MAIN: Final = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
LINK: Final = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"
FEWEST_FOR_TREND: Final = 8
SHUFFLES: Final = 4000


@dataclass(frozen=True, slots=True)
class Record:
    """Successive periods that were measured in one go.

    Attributes:
        plant: number of the experiment, one plant each.
        minutes: of the cycles, in order, shape (n,).
    """

    plant: str
    minutes: np.ndarray


def records(path: Path) -> list[Record]:
    """All rows of the sheet that have periods."""
    found = []
    for row in _rows(path)[1:]:
        columns = sorted((c for c in row if _place(c) >= _place(FIRST_PERIOD_COLUMN)), key=_place)
        if columns:
            found.append(Record(row[PLANT_COLUMN], np.array([float(row[c]) for c in columns])))
    return found


def figures(found: list[Record]) -> dict[str, float]:
    """Means, spreads and trend of the periods, minutes; plants weigh the same, however many cycles they have."""
    plants = sorted({r.plant for r in found})
    by_plant = [np.concatenate([r.minutes for r in found if r.plant == p]) for p in plants]
    several = [minutes for minutes in by_plant if len(minutes) > 1]
    free = sum(len(minutes) - 1 for minutes in several)
    within = float(np.sqrt(sum(((m - m.mean()) ** 2).sum() for m in several) / free))
    means = np.array([m.mean() for m in by_plant])
    # Means of few cycles differ by chance alone: that part is no difference between plants.
    by_chance = float(np.mean([within**2 / len(m) for m in by_plant]))
    long = [r.minutes for r in found if len(r.minutes) >= FEWEST_FOR_TREND]
    slopes = np.array([_slope(m) for m in long])
    neighbours = np.array([np.corrcoef(_rest(m)[:-1], _rest(m)[1:])[0, 1] for m in long])
    rng = np.random.default_rng(1)
    orders = [rng.permuted(np.repeat(m[:, None], SHUFFLES, axis=1), axis=0) for m in long]
    shuffled = np.mean([_slope(columns) for columns in orders], axis=0)
    return {
        "plants": len(plants),
        "records": len(found),
        "cycles": sum(len(m) for m in by_plant),
        "shortest": min(float(m.min()) for m in by_plant),
        "longest": max(float(m.max()) for m in by_plant),
        "mean": float(means.mean()),
        "standard_error": float(means.std(ddof=1) / np.sqrt(len(means))),
        "within": within,
        "between": float(np.sqrt(max(means.var(ddof=1) - by_chance, 0.0))),
        "trend_records": len(long),
        "rising": float(np.count_nonzero(slopes > 0.0)),
        "trend_per_cycle": float(slopes.mean()),
        "trend_error": float(slopes.std(ddof=1) / np.sqrt(len(slopes))),
        "trend_chance": float((1 + np.count_nonzero(np.abs(shuffled) >= abs(slopes.mean()))) / (SHUFFLES + 1)),
        "within_without_trend": float(
            np.sqrt(sum((_rest(m) ** 2).sum() for m in long) / sum(len(m) - 2 for m in long))
        ),
        "neighbours": float(neighbours.mean()),
        "whole_fives": float(np.mean(np.concatenate(by_plant) % 5 == 0)),
    }


def _rows(path: Path) -> list[dict[str, str]]:
    """Cells of the sheet by column letters."""
    with zipfile.ZipFile(path) as archive:
        sheets = {s.get("name"): s.get(LINK) for s in _xml(archive, "xl/workbook.xml").iter(f"{MAIN}sheet")}
        targets = {r.get("Id"): r.get("Target") for r in _xml(archive, "xl/_rels/workbook.xml.rels")}
        shared = ["".join(t.text or "" for t in si.iter(f"{MAIN}t")) for si in _xml(archive, "xl/sharedStrings.xml")]
        sheet = _xml(archive, f"xl/{targets[sheets[SHEET]]}")
    rows = []
    for row in sheet.iter(f"{MAIN}row"):
        cells = {}
        for cell in row:
            value = cell.findtext(f"{MAIN}v")
            if value is not None:
                text = shared[int(value)] if cell.get("t") == "s" else value
                cells[re.sub(r"\d", "", cell.get("r", ""))] = text
        rows.append(cells)
    return rows


def _xml(archive: zipfile.ZipFile, name: str) -> ET.Element:
    return ET.fromstring(archive.read(name))


def _place(column: str) -> tuple[int, str]:
    """Order of columns: Z comes before AA."""
    return len(column), column


def _slope(minutes: np.ndarray) -> np.ndarray:
    """Of a record, or of each column of several that are as long."""
    return np.polynomial.polynomial.polyfit(np.arange(len(minutes)), minutes, 1)[1]


def _rest(minutes: np.ndarray) -> np.ndarray:
    at = np.arange(len(minutes))
    return minutes - np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyfit(at, minutes, 1))


if __name__ == "__main__":
    for name, value in figures(records(Path(sys.argv[1]))).items():
        print(f"{name:>22} {value:.4g}")
