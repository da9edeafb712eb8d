"""What is said about simulators: tables for people, one JSON object for scripts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from flora_common.counted import counted
from flora_lab.rollout.intervals import Estimate, how_sure
from flora_lab.rollout.predictors import GoesOn, NothingMoves
from flora_lab.rollout.summary import END, MEASURES, Measure, Place, Start, Summary
from flora_lab.rollout.time_scale import RANGE, TimeScale

MEASURE_WORDS: Final[dict[Measure, str]] = {
    "tip_mm": "tip error, mm",
    "stem_mm": "whole-stem error, mm",
    "growth": "growth, % too much (+) or too little (-)",
}


def hours_text(steps: int, step_s: float) -> str:
    """A horizon in words: ``5 min``, ``6 h``, ``end``."""
    if steps == END:
        return "end"
    seconds = steps * step_s
    return f"{seconds / 3600.0:g} h" if seconds >= 3600.0 else f"{seconds / 60.0:g} min"


def start_text(start: Start, summary: Summary) -> str:
    """A start in words."""
    watch = f"{summary.plan.watch_h:g} h"
    return {
        "one_step": f"one step of {summary.step_s:g} s from every measured stem",
        "unseen": "running free from the first stem",
        "watched": f"running free after watching {watch}",
        "often": f"running free after watching {watch}, and again every {summary.plan.every_h:g} h",
    }[start]


def like_another(start: Start) -> frozenset[str]:
    """Who need not be told, as its numbers are those of another."""
    return frozenset({GoesOn.kind}) if start in ("one_step", "unseen") else frozenset()


def text(summary: Summary) -> str:
    """All tables and notes, as plain text."""
    parts = [_runs_table(summary)]
    for start in _told(summary):
        parts.append(_errors_tables(summary, start))
    parts.append(_differences_table(summary))
    if summary.time_scales:
        parts.append(_time_scales_table(summary))
    parts.append("\n".join(notes(summary)) + "\n")
    return "\n".join(parts)


def notes(summary: Summary) -> list[str]:
    """What a reader of the numbers must know, a sentence each."""
    runs = len(summary.runs)
    found = [f"{counted(runs, 'run')} of {how_sure(summary.plants)}."]
    longest_h = max(run.hours for run in summary.runs)
    if "watched" not in _told(summary):
        found.append(
            f"The longest run is {longest_h:g} h; nothing is told after watching {summary.plan.watch_h:g} h; "
            "see --watch-h."
        )
    found.append(
        f"{GoesOn.kind} knows no past of a single stem; from there it is the same as {NothingMoves.kind}. "
        "Growth is left out where the measured stem gained less than 1 mm."
    )
    for name, hours in summary.beyond.items():
        left = hours[np.isfinite(hours)]
        if len(left):
            found.append(
                f"{name}, running free from the first stem, left the data that it was made from in {len(left)} of "
                f"{counted(runs, 'run')}, first after {left.min():.1f} h; what it says then is a guess."
            )
    for name, apart in summary.parting_mm.items():
        if np.isfinite(apart).any():
            found.append(
                f"{name} is the mean of several members; by the end, from the first stem, their tips are "
                f"{np.nanmedian(apart):.1f} mm from their middle (median over runs): as much is not known."
            )
    return found


def as_json(summary: Summary) -> dict[str, Any]:
    """Every number, with units in the names; null where there is none."""
    return {
        "simulators": list(summary.names),
        "runs": [
            {"name": run.name, "plant": run.plant, "hours": run.hours, "rows": len(run), "sha256": run.sha256}
            for run in summary.runs
        ],
        "plants": summary.plants,
        "step_s": summary.step_s,
        "watch_h": summary.plan.watch_h,
        "every_h": summary.plan.every_h,
        "seed": summary.seed,
        "errors": [
            {**_place(place, summary), "simulator": name, **_estimate(estimate)}
            for (place, name), estimate in summary.estimates.items()
        ],
        "differences": [
            {
                **_place(place, summary),
                "simulator": summary.names[0],
                "other": one.other,
                "difference": _estimate(one.difference),
                "times_better": _estimate(one.times_better),
            }
            for place, found in summary.differences.items()
            for one in found
        ],
        "per_run": [
            {**_place(place, summary), "simulator": name, "run": run.name, "value": _number(value)}
            for (place, name), values in summary.per_run.items()
            for run, value in zip(summary.runs, values.tolist(), strict=True)
        ],
        "beyond_data_h": {
            name: {run.name: _number(value) for run, value in zip(summary.runs, hours.tolist(), strict=True)}
            for name, hours in summary.beyond.items()
        },
        "members_part_mm": {
            name: {run.name: _number(value) for run, value in zip(summary.runs, apart.tolist(), strict=True)}
            for name, apart in summary.parting_mm.items()
        },
        "time_scales": {name: _time_scale(scale) for name, scale in summary.time_scales.items()},
        "notes": notes(summary),
    }


def _told(summary: Summary) -> list[Start]:
    """The starts of which there is anything to tell."""
    first = summary.names[0]
    starts: list[Start] = ["one_step", "unseen"]
    starts += [s for s in ("watched", "often") if summary.estimates[Place(s, 1, "tip_mm"), first].plants]
    return starts


def _runs_table(summary: Summary) -> str:
    """Tip errors of the judged simulator, a run a line."""
    first = summary.names[0]
    blocks = [
        (start, summary.horizons(start)) for start in _told(summary) if start != "often" and summary.horizons(start)
    ]
    wide = max(4, *(len(run.name) for run in summary.runs)) + 2
    head, under = f"{'':<{wide}}{'':>7}", f"{'run':<{wide}}{'hours':>7}"
    for start, steps in blocks:
        title = {"one_step": "one step", "unseen": "first stem", "watched": f"watched {summary.plan.watch_h:g} h"}[
            start
        ]
        head += f"  {title:>{8 * len(steps)}}"
        under += "  " + "".join(f"{hours_text(step, summary.step_s):>8}" for step in steps)
    lines = [f"{first}: tip error of each run, mm (one step, and running free)", head, under]
    for i, run in enumerate(summary.runs):
        line = f"{run.name:<{wide}}{run.hours:>7.1f}"
        for start, steps in blocks:
            values = (summary.per_run[Place(start, step, "tip_mm"), first][i] for step in steps)
            line += "  " + "".join(f"{_short(float(value)):>8}" for value in values)
        lines.append(line)
    return "\n".join(lines) + "\n"


def _errors_tables(summary: Summary, start: Start) -> str:
    """One table for each measure: simulators by horizons."""
    lines = [f"{start_text(start, summary)}: median over plants"]
    names = [name for name in summary.names if name not in like_another(start)]
    for measure in MEASURES:
        steps = [
            step for step in summary.horizons(start) if (Place(start, step, measure), names[0]) in summary.estimates
        ]
        rows = {
            name: [_cell(summary.estimates[Place(start, step, measure), name], measure) for step in steps]
            for name in names
        }
        lines += _table(MEASURE_WORDS[measure], summary, steps, rows) if steps else []
    return "\n".join(lines) + "\n"


def _differences_table(summary: Summary) -> str:
    """The judged simulator minus each other one, and how many times better it is; of the tip."""
    first = summary.names[0]
    lines = [
        f"{first} minus another, each plant with itself: tip, mm, median over plants; below 0 {first} is better",
        f"and how many times smaller its median error is; above 1 {first} is better",
    ]
    for start in _told(summary):
        steps = [step for step in summary.horizons(start) if step != 1 or start == "one_step"]
        rows: dict[str, list[str]] = {}
        for sign in ("-", "x"):
            for step in steps:
                for one in summary.differences[Place(start, step, "tip_mm")]:
                    if one.other not in like_another(start):
                        told = one.difference if sign == "-" else one.times_better
                        rows.setdefault(f"{sign} {one.other}", []).append(_cell(told))
        lines += _table(start_text(start, summary), summary, steps, rows)
    return "\n".join(lines) + "\n"


def _time_scales_table(summary: Summary) -> str:
    wide = max(len(name) for name in summary.time_scales) + 2
    lines = ["how many times too fast each simulated plant is (the factor at which it errs least on these runs)"]
    for name, scale in summary.time_scales.items():
        line = f"  {name:<{wide}}{_cell(scale.factor)}; mean tip error {_short(scale.error_mm)} mm with it, "
        line += f"{_short(scale.error_as_is_mm)} mm without"
        if scale.at_edge:
            line += f"; the search was from {RANGE[0]:g} to {RANGE[1]:g}, the truth may lie beyond"
        lines.append(line)
    return "\n".join(lines) + "\n"


def _table(title: str, summary: Summary, steps: Sequence[int], rows: dict[str, list[str]]) -> list[str]:
    """Lines of a table whose columns are horizons, as wide as its cells."""
    wide = max(len(name) for name in rows)
    columns = [
        [hours_text(step, summary.step_s), *(cells[i] for cells in rows.values())] for i, step in enumerate(steps)
    ]
    widths = [max(map(len, column)) + 3 for column in columns]
    lines = [f"  {title}"]
    for i, name in enumerate(["", *rows]):
        cells = "".join(f"{column[i]:>{width}}" for column, width in zip(columns, widths, strict=True))
        lines.append(f"    {name:<{wide}}{cells}")
    return lines


def _cell(estimate: Estimate, measure: Measure = "tip_mm") -> str:
    times = 100.0 if measure == "growth" else 1.0
    middle = _short(times * estimate.value)
    if estimate.low is None or estimate.high is None:
        return middle
    return f"{middle} [{_short(times * estimate.low)}, {_short(times * estimate.high)}]"


def _short(value: float) -> str:
    """Three digits or so; ``-`` where there is none."""
    if not math.isfinite(value):
        return "-"
    size = abs(value)
    digits = 2 if size < 9.995 else 1 if size < 99.95 else 0
    return f"{round(value, digits) + 0.0:.{digits}f}"  # + 0.0: no minus before a zero


def _place(place: Place, summary: Summary) -> dict[str, Any]:
    horizon_h = None if place.horizon == END else place.horizon * summary.step_s / 3600.0
    return {"start": place.start, "horizon_h": horizon_h, "measure": place.measure}


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": _number(estimate.value),
        "low": _number(estimate.low),
        "high": _number(estimate.high),
        "plants": estimate.plants,
    }


def _time_scale(scale: TimeScale) -> dict[str, Any]:
    return {
        "factor": _estimate(scale.factor),
        "mean_tip_error_mm": scale.error_mm,
        "mean_tip_error_as_is_mm": scale.error_as_is_mm,
        "at_edge": scale.at_edge,
        "tried": [
            {"factor": factor, "mean_tip_error_mm": error}
            for factor, error in zip(scale.factors.tolist(), scale.errors_mm.tolist(), strict=True)
        ],
    }


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
