"""A simulator of one's own beside measured runs: what a diagnosis cannot use is told before anything is learned."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from diagnose_runs import run_of, write_run
from evolve_simulators import extended, learned, mechanistic, paper

from flora_common.errors import BadInput
from flora_lab.diagnose import work
from flora_lab.diagnose.inputs import Runs
from flora_lab.main import main
from flora_lab.simulator.corrected import CorrectedSimulator
from flora_lab.simulator.load import load
from flora_lab.simulator.paper import PaperSimulator
from flora_lab.simulator.store import Extension, Provenance, write_simulator


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three reference runs and one that is measured."""
    folder = tmp_path_factory.mktemp("given-runs")
    for seed in range(3):
        write_run(folder / "reference", run_of(seed))
    write_run(folder / "measured", run_of(10))
    return folder


@pytest.fixture(autouse=True)
def _learns_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "learned_base", lambda *_: pytest.fail("began to learn"))


def written(path: Path, simulator: PaperSimulator | CorrectedSimulator) -> Path:
    write_simulator(
        path,
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=Provenance("test", 0, "test"),
        extensions=simulator.extensions if isinstance(simulator, CorrectedSimulator) else (),
    )
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """What is said about bad input: one line, and status 2."""
    capsys.readouterr()
    assert main(["diagnose", *map(str, arguments)]) == 2
    (line,) = [line for line in capsys.readouterr().err.strip().splitlines() if not line.startswith("note: ")]
    return line


@pytest.mark.parametrize("simulator", [paper(), CorrectedSimulator(paper(), extended())], ids=["paper", "corrected"])
def test_a_simulator_that_needs_a_reference_beside_it_is_told_why(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], simulator: PaperSimulator | CorrectedSimulator
) -> None:
    path = written(tmp_path / "some.simulator", simulator)
    line = refused(capsys, runs / "measured" / "plant10.csv", "--simulator", path, "-o", tmp_path / "out")
    assert line.startswith(f"flora-lab: {path}: ")
    assert "its plants are all alike, so nobody knows what of a run is chance; add --reference" in line


def test_a_corrected_simulator_of_plants_that_differ_is_started_from(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is taken to be right in its own plants, and what is found besides is put beside it, too."""
    known: list[Runs] = []

    def learn(told: Runs, words: str, _: object) -> NoReturn:
        known.append(told)
        raise BadInput(words)

    monkeypatch.setattr(work, "learned_base", learn)
    simulator = CorrectedSimulator(learned(), extended())
    path = written(tmp_path / "some.simulator", simulator)
    assert main(["diagnose", str(runs / "measured" / "plant10.csv"), "--simulator", str(path), "-o", "out"]) == 2
    ends_cm = np.array([run.points_cm[-1, -1] for run in known[0].measured])
    assert len(np.unique(ends_cm[:, 0])) == len(ends_cm)
    further = Extension("growth_rate", {"factor": 1.2})
    again = work.corrected_by(load(path), mechanistic(), [further])
    assert isinstance(again, CorrectedSimulator)
    assert again.learned.kind == simulator.learned.kind
    assert again.extensions == (*simulator.extensions, further)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "dark",
            "at time_s 7500: light levels 0 left and 0 right: this simulator was trained with either lamp full on",
        ),
        ("seldom", "at time_s 420: a step of 420 s; this simulator knows multiples of 300 s only"),
    ],
)
def test_a_run_that_the_simulator_does_not_know_is_told_with_its_file(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, said: str
) -> None:
    run = run_of(30, step_s=420.0) if change == "seldom" else run_of(30)
    if change == "dark":
        run.light[24:60] = 0.0
    good, bad = runs / "measured" / "plant10.csv", write_run(tmp_path, run)
    simulators = ("--simulator", written(tmp_path / "paper.simulator", paper()), "--reference", runs / "reference")
    for given in ((good, bad), (good, "--holdout", bad)):
        line = refused(capsys, *given, *simulators, "-o", tmp_path / "out")
        assert f"{bad} {said}" in line
        assert line.endswith("for such runs give --reference without --simulator")
