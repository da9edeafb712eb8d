"""Controllers on virtual plants through the whole rig: `flora-twin experiment` as a process, one run after the other.

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
from flora_common.errors import BadInput, FloraError
from flora_common.experiment_file import NAME, ExperimentFile, read_experiment
from flora_common.installed import command
from flora_common.runs import ObstacleSection, RunFolder, TargetSection
from flora_lab.evaluate.folder import RUNS, plain
from flora_lab.evaluate.plan import NamedController, Plan
from flora_lab.evaluate.trial import Trial, measured
from flora_lab.evolve.task import Scenario, Task
from flora_lab.report import strip, summary
from flora_lab.stopped_work import waited_for

TWIN_COMMAND: Final = "flora-twin"
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


def run_all(
    runs: Sequence[TwinRun],
    folder: Path,
    *,
    say: Callable[[str], None],
    screen: TextIO | None = None,
    keep_photographs: bool = False,
) -> TwinResults:
    """Do the runs that are not there yet.

    Args:
        runs: of :func:`twin_runs`.
        folder: of the evaluation.
        say: is told a line before and after each run.
        screen: a terminal on which each run shows how far it is; None to show nothing.
        keep_photographs: in the run folders.

    Raises:
        BadInput: a run folder that is there is of another run.
    """
    done = {run.name: _read(run, place) for run in runs if (place := folder / RUNS / run.name).exists()}
    trials: list[Trial] = []
    failed: dict[str, str] = {}
    for number, run in enumerate(runs, start=1):
        place, head = folder / RUNS / run.name, f"run {number} of {len(runs)}, {run.words}"
        if run.name in done:
            trials.append(done[run.name])
            say(f"{head}, done before: fitness {100 * trials[-1].fitness:.1f} %")
            continue
        say(head)
        try:
            _make(run, place, screen=screen, keep_photographs=keep_photographs)
        except RunFailed as problem:
            failed[run.words] = str(problem)
            say(f"{head}: failed: {problem}")
            continue
        trials.append(_read(run, place))
        say(f"{head}: fitness {100 * trials[-1].fitness:.1f} %")
    return TwinResults(trials, failed)


def _read(run: TwinRun, place: Path) -> Trial:
    outcome = read_experiment(place)
    run.check(outcome, place)
    return measured(run.controller.name, run.scenario, place, outcome)


def _make(run: TwinRun, place: Path, *, screen: TextIO | None, keep_photographs: bool) -> None:
    """Do a run under another name, and give it its own when all of it is there.

    Raises:
        RunFailed: it did not come to its end; what it left stays under the other name, with the rig's logs.
    """
    unfinished = place.with_name(f"{place.name}.unfinished")
    if unfinished.exists():
        shutil.rmtree(unfinished)
    files.make_folder(unfinished)
    # The controller as it was read, whatever has become of its file since.
    steering = unfinished / "asked.controller.json"
    files.write_bytes(steering, run.controller.loaded.data)
    _run([*run.arguments(unfinished), f"--controller={steering}"], screen)
    try:
        outcome = read_experiment(unfinished)
        run.check(outcome, unfinished)
        inner = RunFolder(unfinished / outcome.run)
        files.write_bytes(unfinished / STRIP_FILE, _strip(inner, run.task.stop_height_cm))
    except BadInput as problem:
        raise RunFailed(f"what {TWIN_COMMAND} wrote cannot be used: {problem}") from problem
    for waste in _waste(unfinished, inner, keep_photographs=keep_photographs):
        shutil.rmtree(waste)
    unfinished.rename(place)
    files.fsync_folder(place.parent)


def _waste(folder: Path, run: RunFolder, *, keep_photographs: bool) -> Iterator[Path]:
    yield folder / "rig" / "nas"
    if not keep_photographs:
        yield from (run.frames, run.background)


def _strip(run: RunFolder, stop_height_cm: float) -> bytes:
    """Photographs at even times up to the end of the run, side by side, as JPEG."""
    judged = summary.summarise(run, stop_height_cm=stop_height_cm)
    end_h = float(judged.track.time_s[judged.stop_row]) / 3600.0
    hours = [end_h * k / STRIP_PANELS for k in range(1, STRIP_PANELS + 1)]
    return strip.encode_jpeg(strip.strip(run, judged, hours))


def _run(arguments: Sequence[str], screen: TextIO | None) -> None:
    """Run the command to its end; one that is told to stop stops its rig first.

    Raises:
        RunFailed: it ended otherwise than well; its own words.
    """
    quiet = [] if screen else ["--quiet"]
    # In a session of its own: Ctrl-C reaches this process alone, which then ends the rig as a whole.
    process = subprocess.Popen(
        [command(TWIN_COMMAND), *arguments, *quiet],
        stdin=subprocess.DEVNULL,
        stdout=screen or subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        start_new_session=True,
    )
    said = waited_for(process)
    if process.returncode != 0:
        lines = said.strip().splitlines() or [f"{TWIN_COMMAND} ended with status {process.returncode}"]
        raise RunFailed(lines[-1].removeprefix(f"{TWIN_COMMAND}: "))
