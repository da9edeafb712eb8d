"""``flora-lab diagnose`` from end to end on small runs, and what it refuses to do with the simulators that it wrote."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import tomli_w
from diagnose_command_runs import CALM, HIDDEN, measured, refused, write_runs
from diagnose_runs import run_of, turns, write_run
from html_reader import Reader

from flora_common.geometry import turned_right
from flora_lab.diagnose import folder, work
from flora_lab.diagnose.diagnosis import Diagnosis
from flora_lab.diagnose.inputs import read_runs
from flora_lab.diagnose.stored_base import write_known
from flora_lab.diagnose.work import knowledge_of, start_from
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.main import main
from flora_lab.run_tracks import load_run
from flora_lab.simulator.interface import Chance
from flora_lab.simulator.interface import run as run_freely
from flora_lab.simulator.load import load
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import read_stored

RESULTS: list[work.Result] = []
"""What :func:`diagnosed` came to, for tests of how it is told."""


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """See :func:`diagnose_command_runs.write_runs`."""
    return write_runs(tmp_path_factory.mktemp("diagnose-runs"))


@pytest.fixture(scope="session")
def diagnosed(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the command writes."""
    out = tmp_path_factory.mktemp("diagnose-out") / "diagnosis"
    arguments = [*measured(runs), "--reference", runs / "reference", "-o", out, "--quiet"]
    real = work.diagnose

    def kept(*paths: Any, **how: Any) -> work.Result:
        RESULTS.append(real(*paths, **how))
        return RESULTS[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work, "diagnose", kept)
        assert main(["diagnose", *map(str, arguments)]) == 0
    return out


def told(path: Path) -> Diagnosis:
    return msgspec.json.decode((path / "diagnosis.json").read_bytes(), type=Diagnosis)


# From end to end


def test_the_folder_is_whole(diagnosed: Path) -> None:
    names = {path.name for path in diagnosed.iterdir()}
    assert names >= {"diagnosis.json", "report.html", "pictures", "base.simulator", "extended.simulator"}
    assert "corrected" not in names  # nothing was wrong with the record
    assert not [path for path in diagnosed.parent.iterdir() if path.name.startswith(".")]
    pictures = {path.name for path in (diagnosed / "pictures").iterdir()}
    assert {"paths.png", "stems.png", "phase.png", "stem.png", "spectrum.png", "evidence.png", "film.gif"} <= pictures


