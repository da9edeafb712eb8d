"""An evolution's folder is believed only where all of it fits together."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evolution_examples import RUNS, TASK, plan_of, write_rod

from flora_common.errors import BadInput
from flora_lab.evolve.evolution_folder import (
    HISTORY_FILE,
    INFO_FILE,
    History,
    episode_file,
    history_text,
    read_evolution,
)
from flora_lab.evolve.evolution_writing import write_evolution
from flora_lab.evolve.one_run import advance, first_state
from flora_lab.evolve.task import LEFT, Task


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("whole")
    plan = plan_of(write_rod(base / "rod.simulator"), generations=2)
    states = [advance(plan, first_state(plan, k + 1), seconds=1e9, clock=lambda: 0.0) for k in range(RUNS)]
    write_evolution(base / "evolution", plan, states, wall_s=1.0, force=False)
    return base / "evolution"


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "evolution")
    return tmp_path / "evolution"


def changed(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / INFO_FILE).unlink(), "make one with `flora-lab evolve`"),
        (lambda folder: (folder / HISTORY_FILE).unlink(), "history.csv: cannot be read"),
        (lambda folder: (folder / episode_file(0, LEFT.scenarios[0])).unlink(), "1-first.csv"),
        (changed(INFO_FILE, "flora-evolution-1", "flora-evolution-2"), "this program reads flora-evolution-1"),
        (changed(INFO_FILE, "runs = 3", "runs = 4"), "its runs or episodes"),
        (changed(INFO_FILE, 'scenario = "first"', 'scenario = "last"'), "its runs or episodes"),
        (changed(INFO_FILE, "generations = 2", "generations = 3"), "3 runs of 3 generations"),
        (changed(INFO_FILE, "best_run = ", "worst_run = "), "worst_run"),
        (changed(HISTORY_FILE, "\n1,0,", "\n1,0,nan,"), "is damaged"),
        (changed(HISTORY_FILE, "\n1,1,", "\n1,7,"), "not in order"),
        (changed(HISTORY_FILE, "median_fitness", "mean_fitness"), "its columns are not"),
    ],
)
def test_what_does_not_fit_is_told_in_one_line(folder: Path, damage: Callable[[Path], None], message: str) -> None:
    damage(folder)
    with pytest.raises(BadInput, match=message) as problem:
        read_evolution(folder)
    assert "\n" not in str(problem.value)


def test_a_history_reads_back_to_the_last_bit(whole: Path) -> None:
    evolution = read_evolution(whole)
    assert history_text(evolution.history, TASK) == (whole / HISTORY_FILE).read_text()


def test_scenarios_may_be_called_anything() -> None:
    names = ["../up", "a/b", ".hidden", 'with "quotes", and commas', "ö"]
    task = Task("odd", tuple(replace(TASK.scenarios[0], name=name) for name in names))
    files = [Path(episode_file(place, scenario)) for place, scenario in enumerate(task.scenarios)]
    assert {file.parent for file in files} == {Path("episodes")}
    one = np.zeros((1, 1))
    whole = one.astype(np.int64)
    history = History(one, one, one, whole, whole == 1, whole, whole, whole, whole, np.zeros((1, 1, len(names))))
    assert 'fitness_with ""quotes"", and commas' in history_text(history, task)


def test_scenarios_that_are_called_alike_have_files_of_their_own() -> None:
    twins = [replace(TASK.scenarios[0], name=name) for name in ("a b", "a_b")]
    assert len({episode_file(place, scenario) for place, scenario in enumerate(twins)}) == len(twins)
