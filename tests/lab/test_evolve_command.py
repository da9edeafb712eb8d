"""``flora-lab evolve`` as it is used: what it writes, what it refuses, and that nothing is lost."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evolution_examples import GENERATIONS, POPULATION, RUNS, TASK, contents, write_rod, write_task
from evolve_reference import run_episodes
from msgspec import structs

from flora_common.controller_file import load_controller
from flora_common.runs import LampsSection
from flora_lab.evolve import plan, summary
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.evolution_folder import read_evolution, standing
from flora_lab.evolve.individuals import HELD_OUT, Individuals
from flora_lab.evolve.kept_runs import kept_path
from flora_lab.evolve.reach import reach
from flora_lab.main import main
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.load import load
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

SHOWN = DataRange(30.0, 10.0)

STRIKES = """
import os, signal, sys
from functools import partial
from flora_lab.evolve import crew, evolution
from flora_lab.main import main

crew.SliceWork = partial(crew.SliceWork, seconds=0.0)
save = evolution.KeptRuns.save
saved = 0

def save_and_strike(self, number, state):
    global saved
    save(self, number, state)
    saved += 1
    if saved == 7:
        os.kill(os.getpid(), signal.{signal})

evolution.KeptRuns.save = save_and_strike
sys.exit(main(sys.argv[1:]))
"""

WAITS = """
import sys
from flora_lab.evolve import evolution
from flora_lab.main import main

save = evolution.KeptRuns.save
is_told = False

def save_and_wait(self, number, state):
    global is_told
    save(self, number, state)
    if not is_told:
        is_told = True
        print("saved", flush=True)
        sys.stdin.readline()

evolution.KeptRuns.save = save_and_wait
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rod(tmp_path_factory.mktemp("simulator") / "rod.simulator")


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_task(tmp_path_factory.mktemp("task") / "short.toml")


def arguments(simulator: Path, task: Path, output: Path, *more: str) -> list[str]:
    few = ["--runs", str(RUNS), "--generations", str(GENERATIONS), "--population", str(POPULATION)]
    words = ["evolve", str(simulator), "--task", str(task), "-o", str(output), *few]
    return [*words, "--jobs", "1", "--no-report", *more]