def test_bars_of_evidence_bear_the_names_that_the_page_uses(diagnosed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bars: list[tuple[list[tuple[str, float]], list[str]]] = []
    monkeypatch.setattr(folder.figures, "evidence", lambda tried, named, needed: bars.append((tried, named)) or b"")
    folder.pictures_of(RESULTS[0])
    ((tried, named),) = bars
    assert named == [BY_NAME[cause.effect].title for cause in told(diagnosed).causes]
    assert set(named) < {title for title, _ in tried} <= {effect.title for effect in BY_NAME.values()}


def test_what_was_hidden_is_found(diagnosed: Path, runs: Path) -> None:
    found = told(diagnosed)
    assert found.verdict == "explained"
    assert [cause.effect for cause in found.causes] == ["draught"]
    (cause,) = found.causes
    assert cause.parameters["drive_per_cm_h"] == pytest.approx(0.12, rel=0.25)
    low, high = cause.interval["drive_per_cm_h"]
    assert low < cause.parameters["drive_per_cm_h"] < high
    assert 0.0 <= cause.confidence <= 1.0
    assert found.format == 1
    assert found.residuals.significant
    assert found.residuals.size_mm > 1.0
    assert found.runs == [str(path) for path in measured(runs)]
    assert found.base["runs"] == 5
    free = found.gain.free_running["end"]
    assert free["extended"] < free["base"]
    assert "2 runs" in found.gain.judged_on
    assert found.summary.startswith("Steady push to a side")
    assert max(found.considered[0], key=found.considered[0].__getitem__) == "draught"
    assert found.considered[0]["draught"] == cause.nats > found.needed_nats > 0.0
    assert max(found.considered[-1].values()) < found.needed_nats


def test_the_report_needs_nothing_else(diagnosed: Path) -> None:
    text = (diagnosed / "report.html").read_text(encoding="utf-8")
    Reader(text)
    assert "Steady push to a side" in text
    for outside in ("http://", 'src="pictures', "<script src", "<link "):
        assert outside not in text.replace("http://www.w3.org", "")


def test_the_extended_simulator_is_one(diagnosed: Path) -> None:
    base, extended = (load(diagnosed / f"{name}.simulator") for name in ("base", "extended"))
    assert isinstance(base, RodSimulator)
    assert isinstance(extended, RodSimulator)
    assert [extension.effect for extension in extended.extensions] == ["draught"]
    # the measured plants tell of the typical one, too, but less than a spread's worth
    moved = (extended.without_extensions().prior.mean - base.prior.mean) / np.sqrt(np.diag(base.prior.covariance))
    assert 0.001 < np.abs(moved).max() < 1.0
    first = run_of(10).points_cm[:1]
    light = turns(12.0, 3.0)[:, None]
    tips = [run_freely(plant, plant.start(first), light, 300.0)[-1, 0, -1, 0] for plant in (base, extended)]
    assert tips[1] > tips[0] + 0.5  # pushed to the right
    chance = run_freely(extended, extended.start(first, Chance(np.array([1]))), light, 300.0)
    assert np.isfinite(chance).all()


def test_the_extended_simulator_rolls_out(diagnosed: Path, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [diagnosed / "extended.simulator", *measured(runs), "--json"]
    assert main(["rollout", *map(str, arguments)]) == 0
    assert json.loads(capsys.readouterr().out)["plants"] == 2


def test_what_was_learned_is_given_the_next_time(
    diagnosed: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With --json nothing else is printed, and the folder is written all the same."""
    capsys.readouterr()
    arguments = [*measured(runs), "--simulator", diagnosed / "base.simulator", "-o", tmp_path / "again", "--json"]
    assert main(["diagnose", *map(str, arguments), "--holdout", str(next((runs / "held-out").iterdir()))]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    printed = msgspec.json.decode(said.out.encode(), type=Diagnosis)
    assert printed == told(tmp_path / "again")
    for there, back in zip(told(diagnosed).causes, printed.causes, strict=True):
        assert there == back
    assert printed.verdict == told(diagnosed).verdict
    assert not (tmp_path / "again" / "base.simulator").exists()
    assert (tmp_path / "again" / "extended.simulator").is_dir()
    assert "held out" in printed.gain.judged_on


def test_an_extended_simulator_knows_what_it_was_extended_with(diagnosed: Path, runs: Path, tmp_path: Path) -> None:
    """Another plant under the same effect is as expected, with the same name for what there is to know."""
    other, out = next((runs / "held-out").iterdir()), tmp_path / "out"
    simulator = diagnosed / "extended.simulator"
    assert main(["diagnose", str(other), "--simulator", str(simulator), "-o", str(out), "--quiet"]) == 0
    found = told(out)
    assert found.verdict == "nothing_wrong"
    assert found.causes == []
    assert found.base["learned_from"] == "extended.simulator, learned from 5 runs, and extended with draught"
    assert "extended_by_these_runs" not in found.base


def test_a_simulator_that_was_extended_by_these_very_runs_confirms_nothing(
    diagnosed: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, *_ = measured(runs)
    simulator = diagnosed / "extended.simulator"
    assert main(["diagnose", str(one), "--simulator", str(simulator), "--no-report", "-o", str(tmp_path / "out")]) == 0
    said = "the simulator was extended by what this very run told: what it explains of that is no confirmation"
    assert said in capsys.readouterr().err
    assert told(tmp_path / "out").base["extended_by_these_runs"] == said


def test_a_camera_that_was_knocked_is_told_and_turned_back(diagnosed: Path, runs: Path, tmp_path: Path) -> None:
    run, out = run_of(12, change=HIDDEN, chance=CALM), tmp_path / "out"
    turned = turned_right(run.points_cm, np.where(np.arange(len(run)) >= 190, np.radians(-8.0), 0.0))
    knocked = write_run(tmp_path, replace(run, points_cm=turned))
    simulator = diagnosed / "extended.simulator"
    assert main(["diagnose", str(knocked), "--simulator", str(simulator), "-o", str(out), "--quiet"]) == 0
    found = told(out)
    assert found.verdict == "unexplained"
    assert found.causes == []
    (note,) = found.record
    assert note.startswith("plant12 15.8 h after its start by ")
    assert note.endswith("to the left: camera or pot was knocked; what comes after is turned back")
    assert found.summary.startswith("Camera or pot was knocked: plant12 15.8 h after its start by ")
    assert "Beside that: Nothing is wrong" in found.summary
    assert note in (out / "report.html").read_text(encoding="utf-8")
    (corrected,) = (out / "corrected").iterdir()
    tips, meant = load_run(corrected).track.points_cm[:, -1], run.points_cm[:, -1]
    assert np.abs(tips - meant).max() < 0.2
    assert np.abs(turned[:, -1] - meant).max() > 1.0


def test_quiet_says_nothing(
    diagnosed: Path, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    assert diagnosed.is_dir()

    def at_once(*_: object, note: Callable[[str], None], **__: object) -> work.Result:
        note("no run.toml tells where the lamps hang, and this is so long a line that no terminal is as wide as it is")
        return RESULTS[0]

    monkeypatch.setattr(work, "diagnose", at_once)
    monkeypatch.setattr(folder, "write", lambda path, _: path.mkdir())
    capfd.readouterr()
    arguments = ["diagnose", *map(str, measured(runs)), "--reference", str(runs / "reference"), "-o"]
    assert main([*arguments, str(tmp_path / "quiet"), "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert main([*arguments, str(tmp_path / "told")]) == 0
    said = capfd.readouterr()
    assert said.out.startswith("verdict: explained\nSteady push to a side")
    assert said.out.endswith(f"wrote {tmp_path / 'told'}\n")
    assert "tip error in mm" in said.out
    assert "sure to over 99 %" in said.out
    assert "100 %" not in said.out.split("tip error")[0]
    (line,) = said.err.splitlines()
    assert line.startswith("note: no run.toml tells")


def test_without_a_report_nothing_is_drawn_and_all_else_is_as_before(
    diagnosed: Path, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "diagnose", lambda *_, **__: RESULTS[0])
    for name in ("pictures_of", "page"):
        monkeypatch.setattr(folder, name, lambda *_, **__: pytest.fail("drawn all the same"))
    arguments = ["diagnose", *map(str, measured(runs)), "--reference", str(runs / "reference"), "--no-report", "-q"]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0

    def files_of(path: Path) -> dict[str, bytes]:
        return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}

    whole = files_of(diagnosed)
    left_out = {name for name in whole if name == "report.html" or name.startswith("pictures/")}
    assert len(left_out) > 5
    assert files_of(tmp_path / "out") == {name: data for name, data in whole.items() if name not in left_out}
    # What cannot be written to its end leaves nothing.
    monkeypatch.setattr(folder.corrected_tracks, "write", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        folder.write_without_report(tmp_path / "broken", RESULTS[0])
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("signal_name", ["SIGTERM", "SIGKILL"])
def test_killed_in_the_middle_it_leaves_nothing_behind(runs: Path, tmp_path: Path, signal_name: str) -> None:
    program = [sys.executable, "-m", "flora_lab.main", "diagnose"]
    arguments = [*measured(runs), "--reference", runs / "reference", "-o", tmp_path / "out"]
    process = subprocess.Popen(
        [*program, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ},
    )
    assert process.stderr is not None
    assert "note:" in process.stderr.readline()  # the runs have been read; it learns now
    time.sleep(0.3)
    process.send_signal(getattr(signal, signal_name))
    process.communicate(timeout=60.0)
    assert process.returncode != 0
    assert list(tmp_path.iterdir()) == []


# What it refuses


def test_a_run_that_the_simulator_was_learned_from_is_neither_diagnosed_nor_held_out(
    diagnosed: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would explain and judge itself."""
    seen, out = next((runs / "reference").iterdir()), ("-o", tmp_path / "out")
    said = f"{seen}: the simulator was learned from this run; take one that it has not seen"
    assert said in refused(capsys, *measured(runs), "--holdout", seen, "--reference", runs / "reference", *out)
    simulator = ("--simulator", diagnosed / "base.simulator")
    assert said in refused(capsys, *measured(runs), "--holdout", seen, *simulator, *out)
    assert said in refused(capsys, seen, *simulator, *out)
    # an extended one is fitted to what was diagnosed
    one, other = measured(runs)
    extended = refused(capsys, one, "--holdout", other, "--simulator", diagnosed / "extended.simulator", *out)
    assert f"{other}: the simulator was learned from this run" in extended


def test_a_simulator_with_a_swing_of_its_own_is_started_from(diagnosed: Path, runs: Path, tmp_path: Path) -> None:
    swinging = tmp_path / "swinging.simulator"
    shutil.copytree(diagnosed / "base.simulator", swinging)
    table = tomllib.loads((swinging / "simulator.toml").read_text())
    table["extension"] = [{"effect": "circumnutation", "parameters": {"period_h": 1.6, "amplitude_cm": 0.6}}]
    (swinging / "simulator.toml").write_text(tomli_w.dumps(table))
    given = read_runs(measured(runs), lambda _: None)
    start = start_from(given, None, read_stored(swinging), None, lambda *_: pytest.fail("began to learn"))
    known = knowledge_of(start)
    assert known.swing is not None
    assert (known.swing.period_h, known.swing.amplitude_cm) == (1.6, pytest.approx(0.6))
    # what is written beside it is not swung once more when it is read again
    write_known(tmp_path / "again.simulator", start.simulator, start.known, start.provenance)
    again = start_from(given, None, read_stored(tmp_path / "again.simulator"), None, lambda *_: pytest.fail("learned"))
    assert knowledge_of(again).swings.power == pytest.approx(known.swings.power)
    assert start.learned_from.endswith(", and extended with circumnutation")


def test_a_simulator_that_is_damaged_is_told(
    diagnosed: Path, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.simulator"
    shutil.copytree(diagnosed / "base.simulator", bad)
    data = bytearray((bad / "weights.safetensors").read_bytes())
    data[-5] ^= 1
    (bad / "weights.safetensors").write_bytes(bytes(data))
    assert "bad.simulator" in refused(capsys, *measured(runs), "--simulator", bad, "-o", tmp_path / "out")
    gone = refused(capsys, *measured(runs), "--simulator", tmp_path / "gone", "-o", tmp_path / "out")
    assert "gone: no such simulator folder" in gone


def test_what_cannot_be_used_is_told_before_anything_that_is_noted_on_runs(
    runs: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "good.csv"
    shutil.copy(measured(runs)[0], bare)
    out = str(tmp_path / "out")
    for more in (["--simulator", str(tmp_path / "gone")], ["--reference", str(tmp_path), "--holdout", "none"]):
        assert main(["diagnose", str(bare), *more, "-o", out]) == 2
        said = capfd.readouterr().err
        assert (said.count("\n"), "note: " in said) == (1, False)


def test_its_help_is_at_hand(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", "--help"]) == 0
    assert "--reference" in capsys.readouterr().out
