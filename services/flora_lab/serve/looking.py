"""The mathematics, in a process of its own: learning the simulator, and looking at a run that lasts."""

from __future__ import annotations

import functools
import hashlib
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from flora_common.errors import BadInput
from flora_common.runs import LEVELS, LampsSection, Light
from flora_common.shapes import STEM_POINTS
from flora_common.tracks import Track
from flora_lab.diagnose import record, stored_base
from flora_lab.diagnose.inputs import Runs, read_reference
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.learned_base import learned_base
from flora_lab.run_tracks import RunTrack
from flora_lab.serve import departing
from flora_lab.serve.departing import Watched
from flora_lab.serve.heard import Row
from flora_lab.serve.tasks import LearnTask, LookTask
from flora_lab.serve.watching import Looked
from flora_lab.simulator.measured import MeasuredRun, in_steps, step_of
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import read_stored
from flora_lab.simulator.terms import ExtendedLaw


def learned(task: LearnTask) -> Path:
    """The simulator's folder; it is learned where it is not there yet.

    Raises:
        BadInput: too few reference runs, or such as cannot be read.
    """
    told = read_reference(task.reference, Runs((), (), (), ()))
    content = hashlib.sha256("".join(sorted(run.sha256 for run in told.measured)).encode()).hexdigest()
    path = task.output / f"base-{content[:8]}.simulator"
    if path.is_dir():
        return path
    simulator, known, provenance = learned_base(told, f"the runs in {task.reference}")
    stored_base.write_known(path, simulator, known, provenance)
    return path


def looked(task: LookTask) -> Looked:
    """What a look finds.

    Raises:
        BadInput: a simulator that knows nothing of chance, or rows that are no run.
    """
    known, simulator = _known(task.simulator)
    where = task.lamps or simulator.lamps
    run, _ = record.cleaned(measured(task.run, task.rows, where))
    before = msgspec.convert(task.watched, Watched) if task.watched is not None else Watched()
    law = ExtendedLaw(where, simulator.terms)
    after = departing.followed(run, law, simulator.usual_temperature_c, known, before, task.false_alarms)
    hour = next((h for h in reversed(after.hours) if h.error_mm is not None), None)
    return Looked(
        watched=msgspec.to_builtins(after),
        hours=len(after.hours),
        departed_at=after.departed_at,
        error_mm=(0.0, 0.0) if hour is None or hour.error_mm is None else hour.error_mm,
        expected_mm=0.0 if hour is None else hour.expected_mm,
        is_watched=hour is not None and hour.is_watched,
        sentence=departing.sentence(after, task.false_alarms),
    )


def measured(name: str, rows: list[Row], lamps: LampsSection) -> MeasuredRun:
    """Rows in equal steps. Where no stem was found the rows still tell which lamp shone.

    Raises:
        BadInput: see :func:`flora_lab.simulator.measured.in_steps`.
    """
    found = [row for row in rows if row.points_cm]
    if len(found) < 2:
        raise BadInput(f"run {name}: no two stems were heard")
    time_s = np.array([row.time_s for row in found])
    points = np.array([row.points_cm for row in found]).reshape(-1, STEM_POINTS, 2)
    lights: list[Light] = [row.light or "dark" for row in found]
    step_s = step_of(time_s)
    run = in_steps(RunTrack(name, name, Path(name), "", Track(time_s, tuple(lights), points, {}), lamps), step_s)
    told = [row for row in rows if row.light is not None]
    ends = run.time_s[1:]
    at = np.searchsorted(np.array([row.time_s for row in told]), ends + 0.5 * step_s, side="right") - 1
    levels = np.array([LEVELS[row.light] for row in told if row.light is not None])
    return replace(run, light=levels[np.maximum(at, 0)])


@functools.lru_cache(maxsize=2)
def _known(path: Path) -> tuple[Knowledge, RodSimulator]:
    stored = read_stored(path)
    if not stored_base.is_known(stored):
        raise BadInput(
            f"{path}: knows nothing of chance, so that nobody can say what is beyond it; make one with "
            "`flora-lab diagnose --reference`"
        )
    return stored_base.read_known(stored), RodSimulator.from_stored(stored)
