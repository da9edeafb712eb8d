"""Controllers on virtual plants through the whole rig: `flora-twin experiment` as processes, some at a time.

The lab knows the virtual rig by its command and by the file that it writes, as it would know a real one. A run is some
250 MB, nearly all of it photographs and their copies at the rig's NAS; what stays is a strip of them, unless they are
asked for.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TextIO

from flora_common import files
from flora_common.controller_file import SUFFIX
from flora_common.errors import BadInput, FloraError
from flora_common.experiment_file import NAME, ExperimentFile, read_experiment
from flora_common.installed import command
from flora_common.runs import ObstacleSection, RunFolder, TargetSection
from flora_lab.evaluate.folder import RUNS, plain
from flora_lab.evaluate.plan import NamedController, Plan
from flora_lab.evaluate.side_by_side import side_by_side
from flora_lab.evaluate.trial import Trial, measured
from flora_lab.evolve.task import Scenario, Task
from flora_lab.report import strip, summary

TWIN_COMMAND: Final = "flora-twin"
STEERING_FILE: Final = "asked.controller.json"
STRIP_FILE: Final = "strip.jpg"
STRIP_PANELS: Final = 4


class RunFailed(FloraError):
    """One run on the virtual rig did not come to its end."""


@dataclass(frozen=True, slots=True)
class TwinRun:
    """One controller, one individual, one scenario."""

    controller: NamedController
    task: Task
    scenario: Scenario
    seed: int

    @property
    def name(self) -> str:
        """Of its folder; differs for each run of an evaluation, whatever the names in it are."""
        number = self.task.scenarios.index(self.scenario) + 1
        names = f"{plain(self.controller.name)}-{self.controller.sha256[:8]}-{number}-{plain(self.scenario.name)}"
        return f"{names}-{self.seed}"

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.controller.name} in scenario {self.scenario.name} on plant {self.seed}"

    def arguments(self, output: Path) -> list[str]:
        """Of `flora-twin`; numbers are written so that they are read back the same."""
        target, obstacle, task = self.scenario.target, self.scenario.obstacle, self.task
        places = (
            f"--target={target.x_cm!r},{target.y_cm!r},{target.radius_cm!r}",
            f"--obstacle={obstacle.x_cm!r},{obstacle.y_cm!r},{obstacle.width_cm!r},{obstacle.height_cm!r}",
        )
        ends = (f"--hours={task.hours!r}", f"--stop-height={task.stop_height_cm!r}", f"--seed={self.seed}")
        return ["experiment", f"--output={output}", *places, *ends]

    def check(self, outcome: ExperimentFile, where: Path) -> None:
        """Whether an outcome is this run's.

        Raises:
            BadInput: it is not.
        """
        target, obstacle = self.scenario.target, self.scenario.obstacle
        wanted = (
            ("controller", outcome.controller.sha256, self.controller.sha256),
            ("seed", outcome.seed, self.seed),
            ("target", outcome.target, TargetSection(target.x_cm, target.y_cm, target.radius_cm)),
            (
                "obstacle",
                outcome.obstacle,
                ObstacleSection(obstacle.x_cm, obstacle.y_cm, obstacle.width_cm, obstacle.height_cm),
            ),
            ("hours", outcome.hours, self.task.hours),
            ("stop height", outcome.stop_height_cm, self.task.stop_height_cm),
        )
        for name, is_there, want in wanted:
            if is_there != want:
                raise BadInput(f"{where / NAME}: is of another run, {name} differs; name another folder with -o")


def twin_runs(plan: Plan) -> list[TwinRun]:
    """All runs of a plan: every controller meets the same individuals."""
    return [
        TwinRun(controller, plan.task, scenario, plan.seed + k)
        for k in range(plan.repeat)
        for controller in plan.controllers
        for scenario in plan.task.scenarios
    ]


@dataclass(frozen=True, slots=True)
class TwinResults:
    """What came of the runs.

    Attributes:
        trials: those that came to their end.
        failed: what the others said, by their words.
    """

    trials: list[Trial]
    failed: dict[str, str]


def at_once(jobs: int | None, runs: int) -> int:
    """How many runs at a time: as asked, else one per core and one more, for the services of a rig wait in turn."""
    return min(jobs or len(os.sched_getaffinity(0)) + 1, max(runs, 1))


def run_all(
    runs: Sequence[TwinRun],
    folder: Path,
    *,
    jobs: int | None = None,
    say: Callable[[str], None],
    screen: TextIO | None = None,
    keep_photographs: bool = False,
) -> TwinResults:
    """Do the runs that are not there yet.

    Args:
        runs: of :func:`twin_runs`.
        folder: of the evaluation.
        jobs: how many at a time, see :func:`at_once`; changes no result.
        say: is told a line before and after each run.
        screen: a terminal on which a run that is alone shows how far it is; None to show nothing.
        keep_photographs: in the run folders.

    Raises:
        BadInput: a run folder that is there is of another run.
    """
    trials = {run.name: _read(run, place) for run in runs if (place := folder / RUNS / run.name).exists()}
    heads = {run.name: f"run {k} of {len(runs)}, {run.words}" for k, run in enumerate(runs, start=1)}
    failed: dict[str, str] = {}
    for run in runs:
        if run.name in trials:
            say(f"{heads[run.name]}, done before: fitness {100 * trials[run.name].fitness:.1f} %")
    missing = [run for run in runs if run.name not in trials]
    count = at_once(jobs, len(missing))

    def start(run: TwinRun) -> subprocess.Popen[str]:
        say(heads[run.name])
        return _start(run, folder / RUNS / run.name, screen if count == 1 else None)

    def ended(run: TwinRun, process: subprocess.Popen[str], said: str) -> None:
        place, head = folder / RUNS / run.name, heads[run.name]
        try:
            remarks = _finish(run, place, process, said, keep_photographs=keep_photographs)
        except RunFailed as problem:
            failed[run.name] = str(problem)
            say(f"{head}: failed: {problem}")
            return
        trials[run.name] = _read(run, place)
        for remark in remarks:
            say(f"{head}: {remark}")
        say(f"{head}: fitness {100 * trials[run.name].fitness:.1f} %")

    side_by_side(missing, count, start=start, ended=ended)
    return TwinResults(
        [trials[run.name] for run in runs if run.name in trials],
        {run.words: failed[run.name] for run in runs if run.name in failed},
    )


def _read(run: TwinRun, place: Path) -> Trial:
    outcome = read_experiment(place)
    run.check(outcome, place)
    return measured(run.controller.name, run.scenario, place, outcome)


def _unfinished(place: Path) -> Path:
    """Where a run is made; it gets its own name when all of it is there."""
    return place.with_name(f"{place.name}.unfinished")


def _steering(place: Path) -> Path:
    """The controller that a run is made with, until it is moved into the run's folder."""
    return place.with_name(f"{_unfinished(place).name}{SUFFIX}")


