"""``flora-lab rollout``: what it prints, writes and refuses; and simulators by their folder."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from simulator_fakes import StraightPlant, straight_run, write_straight, write_track

from flora_common.errors import BadInput
from flora_lab.main import main
from flora_lab.rollout.report import hours_text
from flora_lab.simulator.load import KINDS, load
from flora_twin.main import main as twin

GROWTHS = (0.06, 0.08, 0.1, 0.12, 0.14, 0.16, 0.2)


@pytest.fixture(autouse=True)
def _straight_plants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "straight", "simulator_fakes:StraightPlant")


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Seven plants that grow at their own rates, 40 h."""
    folder = tmp_path_factory.mktemp("tracks")
    made = [
        write_track(folder / f"bean{i}.csv", straight_run(f"bean{i}", hours=40.0, growth_cm_h=growth))
        for i, growth in enumerate(GROWTHS)
    ]
    return [str(path) for path in made]


def numbers(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["rollout", *map(str, arguments), "--json"]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


def found(told: dict[str, Any], part: str, **wanted: object) -> dict[str, Any]:
    (one,) = [entry for entry in told[part] if all(entry[name] == value for name, value in wanted.items())]
    return dict(one)


def test_numbers_are_those_that_can_be_worked_out(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    shifted = write_straight(tmp_path / "shifted.simulator", shift_cm=0.3)
    told = numbers(capsys, shifted, *tracks)
    assert told["simulators"] == ["shifted", "nothing-moves", "goes-on"]
    assert (told["plants"], told["step_s"], told["watch_h"]) == (7, 300.0, 12.0)
    # it knows what it watched; what is left is the shift
    own = {"start": "watched", "horizon_h": 24.0, "measure": "tip_mm"}
    error = found(told, "errors", **own, simulator="shifted")
    assert [error["value"], error["low"], error["high"]] == pytest.approx([3.0] * 3, abs=1e-3)
    still = found(told, "errors", **own, simulator="nothing-moves")
    assert still["value"] == pytest.approx(10 * 24 * 0.12, abs=0.01)
    assert still["low"] < still["value"] < still["high"]
    between = found(told, "differences", **own, other="nothing-moves")
    assert between["difference"]["value"] == pytest.approx(3.0 - 28.8, abs=0.01)
    assert between["difference"]["high"] < 0.0
    assert between["times_better"]["value"] == pytest.approx(9.6, abs=0.01)
    for name, growth in (("bean0", 0.06), ("bean6", 0.2)):
        run = found(told, "per_run", start="unseen", horizon_h=None, simulator="nothing-moves", run=name)
        sideways = 4 * 0.3  # of seven lamps the last has shone for four hours
        assert run["value"] == pytest.approx(10 * np.hypot(40 * growth, sideways), abs=0.01)


def test_others_are_compared_and_time_scales_found(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    right, fast = write_straight(tmp_path / "right.simulator"), write_straight(tmp_path / "fast.simulator", speed=2.0)
    told = numbers(capsys, right, *tracks, "--against", fast, "--time-scale")
    names = told["simulators"]
    assert [names[0], names[1], *names[-2:]] == ["right", "fast", "nothing-moves", "goes-on"]
    scaled = [name for name in names if name.startswith("fast at time scale")]
    assert len(scaled) == 1
    factor = told["time_scales"]["fast"]["factor"]
    assert factor["low"] <= 2.0 <= factor["high"]
    assert factor["value"] == pytest.approx(2.0, rel=0.1)  # the plants grow at rates of their own
    place = {"start": "unseen", "horizon_h": 24.0, "measure": "tip_mm"}
    as_is = found(told, "differences", **place, other="fast")
    at_best = found(told, "differences", **place, other=scaled[0])
    assert as_is["times_better"]["value"] > 2 * at_best["times_better"]["value"]


def test_what_people_read(tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    simulator = write_straight(tmp_path / "shifted.simulator", shift_cm=0.3, beyond_cm=13.0)
    assert main(["rollout", str(simulator), *tracks]) == 0
    said = capsys.readouterr().out
    print(said)
    assert said.count("3.00 [3.00, 3.00]") >= 8
    for words in (
        "tip error of each run, mm",
        "running free from the first stem: median over plants",
        "running free after watching 12 h, and again every 6 h",
        "whole-stem error, mm",
        "growth, %",
        "shifted minus another",
        "7 runs of 7 plants; in brackets 95 % intervals, by resampling plants.",
        "shifted, running free from the first stem, left the data that it was made from in 7 of 7 runs, "
        "first after 33.4 h",
    ):
        assert words in said
    per_run = [line.split() for line in said.splitlines() if line.startswith("bean")]
    assert [line[:2] for line in per_run] == [[f"bean{i}", "40.0"] for i in range(7)]
    assert {line[2] for line in per_run} == {"3.00"}
    assert max(map(len, said.splitlines())) < 240
    assert "at time scale" not in said


def test_few_and_short_runs_are_told_as_what_they_are(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    simulator = write_straight(tmp_path / "right.simulator")
    assert main(["rollout", str(simulator), tracks[0], tracks[1]]) == 0
    said = capsys.readouterr().out
    assert "2 runs of 2 plants: no intervals" in said
    assert "[" not in said
    short = write_track(tmp_path / "short.csv", straight_run("short", hours=5.0))
    assert main(["rollout", str(simulator), str(short)]) == 0
    said = capsys.readouterr().out
    assert "The longest run is 5 h; nothing is told after watching 12 h" in said
    assert "running free after watching" not in said
    told = numbers(capsys, simulator, short, "--watch-h", "2", "--horizons", "0.5,1")
    assert found(told, "errors", start="watched", horizon_h=0.5, measure="tip_mm", simulator="right")["plants"] == 1
    assert found(told, "errors", start="unseen", horizon_h=None, measure="growth", simulator="right")["low"] is None


def test_a_folder_with_numbers_and_pictures(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    fast = write_straight(tmp_path / "fast.simulator", speed=20.0)
    (tmp_path / "again").mkdir()
    twin_run = write_track(tmp_path / "again" / "bean1.csv", straight_run("other", hours=13.0, growth_cm_h=0.11))
    arguments = ["rollout", str(fast), *tracks[:3], str(twin_run)]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0
    assert f"wrote {tmp_path / 'out'}" in capsys.readouterr().out
    files = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*"))
    runs = [f"runs/bean{i}.png" for i in ("0", "1-2", "1", "2")]
    assert files == ["errors.png", "rollout.json", *runs]
    written = json.loads((tmp_path / "out" / "rollout.json").read_text())
    assert written == numbers(capsys, *arguments[1:])
    for path in (tmp_path / "out").rglob("*.png"):
        picture = cv2.imread(str(path))
        assert picture is not None
        assert picture.shape[1] > 1000
        # measured stems, and both simulated ones in colours that everybody tells apart
        for colour in ((0x72, 0xB2, 0x00), (0xD5, 0x5E, 0x00)) if path.parent.name == "runs" else ():
            wanted = {(0x72, 0xB2, 0x00): (0xB2, 0x72, 0x00), (0xD5, 0x5E, 0x00): (0x00, 0x5E, 0xD5)}[colour]
            assert (np.abs(picture.astype(int) - wanted).max(axis=2) < 12).sum() > 20, path
    # the same again, to the byte
    assert main([*arguments, "-o", str(tmp_path / "twice"), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    for name in files:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "twice" / name).read_bytes()


def test_virtual_runs_are_judged_from_their_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = tmp_path / "runs"
    made = ["--open-loop", "0", "--closed-loop", "0", "--random", "3", "--seed", "50", "--hours", "14"]
    assert twin(["runs", "-o", str(runs), *made]) == 0
    told = numbers(capsys, write_straight(tmp_path / "straight.simulator"), *sorted(runs.iterdir()))
    assert [run["plant"] for run in told["runs"]] == [f"virtual bean, seed {i}" for i in (50, 51, 52)]
    assert [run["rows"] for run in told["runs"]] == [14 * 12 + 1] * 3
    own = found(told, "errors", start="unseen", horizon_h=6.0, measure="tip_mm", simulator="straight")
    assert own["low"] < own["value"] < own["high"]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--horizons", "1,soon"], "`soon` is not a number of hours"),
        (["--horizons", "-1"], "does not lie in"),
        (["--horizons", "nan"], "does not lie in"),
        (["--horizons", "0.1"], "0.1 h is not a whole number of the simulator's steps of 300 s"),
        (["--watch-h", "0"], "--watch-h: 0 does not lie in"),
        (["--watch-h", "nan"], "--watch-h: nan does not lie in"),
        (["--against", "SIM"], "is given twice"),
        (["--against", "nowhere"], "no such simulator folder"),
        (["nowhere.csv"], "no such run or track"),
        (["TRACK"], "is the same track as"),
        (["--seed", "-1"], "--seed"),
    ],
)
def test_bad_input_is_told_in_one_line(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str], more: list[str], said: str
) -> None:
    simulator = write_straight(tmp_path / "right.simulator")
    named = {"SIM": str(simulator), "TRACK": tracks[0]}
    arguments = [named.get(word, word) for word in more]
    assert main(["rollout", str(simulator), tracks[0], *arguments, "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_light_that_the_simulator_does_not_know_is_told_with_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulator = write_straight(tmp_path / "right.simulator")
    run = straight_run("bean", hours=2.0)
    run.light[7] = (1.0, 1.0)
    track = write_track(tmp_path / "bean.csv", run)
    assert main(["rollout", str(simulator), str(track)]) == 2
    assert capsys.readouterr().err == (
        "flora-lab: right: light is not one lamp; this plant knows left and right only\n"
    )


def test_what_is_there_is_kept(tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    simulator = write_straight(tmp_path / "right.simulator")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    assert main(["rollout", str(simulator), *tracks, "-o", str(tmp_path / "out")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert (tmp_path / "out" / "mine").read_text() == "kept"


# Simulators by their folder


def test_simulators_that_are_called_alike_are_told_apart(
    tmp_path: Path, tracks: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = write_straight(tmp_path / "a" / "bean"), write_straight(tmp_path / "b" / "bean", speed=2.0)
    still = write_straight(tmp_path / "nothing-moves.simulator")
    told = numbers(capsys, one, *tracks, "--against", other, "--against", still)
    assert told["simulators"] == [str(one), str(other), str(still), "nothing-moves", "goes-on"]


def test_a_folder_is_the_simulator_that_it_holds(tmp_path: Path) -> None:
    simulator = load(write_straight(tmp_path / "one", speed=3.0))
    assert isinstance(simulator, StraightPlant)
    assert simulator.speed == 3.0


def test_an_unknown_kind_is_refused_with_those_that_are_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_straight(tmp_path / "one")
    monkeypatch.delitem(KINDS, "straight")
    with pytest.raises(
        BadInput, match=r"kind `straight` is not known; this program reads paper, sequence, mechanistic"
    ):
        load(path)


def test_help_does_not_wait_for_heavy_libraries() -> None:
    code = (
        "import sys, flora_lab.main; print([m for m in ('scipy', 'matplotlib', 'torch', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(("steps", "words"), [(0, "end"), (1, "5 min"), (6, "30 min"), (12, "1 h"), (18, "1.5 h")])
def test_horizons_in_words(steps: int, words: str) -> None:
    assert hours_text(steps, 300.0) == words
