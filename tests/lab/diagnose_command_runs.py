"""The runs that tests of ``flora-lab diagnose`` give it, and what it says where it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from diagnose_runs import CHANCE, change_of, run_of, write_run

from flora_lab.main import main

CALM = {name: 0.5 * size for name, size in CHANCE.items()}
HIDDEN = change_of({"draught": {"drive_per_cm_h": 0.12}})


def write_runs(folder: Path) -> Path:
    """Five reference runs, two under an effect, and one more of these; returns the folder."""
    for seed in range(5):
        write_run(folder / "reference", run_of(seed, chance=CALM))
    for seed in (10, 11):
        write_run(folder / "measured", run_of(seed, change=HIDDEN, chance=CALM))
    write_run(folder / "held-out", run_of(12, change=HIDDEN, chance=CALM))
    return folder


def measured(runs: Path) -> list[Path]:
    return sorted((runs / "measured").iterdir())


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """What is said about bad input: one line, and status 2."""
    capsys.readouterr()
    assert main(["diagnose", *map(str, arguments)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = [line for line in said.err.strip().splitlines() if not line.startswith("note: ")]
    assert len(lines) == 1, said.err
    assert "Traceback" not in said.err
    return lines[0]