def _start(run: TwinRun, place: Path, screen: TextIO | None) -> subprocess.Popen[str]:
    """Start a run; told to stop, it stops its rig first."""
    unfinished = _unfinished(place)
    if unfinished.exists():
        shutil.rmtree(unfinished)
    # The controller as it was read, whatever has become of its file since; beside a folder that is the twin's alone.
    steering = _steering(place)
    files.write_bytes(steering, run.controller.loaded.data)
    quiet = [] if screen else ["--quiet"]
    # In a session of its own: Ctrl-C reaches this process alone, which then ends the rig as a whole.
    return subprocess.Popen(
        [command(TWIN_COMMAND), *run.arguments(unfinished), f"--controller={steering}", *quiet],
        stdin=subprocess.DEVNULL,
        stdout=screen or subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )


def _finish(
    run: TwinRun, place: Path, process: subprocess.Popen[str], said: str, *, keep_photographs: bool
) -> list[str]:
    """Keep what a run that has ended left.

    Returns:
        What there is to tell of its strip, a line each.

    Raises:
        RunFailed: it did not come to its end; what it left stays under the other name, with the rig's logs.
    """
    unfinished = _unfinished(place)
    files.make_folder(unfinished)
    _steering(place).rename(unfinished / STEERING_FILE)
    if process.returncode != 0:
        lines = said.strip().splitlines() or [f"{TWIN_COMMAND} ended with status {process.returncode}"]
        raise RunFailed(lines[-1].removeprefix(f"{TWIN_COMMAND}: "))
    try:
        outcome = read_experiment(unfinished)
        run.check(outcome, unfinished)
        inner = RunFolder(unfinished / outcome.run)
        shown = _strip(inner, run.task.stop_height_cm)
        files.write_bytes(unfinished / STRIP_FILE, strip.encode_jpeg(shown.picture))
    except BadInput as problem:
        raise RunFailed(f"what {TWIN_COMMAND} wrote cannot be used: {problem}") from problem
    for waste in _waste(unfinished, inner, keep_photographs=keep_photographs):
        shutil.rmtree(waste)
    unfinished.rename(place)
    files.fsync_folder(place.parent)
    return shown.remarks


def _waste(folder: Path, run: RunFolder, *, keep_photographs: bool) -> Iterator[Path]:
    yield folder / "rig" / "nas"
    if not keep_photographs:
        yield from (run.frames, run.background)


def _strip(run: RunFolder, stop_height_cm: float) -> strip.Strip:
    """Photographs at even times up to the end of the run, side by side."""
    judged = summary.summarise(run, stop_height_cm=stop_height_cm)
    end_h = float(judged.track.time_s[judged.stop_row]) / 3600.0
    hours = [end_h * k / STRIP_PANELS for k in range(1, STRIP_PANELS + 1)]
    return strip.strip(run, judged, hours)
