"""The order of an evaluation's work: simulated plants first, virtual ones, then what is written."""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

from flora_common.errors import BadInput
from flora_lab.evaluate import in_simulator
from flora_lab.evaluate.as_json import as_json
from flora_lab.evaluate.evaluation import Evaluation
from flora_lab.evaluate.folder import JSON_FILE, PAGE_FILE, held, write_results
from flora_lab.evaluate.on_twin import run_all, twin_runs
from flora_lab.evaluate.page import page
from flora_lab.evaluate.plan import Plan
from flora_lab.evaluate.trial import TWIN
from flora_lab.rollout import work as rollout
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.store import SimulatorFile, read_stored


@dataclass(frozen=True, slots=True)
class Loaded:
    """A simulator, and what its folder says of it."""

    simulator: Simulator[Any]
    info: SimulatorFile


def load_all(paths: Sequence[Path]) -> dict[str, Loaded]:
    """Simulators by the names that tables have.

    Raises:
        BadInput: see :func:`flora_lab.rollout.work.load_all`; or one that is called as the virtual rig is.
    """
    simulators = rollout.load_all(paths)
    if TWIN in simulators:
        raise BadInput(f"--on: a simulator called `{TWIN}` would be taken for the virtual rig; give it another name")
    return {
        name: Loaded(simulator, read_stored(path).info)
        for (name, simulator), path in zip(simulators.items(), paths, strict=True)
    }


def episodes(plan: Plan, simulators: Mapping[str, Loaded]) -> int:
    """How many there are to simulate."""
    return len(simulators) * in_simulator.count(plan)


def simulate(plan: Plan, simulators: Mapping[str, Loaded], done: Callable[[], None]) -> Evaluation:
    """Try all controllers in all simulators; ``done`` is called after each episode.

    Raises:
        BadInput: see :func:`flora_lab.evaluate.in_simulator.trials_in`.
    """
    trials = [
        trial for name, one in simulators.items() for trial in in_simulator.trials_in(name, one.simulator, plan, done)
    ]
    infos = {name: one.info for name, one in simulators.items()}
    return Evaluation(plan, infos, on_twin=False, trials=trials, failed={})


@contextlib.contextmanager
def run_folder(output: Path | None, plan: Plan) -> Iterator[Path]:
    """Where virtual plants grow: the folder that was named, or a temporary one, which stays only where a run failed.

    Raises:
        BadInput: see :func:`flora_lab.evaluate.folder.held`.
    """
    if output is not None:
        with held(output, plan) as folder:
            yield folder
        return
    folder = Path(tempfile.mkdtemp(prefix="flora-evaluate-"))
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder)
        raise
    if not any(folder.glob("runs/*.unfinished")):
        shutil.rmtree(folder)


def on_twin(
    evaluation: Evaluation,
    folder: Path,
    *,
    jobs: int | None,
    say: Callable[[str], None],
    screen: TextIO | None,
    keep_photographs: bool,
) -> Evaluation:
    """Try all controllers on virtual plants too; see :func:`flora_lab.evaluate.on_twin.run_all`."""
    runs = twin_runs(evaluation.plan)
    results = run_all(runs, folder, jobs=jobs, say=say, screen=screen, keep_photographs=keep_photographs)
    return replace(evaluation, on_twin=True, trials=[*evaluation.trials, *results.trials], failed=results.failed)


def write(output: Path, evaluation: Evaluation) -> None:
    """Write all results into their folder."""
    results = {JSON_FILE: json.dumps(as_json(evaluation), indent=1) + "\n", PAGE_FILE: page(evaluation)}
    write_results(output, evaluation.plan, evaluation.trials, results)


def failure_words(evaluation: Evaluation) -> str:
    """What failed, in one line."""
    words, said = next(iter(evaluation.failed.items()))
    others = len(evaluation.failed) - 1
    more = f"; {others} more failed" if others else ""
    return f"{words}: {said}{more}; what is finished is kept"
