"""What a diagnosis is worth to controllers: compared after it, told on a terminal, in its JSON and on its page."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from diagnose_fakes import colours_in
from evolve_simulators import mechanistic
from html_reader import Reader

from flora_lab.diagnose import controllers, controllers_told, figures, figures_of_runs, folder, table, work
from flora_lab.diagnose.controller_gain import Effort, bred, controller_gain
from flora_lab.diagnose.diagnosis import Diagnosis, Gain, NamedCause, NextExperiment, Residuals
from flora_lab.diagnose.figures_of_controllers import controllers as drawn
from flora_lab.diagnose.page import page
from flora_lab.evolve.task import LEFT, REALITY
from flora_lab.main import main
from flora_lab.simulator.store import Extension

LITTLE = Effort(seeds=2, generations=2, population=6, individuals=1, judges=3)
SHORT = replace(REALITY, name="short <b>", hours=12.0)
SAG = NamedCause("sag", {"amplitude": 0.9}, {"amplitude": (0.8, 1.0)}, 0.97, 0.002, [], "It sags.", 40.0)
EXTENSION = Extension("sag", SAG.parameters)
SHOWN = Gain(free_running={"end": {"base": 16.0, "extended": 7.0}}, one_step={"base": 0.63, "extended": 0.62})


def result(*extensions: Extension, judged: Any = None) -> Any:
    """A diagnosis of a plant that sags, or of one that has nothing."""
    start = work.Start(mechanistic(), Any, None, Any, "", is_new=False, judged=judged)
    found = Diagnosis(
        "explained" if extensions else "nothing_wrong",
        [SAG] if extensions else [],
        Residuals({}, {}, 9.0, True, "It is off."),
        SHOWN if extensions else Gain(),
        NextExperiment(),
        "All in all.",
    )
    extended = mechanistic().extended(extensions) if extensions else None
    return work.Result(start, found, Any, Any, None, extended, extensions, Any)


def compared(
    of: Any, effort: Effort = LITTLE, task: Any = SHORT
) -> tuple[dict[str, Any], dict[str, list[int]], list[str]]:
    """What controllers came to; by stage how many steps it began with, and how many there were; and the notes."""
    stages: dict[str, list[int]] = {}
    notes: list[str] = []

    def stage(name: str, total: int) -> Callable[[], None]:
        stages[name] = [total, 0]

        def step() -> None:
            stages[name][1] += 1

        return step

    told = controllers.compared(of, task, stage, notes.append, effort)
    assert msgspec.structs.replace(told.diagnosis, gain=of.diagnosis.gain) == of.diagnosis
    return told.diagnosis.gain.controller_fitness, stages, notes


@functools.cache
def filled() -> dict[str, Any]:
    return compared(result(EXTENSION))[0]


# What is compared


@pytest.mark.slow
def test_both_kinds_are_compared_on_plants_with_what_was_found() -> None:
    fitness, stages, notes = compared(result(EXTENSION))
    assert notes == []
    assert stages == {"evolving controllers": [4, 4], "evolving light plans": [4, 4]}
    assert list(fitness) == ["feedback", "plan"]
    base = mechanistic()
    for kind, told in fitness.items():
        assert {"base", "extended", "without_effect", "cost", "difference", "recovered"} <= set(told)
        # stems that sag end elsewhere: the plants have the effect, and those of the base have not
        assert told["base"]["of_plants"] != told["without_effect"]["of_plants"]
        assert told["cost"]["mean"] == pytest.approx(told["without_effect"]["mean"] - told["base"]["mean"], abs=2e-4)
        assert told["difference"]["mean"] == pytest.approx(told["extended"]["mean"] - told["base"]["mean"], abs=2e-4)
        for name in ("base", "extended", "without_effect"):
            assert len(told[name]["of_plants"]) == LITTLE.judges
            assert len(told[name]["of_seeds"]) == LITTLE.seeds
            assert np.mean(told[name]["of_plants"]) == pytest.approx(told[name]["mean"], abs=1e-4)
            assert min(told[name]["of_plants"]) == told[name]["worst_plant"]
        plant = base.extended([EXTENSION])
        alone = controller_gain(bred(SHORT, base, kind, LITTLE), bred(SHORT, plant, kind, LITTLE), plant)  # type: ignore[arg-type]
        assert told == alone | {"judged_on": told["judged_on"]}
        assert "2 evolutions in the simulator as it is and 2 in the extended one" in told["judged_on"]
        assert "the same 3 plants" in told["judged_on"]
    assert msgspec.json.decode(msgspec.json.encode(fitness)) == fitness


def test_a_light_plan_is_made_for_one_scenario() -> None:
    least = Effort(seeds=1, generations=1, population=4, individuals=1, judges=2)
    task = replace(LEFT, name="some", scenarios=LEFT.scenarios[2:], hours=2.0)
    assert not task.scenarios[0].is_possible
    fitness = compared(result(EXTENSION), least, task)[0]
    plant = mechanistic().extended([EXTENSION])
    for kind, own in (("feedback", task), ("plan", replace(task, scenarios=LEFT.scenarios[3:]))):
        in_both = [bred(own, one, kind, least) for one in (mechanistic(), plant)]  # type: ignore[arg-type]
        alone = controller_gain(*in_both, plant)
        assert fitness[kind]["extended"] == alone["extended"]
    assert "Light plans are made for its scenario fourth alone." in fitness["plan"]["judged_on"]
    assert "Light plans are made" not in filled()["plan"]["judged_on"]


def test_threads_change_nothing() -> None:
    assert compared(result(EXTENSION), replace(LITTLE, threads=3))[0] == filled()


def test_beside_a_learned_simulator_the_mechanistic_one_is_told() -> None:
    least = Effort(seeds=1, generations=1, population=4, individuals=1, judges=2)
    fitness = compared(result(EXTENSION, judged=object()), least, replace(SHORT, hours=2.0))[0]
    assert "as it is, the mechanistic one beside the one that was given, and" in fitness["plan"]["judged_on"]


@pytest.mark.parametrize(
    ("extensions", "said"),
    [
        ((), "nothing that acts on plants was found"),
        ((Extension("temperature_growth", {"per_degree": 0.05}),), "nothing but an answer to the temperature"),
    ],
)
def test_without_an_extension_there_is_nothing_to_compare(extensions: tuple[Extension, ...], said: str) -> None:
    fitness, stages, notes = compared(result(*extensions))
    assert (fitness, stages) == ({}, {})
    (note,) = notes
    assert note.startswith(said)


# The command


def diagnosed_at_once(monkeypatch: pytest.MonkeyPatch, told: Any) -> list[Any]:
    """The command without its diagnosis and with little evolution; the results that it writes."""
    written: list[Any] = []

    def write(path: Path, own: Any) -> None:
        written.append(own)
        path.mkdir()

    monkeypatch.setattr(work, "diagnose", lambda *_, **__: told)
    monkeypatch.setattr(folder, "write", write)
    monkeypatch.setattr(controllers, "EFFORT", LITTLE)
    return written


def arguments(out: Path, *more: str) -> list[str]:
    return ["diagnose", "run", "--reference", "healthy", "-o", str(out), *more]


def test_the_command_compares_and_tells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    task = tmp_path / "task.toml"
    target, obstacle = "target = {x_cm = -8.0, y_cm = 17.0}", "obstacle = {x_cm = -8.24, y_cm = 8.8}"
    task.write_text(f'name = "short"\nhours = 12.0\n{target}\n{obstacle}\n[[scenario]]\nname = "one"\n')
    written = diagnosed_at_once(monkeypatch, result(EXTENSION))
    assert main(arguments(tmp_path / "out", "--controllers", str(task))) == 0
    said = capsys.readouterr()
    assert said.err == ""
    (own,) = written
    fitness = msgspec.json.decode(folder.as_json(own))["gain"]["controller_fitness"]
    assert {told["task"] for told in fitness.values()} == {"short"}
    assert table.text(own) in said.out
    assert controllers_told.sentence(fitness["plan"]) in said.out
    assert f"{fitness['feedback']['extended']['mean']:.3f}" in said.out
    assert max(map(len, controllers_told.lines(fitness)[:8])) <= 100


def test_a_plant_that_has_nothing_is_diagnosed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written = diagnosed_at_once(monkeypatch, result())
    assert main(arguments(tmp_path / "out", "--controllers", "round")) == 0
    said = capsys.readouterr()
    assert said.err.startswith("note: nothing that acts on plants was found")
    assert said.out.startswith("verdict: nothing wrong")
    assert written[0].diagnosis.gain.controller_fitness == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "ruond",
            "--controllers ruond: neither a built-in task (left, middle, reality, round) nor a file; did you mean",
        ),
        ("", "--controllers : neither a built-in task"),
        ("none.toml", "none.toml: cannot be read"),
    ],
)
def test_a_task_that_is_none_is_refused_before_anything_is_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    begun: list[None] = []
    monkeypatch.setattr(work, "diagnose", lambda *_, **__: begun.append(None))
    assert main(arguments(tmp_path / "out", "--controllers", text)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert begun == []
    assert list(tmp_path.iterdir()) == []


def test_stopped_among_the_controllers_it_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    written = diagnosed_at_once(monkeypatch, result(EXTENSION))
    monkeypatch.setattr(controllers, "controller_gain", stopped)
    assert main(arguments(tmp_path / "out", "--controllers", "round")) != 0
    assert written == []
    assert list(tmp_path.iterdir()) == []


def test_what_the_command_does_is_enough_to_tell() -> None:
    assert controllers.EFFORT.seeds >= 5
    assert controllers.EFFORT.judges >= 20
    assert controllers.EFFORT.individuals > 1


# How it is told


def kind_of(cost: tuple[float, float], difference: tuple[float, float], recovered: float | None) -> dict[str, Any]:
    told = dict(filled()["plan"], recovered=recovered)
    for name, (mean, error) in (("cost", cost), ("difference", difference)):
        told[name] = {"mean": mean, "standard_error": error}
    return told


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (
            ((0.1, 0.01), (0.08, 0.01), 0.8),
            "costs those of the simulator as it is 0.100 ± 0.010 of their fitness; those of the extended one are "
            "0.080 ± 0.010 better, which brings back 80 % of it.",
        ),
        (((0.1, 0.01), (0.2, 0.01), 2.0), "0.200 ± 0.010 better, which brings back 100 % of it."),
        (((0.1, 0.01), (0.02, 0.02), 0.2), "0.020 ± 0.020 better, no more than chance."),
        (((0.1, 0.01), (-0.05, 0.01), -0.5), "0.050 ± 0.010 worse."),
        (
            ((0.01, 0.02), (0.05, 0.01), None),
            "fitness, no more than chance; those of the extended one are 0.050 ± 0.010 b",
        ),
        (((-0.01, 0.02), (-0.01, 0.02), None), "−0.010 ± 0.020 of their fitness, no more than chance"),
    ],
)
def test_no_more_is_said_than_is_known(told: tuple[Any, Any, Any], said: str) -> None:
    sentence = controllers_told.sentence(kind_of(*told))
    assert sentence.startswith("Light plans, which see nothing: what was found costs")
    assert said in sentence


def test_the_page_shows_fitness_scatter_and_collisions() -> None:
    gain = msgspec.structs.replace(SHOWN, controller_fitness=filled())
    own = msgspec.structs.replace(result(EXTENSION).diagnosis, gain=gain)
    text = page(own, {"controllers": drawn(filled())})
    assert "<b>:" not in text  # the task's name is text
    read = Reader(text)
    assert "What it gains where it counts: controllers" in read.text
    assert "not whether they are" in read.text
    assert sum(tag == "img" for tag, _ in read.tags) == 1
    for told in filled().values():
        assert controllers_told.sentence(told) in read.text
        for name in ("base", "extended", "without_effect"):
            assert f"{told[name]['sd_of_plants']:.3f}" in read.cells
            assert f"{100.0 * told[name]['collisions']:.0f} %" in read.cells
    assert "controllers" not in Reader(page(result(EXTENSION).diagnosis, {})).text


def test_the_picture_shows_both_simulators_and_is_the_same_again() -> None:
    picture = drawn(filled())
    assert {(0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)} <= colours_in(picture)
    assert drawn(filled()) == picture
    assert colours_in(drawn({"plan": filled()["plan"]}))


def test_the_folder_has_the_picture_where_controllers_were_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, names in ((figures_of_runs, ("paths", "stems")), (figures, ("by_phase", "along_stem", "spectra"))):
        for name in names:
            monkeypatch.setattr(module, name, lambda *_: b"")
    monkeypatch.setattr(figures, "evidence", lambda *_: b"")
    monkeypatch.setattr(folder, "film", lambda *_: b"")
    explanation = SimpleNamespace(stages=[SimpleNamespace(tried=[])], swing=None, claim=5.0)
    own = replace(result(EXTENSION), explanation=explanation)
    assert "controllers" not in folder.pictures_of(own)
    gain = msgspec.structs.replace(SHOWN, controller_fitness=filled())
    own = replace(own, diagnosis=msgspec.structs.replace(own.diagnosis, gain=gain))
    assert folder.pictures_of(own)["controllers"] == drawn(filled())
