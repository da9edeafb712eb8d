"""``flora-lab evaluate``: simulated plants, the gap to virtual ones, and what is refused."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
import twin_fakes
from evaluate_fakes import GOLDEN, NEAT_EXPORT, TIP_ONLY, check_page, only, refused, told, twin
from simulator_fakes import GROWTH_CM_H, LEAN_CM_H, write_straight

from flora_common.files import sha256_of_file
from flora_common.tracks import read_track
from flora_lab.evaluate.figures import tracks_figure
from flora_lab.evaluate.gap import REAL_PLANTS
from flora_lab.evolve.task import LEFT
from flora_lab.main import main
from flora_lab.simulator.load import KINDS

SHORT = """
name = "short"
hours = 5.0

[target]
x_cm = -5.12
y_cm = 17.9

[[scenario]]
name = "free / easy"
[scenario.obstacle]
x_cm = 30.0
y_cm = 8.8

[[scenario]]
name = "blocked"
possible = false
[scenario.obstacle]
x_cm = 0.0
y_cm = 9.0
"""


@pytest.fixture(autouse=True)
def _straight_plants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(KINDS, "straight", "simulator_fakes:StraightPlant")


@pytest.fixture
def simulator(tmp_path: Path) -> Path:
    """Five hours are enough for 3 cm upwards and 7.5 cm to the side."""
    return write_straight(tmp_path / "fast.simulator", speed=5.0)


@pytest.fixture
def short(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


# In a simulator


def test_numbers_are_those_that_can_be_worked_out(
    simulator: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = told(capsys, TIP_ONLY, "--on", simulator, "--task", short, "--repeat", "2")

    assert (numbers["task"], numbers["repeat"], numbers["seed"]) == ("short", 2, 20001)
    assert only(numbers["simulators"])["weights_sha256"] == sha256_of_file(simulator / "weights.safetensors")
    assert only(numbers["controllers"])["sha256"] == sha256_of_file(TIP_ONLY)
    assert [trial["plant"] for trial in numbers["trials"]] == ["typical", "drawn 1", "drawn 2"] * 2
    free = only(numbers["summary"], scenario="free / easy")
    trial = only(numbers["trials"], scenario="free / easy", plant="typical")
    x, y = trial["tip_at_end_cm"]
    assert y == pytest.approx(6.5 + 5.0 * 5.0 * GROWTH_CM_H)
    assert abs(x) <= 5.0 * 5.0 * LEAN_CM_H + 1e-9
    assert trial["fitness_at_end"] == pytest.approx((5.12 + 17.9 - abs(-5.12 - x) - abs(17.9 - y)) / (5.12 + 17.9))
    assert free["fitness_at_end"]["typical"] == trial["fitness_at_end"] == free["fitness_at_end"]["mean"]
    assert free["ended"] == {"time": 3}
    assert free["hours"] == 5.0
    assert 26.5 - 5.0 * 5.0 * LEAN_CM_H <= free["clearance_cm"] < 27.0
    blocked = only(numbers["summary"], scenario="blocked")
    assert blocked["ended"] == {"collision": 3}
    assert blocked["clearance_cm"] == 0.0
    assert not blocked["is_possible"]
    means = {row["scenario"]: row["fitness_at_end"]["mean"] for row in numbers["summary"]}
    every, possible = (
        only(numbers["averages"], possible_only=flag)["fitness_at_end"]["mean"] for flag in (False, True)
    )
    assert every == pytest.approx(sum(means.values()) / 2)
    assert possible == means["free / easy"]
    assert numbers["gap"] == []
    assert numbers["paper"] is None


def test_a_scenario_alone_and_no_drawn_plants(simulator: Path, short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wanted = ("--task", short, "--scenario", "free / easy", "--repeat", "0")
    numbers = told(capsys, TIP_ONLY, NEAT_EXPORT, "--on", simulator, *wanted)

    assert [row["scenario"] for row in numbers["summary"]] == ["free / easy"] * 2
    assert {row["fitness"]["mean"] for row in numbers["summary"]} == {None}
    assert numbers["averages"] == []


def test_the_papers_tasks_are_known_by_name(simulator: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = told(capsys, TIP_ONLY, "--on", simulator, "--task", "left", "--repeat", "0")
    assert [scenario["name"] for scenario in numbers["scenarios"]] == [s.name for s in LEFT.scenarios]
    assert len(numbers["averages"]) == 2
    numbers = told(capsys, TIP_ONLY, "--on", simulator, "--repeat", "0")
    assert only(numbers["scenarios"])["obstacle_cm"] == [-6.3, 12.5]


def test_the_folder_holds_figures_page_and_tracks(
    tmp_path: Path, simulator: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    numbers = told(capsys, TIP_ONLY, "--on", simulator, "--task", short, "--repeat", "1", "-o", out)

    assert {entry.name for entry in out.iterdir()} == {
        *("evaluation.toml", "evaluation.json", "report.html", "episodes")
    }
    assert json.loads((out / "evaluation.json").read_text()) == numbers
    assert tomllib.loads((out / "evaluation.toml").read_text())["work"]["task"] == "short"
    episodes = sorted((out / "episodes").iterdir())
    assert [path.name for path in episodes] == [
        "001-fast-tip_only-free-easy-typical.csv",
        "002-fast-tip_only-free-easy-drawn-1.csv",
        "003-fast-tip_only-blocked-typical.csv",
        "004-fast-tip_only-blocked-drawn-1.csv",
    ]
    track = read_track(episodes[0])
    assert len(track.time_s) == 61
    assert track.points_cm[-1, -1].tolist() == pytest.approx(numbers["trials"][0]["tip_at_end_cm"], abs=1e-4)
    check_page(out / "report.html", "free / easy", "tip_only", "fast")

    # the same again, in place of it
    before = (out / "report.html").read_bytes()
    told(capsys, TIP_ONLY, "--on", simulator, "--task", short, "--repeat", "1", "-o", out)
    assert (out / "report.html").read_bytes() == before


def test_no_tips_way_leaves_the_picture(
    simulator: Path, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    judged, drawn = [], []
    monkeypatch.setattr("flora_lab.evaluate.page.tracks_figure", lambda one: judged.append(one) or b"")
    monkeypatch.setattr("flora_lab.evaluate.figures.png", lambda figure: drawn.append(figure) or b"")
    told(capsys, TIP_ONLY, "--on", simulator, "--task", short, "--repeat", "0", "-o", tmp_path / "out")
    (one,) = judged
    for trial in one.trials:
        trial.stems_cm[len(trial.stems_cm) // 2, -1] = (-19.0, 12.0)  # far to the left on its way
    tracks_figure(one)
    for ax in drawn[0].axes[: len(one.trials)]:
        for line in ax.lines:
            for values, (low, high) in zip(line.get_data(), (ax.get_xlim(), ax.get_ylim()), strict=True):
                assert all(low <= value <= high for value in values)
        assert ax.get_xlim()[0] < -19.0


def test_what_people_read(simulator: Path, short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(TIP_ONLY), "--on", str(simulator), "--task", str(short), "--repeat", "1"]) == 0
    said = capsys.readouterr().out
    for words in (
        "simulator fast (straight): its typical plant, and 1 plant that it draws",
        "(blocked)",
        "all but the impossible",
        "0/2",
        "A run ends when the stem touches the obstacle (collision), when the tip is 21 cm high (height), or after 5 h",
    ):
        assert words in said
    assert "virtual" not in said


# Against virtual plants


def test_each_run_is_a_process_and_the_gap_is_told(
    tmp_path: Path, simulator: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program, out = twin(tmp_path, monkeypatch), tmp_path / "out"
    numbers = told(capsys, TIP_ONLY, "--on", simulator, "--on", "twin", "--seed", "20000", "-o", out)

    assert [trial["seed"] for trial in numbers["trials"] if trial["place"] == "twin"] == [20000, 20001, 20002]
    real = only(numbers["summary"], place="twin")
    assert real["fitness"] == {"typical": None, "mean": pytest.approx(0.901), "worst": pytest.approx(0.9)}
    assert real["fitness_at_end"]["mean"] == pytest.approx(0.8)
    assert {t["true_clearance_cm"] for t in numbers["trials"]} == {None, 1.25}
    simulated = only(numbers["summary"], place="fast")
    gap = only(numbers["gap"])
    for measure, mean in (("fitness", 0.901), ("fitness_at_end", 0.8)):
        assert gap[measure]["of_typical"] == pytest.approx(simulated[measure]["typical"] - mean)
        assert gap[measure]["of_drawn"] == pytest.approx(simulated[measure]["mean"] - mean)
    assert numbers["paper"]["real_plants_fitness"] == [0.924, 0.92, 0.877] == list(REAL_PLANTS)

    arguments = twin_fakes.calls(program)
    assert len(arguments) == 3
    for wanted in ("--target=-5.12,17.9,2.0", "--obstacle=-6.3,12.5,7.0,3.0", "--hours=72.0", "--stop-height=21.0"):
        assert all(wanted in call for call in arguments)
    runs = sorted((out / "runs").iterdir())
    assert [run.name[-5:] for run in runs] == ["20000", "20001", "20002"]
    for run in runs:
        assert (run / "outcome.json").is_file()
        assert (run / "strip.jpg").stat().st_size > 1000
        assert {entry.name for entry in (run / twin_fakes.RUN).iterdir()} == {"run.toml", "frames.csv", "track.csv"}
        assert not (run / "rig" / "nas").exists()
    text = check_page(out / "report.html", "The reality gap", "92.4, 92.0, 87.7 %", "plant 20002")
    assert text.count("data:image/jpeg") == 3


# What is refused


def test_what_cannot_be_done_is_told_in_a_line(
    tmp_path: Path, simulator: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy.controller.json"
    copy.write_bytes(TIP_ONLY.read_bytes())
    bad = GOLDEN / "bad" / "nan_weight.controller.json"
    twins = write_straight(tmp_path / "twin.simulator")
    on = ("--on", simulator)
    for arguments, said in (
        ((TIP_ONLY, *on, "--task", "lefd"), "did you mean `left`?"),
        ((TIP_ONLY, *on, "--task", short, "--scenario", "blockd"), "did you mean `blocked`?"),
        ((TIP_ONLY, *on, "--scenario", "third"), "task reality has no scenario `third`"),
        ((bad, *on), f"{bad}: "),
        ((tmp_path / "none.controller.json", *on), "cannot be read (No such file or directory)"),
        ((TIP_ONLY, copy, *on), "is the same controller as"),
        ((TIP_ONLY, "--on", tmp_path), "not a simulator, it has no simulator.toml"),
        ((TIP_ONLY, "--on", "twim"), "twim: no such simulator folder"),
        ((TIP_ONLY, *on, *on), "is given twice"),
        ((TIP_ONLY, "--on", twins), "would be taken for the virtual rig"),
        ((TIP_ONLY, "--on", "twin", "--repeat", "0"), "--repeat 0"),
        ((TIP_ONLY,), "--on"),
        ((*on,), "CONTROLLER"),
    ):
        assert said in refused(capsys, *arguments)


def test_a_folder_that_holds_something_else_is_left_alone(
    tmp_path: Path, simulator: Path, short: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = twin(tmp_path, monkeypatch)
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work")
    for on in (simulator, "twin"):
        assert "holds other files" in refused(capsys, TIP_ONLY, "--on", on, "-o", out)
        file = out / "thesis.tex"
        assert f"{file}: is a file; name a new folder with -o" in refused(capsys, TIP_ONLY, "--on", on, "-o", file)
    assert [entry.name for entry in out.iterdir()] == ["thesis.tex"]

    mine = tmp_path / "mine"
    told(capsys, TIP_ONLY, "--on", "twin", "--repeat", "1", "-o", mine)
    before = (mine / "evaluation.json").read_bytes()
    for arguments, what in (
        ((NEAT_EXPORT, "--on", "twin"), "controllers was"),
        ((TIP_ONLY, "--on", "twin", "--seed", "5"), "seed was 20001 and is 5"),
        ((TIP_ONLY, "--on", "twin", "--task", short), "task was reality and is short"),
    ):
        assert what in refused(capsys, *arguments, "-o", mine)
    (run,) = (mine / "runs").iterdir()
    outcome = json.loads((run / "outcome.json").read_text())
    (run / "outcome.json").write_text(json.dumps({**outcome, "hours": 5.0}))
    assert "is of another run, hours differs" in refused(capsys, TIP_ONLY, "--on", "twin", "-o", mine)
    (run / "outcome.json").write_text("{")
    assert "not the outcome of an experiment" in refused(capsys, TIP_ONLY, "--on", "twin", "-o", mine)
    assert (mine / "evaluation.json").read_bytes() == before
    assert len(twin_fakes.calls(program)) == 1
