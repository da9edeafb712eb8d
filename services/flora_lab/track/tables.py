"""The two tables that ``flora-lab track`` writes."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Final

from flora_common.runs import TRACK_HEADER, track_line
from flora_common.shapes import STEM_POINTS
from flora_lab.track.readings import Reading

METHOD_COLUMNS: Final = ("quality", "folded", "tip_uncertainty_mm")
"""Of a method that gives uncertainties; after the covariates."""

TRACK_COLUMNS: Final = tuple(TRACK_HEADER.split(","))
"""Of every track; before the covariates."""

READINGS_HEADER: Final = (
    "index",
    "file",
    "time_s",
    "light",
    "outcome",
    "reason",
    "quality",
    "folded",
    "tip_x_px",
    "tip_y_px",
    "tip_choice",
    "stem_pixels",
    *(f"uncertainty{i}_mm" for i in range(1, STEM_POINTS + 1)),
)


def own_columns(*, method_columns: bool) -> tuple[str, ...]:
    """Names that no covariate of a track can have."""
    return (*TRACK_COLUMNS, *METHOD_COLUMNS) if method_columns else TRACK_COLUMNS


def track_text(readings: Sequence[Reading], *, method_columns: bool) -> str:
    """``track.csv``: the readings with points, and the covariates that ``frames.csv`` gave them.

    Args:
        readings: in order of time; those without points are left out.
        method_columns: add :data:`METHOD_COLUMNS`, numbers like every covariate.

    Names of covariates may hold commas and quotes, as ``frames.csv`` may; they must not be :func:`own_columns`.
    """
    with_points = [(r, r.stem.points_cm) for r in readings if r.stem.points_cm is not None]
    names = list(dict.fromkeys(name for r, _ in with_points for name in r.covariates))
    header = io.StringIO()
    csv.writer(header, lineterminator="").writerow(
        [*TRACK_COLUMNS, *names, *(METHOD_COLUMNS if method_columns else ())]
    )
    lines = [header.getvalue()]
    for r, points_cm in with_points:
        further = [f"{r.covariates[name]!r}" if name in r.covariates else "" for name in names]
        if method_columns and r.stem.uncertainty_mm is not None:
            further += [f"{r.stem.quality:.3f}", f"{r.stem.folded:d}", f"{r.stem.uncertainty_mm[-1]:.3f}"]
        lines.append(",".join([track_line(r.time_s, r.light, points_cm), *further]))
    return "\n".join(lines) + "\n"


def readings_text(readings: Sequence[Reading]) -> str:
    """``readings.csv``: every frame, also those that gave no stem; what is not known is empty."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(READINGS_HEADER)
    for r in readings:
        s = r.stem
        tip = ("", "") if s.tip_px is None else (f"{s.tip_px[0]:.2f}", f"{s.tip_px[1]:.2f}")
        uncertainty = [""] * STEM_POINTS if s.uncertainty_mm is None else [f"{u:.3f}" for u in s.uncertainty_mm]
        found = s.points_cm is not None
        table.writerow(
            [
                r.index,
                r.name,
                f"{r.time_s:.3f}",
                r.light,
                s.outcome,
                s.reason,
                f"{s.quality:.3f}",
                f"{s.folded:d}" if found else "",
                *tip,
                s.tip_choice or "",
                s.stem_pixels if found else "",
                *uncertainty,
            ]
        )
    return text.getvalue()