@pytest.fixture(scope="module")
def evolved(simulator: Path, task: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("evolved") / "left"
    assert main(arguments(simulator, task, output, "--quiet")) == 0
    return output


def test_it_says_what_came_out(simulator: Path, task: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(arguments(simulator, task, tmp_path / "e")) == 0
    said = capsys.readouterr().out
    assert re.search(r"^fitness +\d+\.\d % median over runs, \d+\.\d % best \(run \d, generation \d\)$", said, re.M)
    assert "without the scenarios that no plant can do" in said
    assert all(f"{scenario.name}: " in said for scenario in TASK.scenarios)
    assert said.endswith(f"wrote {tmp_path / 'e'}\n")
    assert not kept_path(tmp_path / "e").exists()


def test_one_run_of_one_generation_is_told_without_plural(evolved: Path) -> None:
    one = structs.replace(read_evolution(evolved).info, runs=1, generations=1)
    assert f"{TASK.name}: 1 run of 1 generation, population {POPULATION}\n" in summary.text(one, evolved)


def test_json_holds_the_figures_of_the_folder(simulator: Path, task: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(arguments(simulator, task, tmp_path / "e", "--json")) == 0
    told = json.loads(capsys.readouterr().out)
    evolution = read_evolution(tmp_path / "e")
    assert told["best_fitness"] == max(run.best_fitness for run in evolution.info.run)
    assert told["median_best_fitness"] == np.median(evolution.history.best_so_far[:, -1])
    assert told["best_controller_sha256"] == load_controller(evolution.best).sha256


def test_the_folder_reads_back(evolved: Path) -> None:
    evolution = read_evolution(evolved)
    assert evolution.task == TASK
    assert evolution.history.by_scenario.shape == (RUNS, GENERATIONS, len(TASK.scenarios))
    assert len(evolution.controllers) == RUNS
    assert evolution.best.read_bytes() == evolution.controllers[evolution.info.best_run - 1].read_bytes()


def test_champions_do_in_the_simulator_what_is_told_of_them(evolved: Path, simulator: Path) -> None:
    evolution = read_evolution(evolved)
    champions = [FromFile(load_controller(path)) for path in evolution.controllers]
    outcomes = run_episodes(champions, load(simulator), TASK)
    for run, fitness in zip(evolution.info.run, outcomes.fitness[:, :, 0], strict=True):
        assert fitness.tolist() == run.by_scenario
        assert float(fitness.mean()) == run.best_fitness
    for episode, fitness in zip(evolution.episodes, outcomes.fitness[evolution.info.best_run - 1, :, 0], strict=True):
        assert episode.fitness == fitness
        assert len(episode.is_right) == len(episode.stems_cm) - 1 <= TASK.most_steps


def test_the_best_on_drawn_plants_is_chosen_by_plants_that_nothing_was_evolved_on(
    simulator: Path, task: Path, tmp_path: Path, capsys: Any
) -> None:
    assert main(arguments(simulator, task, tmp_path / "e", "--individuals", "2")) == 0
    assert f"of the best on {HELD_OUT} plants that nothing was evolved on" in capsys.readouterr().out
    evolution = read_evolution(tmp_path / "e")
    info = evolution.info
    seeds = Individuals(2 + HELD_OUT).seeds()
    assert seeds is not None

    champions = [FromFile(load_controller(path)) for path in evolution.controllers]
    fitness = run_episodes(champions, load(simulator), TASK, seeds).fitness.mean(axis=1)

    told = [run.held_out_fitness for run in info.run]
    assert np.abs(fitness[:, 2:].mean(axis=1) - np.array(told, dtype=float)).max() < 1e-12
    assert np.abs(fitness[:, :2].mean(axis=1) - [run.best_fitness for run in info.run]).max() < 1e-12
    assert info.best_run == 1 + told.index(max(told, key=float))
    assert info.individuals.held_out == HELD_OUT
    assert load_controller(evolution.best).file.provenance["fitness_held_out"] == max(told, key=float)


def test_runs_are_ranked_by_held_out_fitness_where_there_is_one(evolved: Path) -> None:
    run = read_evolution(evolved).info.run[0]

    assert run.held_out_fitness is None
    assert standing(run) == run.best_fitness
    assert standing(structs.replace(run, best_fitness=0.9, held_out_fitness=0.4)) == 0.4


def test_champions_say_where_they_are_from(evolved: Path) -> None:
    info = read_evolution(evolved).info
    for number, run in enumerate(info.run, start=1):
        provenance = load_controller(evolved / run.controller).file.provenance
        assert provenance["simulator_sha256"] == info.simulator.weights_sha256
        assert provenance["dataset_sha256"] == "d" * 64
        assert (provenance["seed"], provenance["run"]) == (1, number)
        assert provenance["fitness"] == run.best_fitness
        assert [provenance[f"fitness {scenario.name}"] for scenario in TASK.scenarios] == run.by_scenario


def test_champions_say_which_stems_the_evolution_met(evolved: Path, simulator: Path) -> None:
    evolution = read_evolution(evolved)
    (met,) = {load_controller(path).file.stem_range for path in evolution.controllers}

    assert met == reach(load(simulator), TASK, Individuals())
    for episode in evolution.episodes:
        assert [met.beyond(stem)[0] for stem in episode.stems_cm] == [0.0] * len(episode.stems_cm)


@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_stopped_and_resumed_is_straight(
    simulator: Path, task: Path, evolved: Path, name: str, tmp_path: Path, capsys: Any
) -> None:
    words = arguments(simulator, task, tmp_path / "e")
    struck = subprocess.run(
        [sys.executable, "-c", STRIKES.format(signal=name), *words], capture_output=True, text=True, timeout=120
    )
    assert struck.returncode == {"SIGKILL": -signal.SIGKILL, "SIGTERM": 128 + signal.SIGTERM, "SIGINT": 130}[name]
    assert not (tmp_path / "e").exists()
    if name != "SIGKILL":
        assert f"the runs are kept in {kept_path(tmp_path / 'e')}" in struck.stderr
        assert "Traceback" not in struck.stderr
    assert main(words) == 2
    assert "--resume goes on with it" in capsys.readouterr().err
    assert main([*words, "--resume"]) == 0
    assert "s in 2 commands; of all work" in capsys.readouterr().out
    assert contents(tmp_path / "e") == contents(evolved)
    assert not kept_path(tmp_path / "e").exists()
    straight, gone_on = (read_evolution(path).info.took for path in (evolved, tmp_path / "e"))
    assert (straight.commands, gone_on.commands) == (1, 2)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_second_command_on_the_same_output_is_told_who_works_there(
    simulator: Path, task: Path, evolved: Path, jobs: str, tmp_path: Path, capsys: Any
) -> None:
    words = [*arguments(simulator, task, tmp_path / "e", "--quiet"), "--jobs", jobs]
    first = subprocess.Popen(
        [sys.executable, "-c", WAITS, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with first:
        assert first.stdout is not None
        assert first.stdout.readline() == "saved\n"
        before = {path.name: path.read_bytes() for path in kept_path(tmp_path / "e").iterdir()}
        for more in ([], ["--resume"], ["--force"]):
            assert main([*words, *more]) == 2
            told = capsys.readouterr().err
            assert f"process {first.pid} works in it" in told
            assert told.count("\n") == 1
        assert {path.name: path.read_bytes() for path in kept_path(tmp_path / "e").iterdir()} == before
        first.communicate("\n", timeout=120)
    assert first.returncode == 0
    assert contents(tmp_path / "e") == contents(evolved)


def test_what_is_kept_of_other_work_is_not_gone_on_with(
    simulator: Path, task: Path, tmp_path: Path, capsys: Any
) -> None:
    words = arguments(simulator, task, tmp_path / "e")
    kept_path(tmp_path / "e").mkdir()
    (kept_path(tmp_path / "e") / "work.json").write_text('{"seed": 7}')
    assert main([*words, "--resume"]) == 2
    assert "is of other work" in capsys.readouterr().err
    assert main([*words, "--force", "--quiet"]) == 0


def test_where_nothing_is_kept_resume_says_that_it_begins(
    simulator: Path, task: Path, tmp_path: Path, capsys: Any
) -> None:
    words = arguments(simulator, task, tmp_path / "e", "--resume")
    assert main(words) == 0
    told = capsys.readouterr().err
    assert told == f"{kept_path(tmp_path / 'e')}: nothing is kept there to go on from; starting from the beginning\n"
    assert main([*words, "--force", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_an_evolution_is_replaced_only_with_force(simulator: Path, task: Path, evolved: Path, capsys: Any) -> None:
    before = contents(evolved)
    assert main(arguments(simulator, task, evolved)) == 2
    assert "add --force" in capsys.readouterr().err
    assert main(arguments(simulator, task, evolved, "--force", "--quiet")) == 0
    assert contents(evolved) == before


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--population", "1"], "a population needs 2 genomes or more"),
        (["--task", "lift"], "neither a built-in task"),
        (["--jobs", "2", "--cluster", "auto"], "leave one of them out"),
        (["--neat", "nowhere.cfg"], "--neat nowhere.cfg: neither flora's own nor a file"),
        (["--runs", "0"], "--runs"),
        (["--judge", "best"], "--judge"),
        (["--judge", "worst"], "--judge: has no effect, no plants are drawn without --individuals"),
        (["--individuals-seed", "1"], "--individuals-seed: has no effect"),
    ],
)
def test_bad_options_are_told_in_one_line(
    simulator: Path, task: Path, tmp_path: Path, more: list[str], message: str, capsys: Any
) -> None:
    assert main([*arguments(simulator, task, tmp_path / "e"), *more]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert not any(tmp_path.iterdir())


def test_no_simulator_is_told(task: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(arguments(tmp_path / "none", task, tmp_path / "e")) == 2
    assert "no such simulator folder" in capsys.readouterr().err


def test_a_simulator_that_leaves_the_numbers_is_told_and_nothing_is_written(
    simulator: Path, task: Path, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    wild = RodSimulator(LampsSection(), Prior(np.full_like(prior_mean(), np.nan), prior_spread()), DriveNoise(), SHOWN)
    monkeypatch.setattr(plan, "_unpacked", lambda content: wild)
    assert main(arguments(simulator, task, tmp_path / "e")) == 2
    assert "not finite, task short" in capsys.readouterr().err
    assert not (tmp_path / "e").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_told(simulator: Path, task: Path, tmp_path: Path, capsys: Any) -> None:
    tmp_path.chmod(0o500)
    assert main(arguments(simulator, task, tmp_path / "e")) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_place_where_nobody_can_write_is_told(simulator: Path, task: Path, tmp_path: Path, capsys: Any) -> None:
    """Not even root can make a folder below a file, or one of its own in the kernel's."""
    (tmp_path / "file").write_text("as it was")
    for output in (tmp_path / "file" / "e", Path("/sys/flora-evolution"), Path("/proc/flora/evolution")):
        assert main(arguments(simulator, task, output)) == 2
        told = capsys.readouterr().err
        # what is no folder is told before any work, what only looks like one when it is written
        assert told.startswith(
            (f"flora-lab: {kept_path(output)}: cannot be written (", f"flora-lab: {output}: cannot be")
        )
        assert told.count("\n") == 1
    assert (tmp_path / "file").read_text() == "as it was"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
