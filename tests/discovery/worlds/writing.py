"""A case on disk: run folders for the finder, and the truth beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from flora_common import files
from flora_common.runs import TRACK_HEADER, RunFolder, run_file_text, track_line
from flora_common.tracks import Track

from .case import Case, Run

TRUTH = "truth.json"


def write_case(case: Case, folder: Path) -> None:
    """Write ``reference/run01``, ..., ``measured/run01``, ..., ``held_out/run01``, ... and ``truth.json``.

    The folder appears whole or not at all.

    Raises:
        StoreError: the folder cannot be written.
    """
    with files.whole_folder(folder) as made:
        for group in ("reference", "measured", "held_out"):
            for number, run in enumerate(getattr(case, group), start=1):
                _write_run(run, made / group / f"run{number:02d}")
        (made / TRUTH).write_text(json.dumps(truth(case), indent=1) + "\n", encoding="utf-8")


def truth(case: Case) -> dict[str, Any]:
    """What ``truth.json`` holds."""
    return {
        "seed": case.seed,
        "form": case.form,
        "kind": case.kind,
        "number": case.number,
        "effects": [{"effect": hidden.name, "parameters": hidden.parameters} for hidden in case.hidden],
        "schedules": {
            group: [run.schedule for run in getattr(case, group)] for group in ("reference", "measured", "held_out")
        },
        "oracle": case.oracle,
    }


def csv_text(track: Track) -> str:
    """``track.csv`` with its further columns."""
    names = list(track.covariates)
    lines = [",".join([TRACK_HEADER, *names])]
    for row, (time_s, light) in enumerate(zip(track.time_s, track.light, strict=True)):
        extras = "".join(f",{track.covariates[name][row]:g}" for name in names)
        lines.append(track_line(float(time_s), light, track.points_cm[row]) + extras)
    return "\n".join(lines) + "\n"


def _write_run(run: Run, path: Path) -> None:
    path.mkdir(parents=True)
    folder = RunFolder(path)
    folder.run_toml.write_text(run_file_text(run.file), encoding="utf-8")
    folder.track_csv.write_text(csv_text(run.track), encoding="utf-8")
