"""The folder that ``flora-lab rollout -o`` writes: ``rollout.json``, ``errors.png``, and a picture of each run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from flora_common import files
from flora_lab.rollout import figures, report
from flora_lab.rollout.summary import Entry, Summary
from flora_lab.rollout.work import Stage

JSON_FILE: Final = "rollout.json"
ERRORS_FILE: Final = "errors.png"
RUNS_FOLDER: Final = "runs"


def write_folder(path: Path, entries: Sequence[Entry], summary: Summary, stage: Stage) -> None:
    """Write the folder, whole or not at all.

    Args:
        path: which must not be there.
        entries: all simulators; runs are drawn with the first.
        summary: of them.
        stage: is told how far the work is.

    Raises:
        DiskFull: no room.
    """
    drawn = stage("pictures", 1 + len(summary.runs))
    with files.whole_folder(path) as folder:
        text = json.dumps(report.as_json(summary), indent=1) + "\n"
        (folder / JSON_FILE).write_text(text, encoding="utf-8")
        (folder / ERRORS_FILE).write_bytes(figures.errors_over_time(entries, summary))
        drawn()
        inner = folder / RUNS_FOLDER
        inner.mkdir()
        for index, run in enumerate(summary.runs):
            alike = sum(other.name == run.name for other in summary.runs[:index])
            name = f"{run.name}-{alike + 1}" if alike else run.name
            (inner / f"{name}.png").write_bytes(figures.one_run(run, index, entries[0], summary))
            drawn()
