"""What ``flora-lab rollout`` works out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flora_common.errors import BadInput
from flora_lab.rollout.at_time_scale import AtTimeScale
from flora_lab.rollout.free_running import Plan, judge, parting_mm, starts_of
from flora_lab.rollout.predictors import GoesOn, NothingMoves
from flora_lab.rollout.summary import Entry, Summary, summarise
from flora_lab.rollout.time_scale import FREE_RUNS, TimeScale, best_time_scale
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.store import SUFFIX

Stage = Callable[[str, int], Callable[[], None]]
"""From a stage's name and length to a function that counts one more."""


def load_all(paths: Sequence[Path]) -> dict[str, Simulator[Any]]:
    """Simulators by the names that tables have: the folder's, or its whole path where two are called alike.

    Raises:
        BadInput: the same folder twice, or one that cannot be read.
    """
    names = [path.resolve().name.removesuffix(SUFFIX) for path in paths]
    taken = {NothingMoves.kind, GoesOn.kind}
    simulators: dict[str, Simulator[Any]] = {}
    for name, path in zip(names, paths, strict=True):
        own = str(path) if name in taken or names.count(name) > 1 else name
        if own in simulators:
            raise BadInput(f"{path}: is given twice")
        simulators[own] = load(path)
    return simulators


def judge_all(
    simulators: Mapping[str, Simulator[Any]],
    tracks: Sequence[RunTrack],
    *,
    watch_h: float,
    every_h: float,
    horizons_h: Sequence[float],
    time_scale: bool,
    seed: int,
    stage: Stage,
) -> tuple[list[Entry], Summary]:
    """All errors of all simulators and of the trivial predictors, in steps of the first simulator.

    Args:
        simulators: by name, the judged one first.
        tracks: what they are judged by.
        watch_h, every_h, horizons_h: see :class:`Plan`; hours.
        time_scale: whether each simulator is also judged at its own best time scale.
        seed: of the resampling of plants.
        stage: is told how far the work is.

    Raises:
        BadInput: a horizon that is no whole number of steps; a track without such steps; a light that a simulator
            does not know.
    """
    step_s = next(iter(simulators.values())).step_s
    plan = Plan(watch_h, every_h, tuple(steps_in(hours, step_s) for hours in horizons_h))
    runs = [in_steps(track, step_s) for track in tracks]
    scales: dict[str, TimeScale] = {}
    judged = dict(simulators)
    if time_scale:
        for name, one in simulators.items():
            with _named(name):
                scales[name] = best_time_scale(one, runs, seed, stage(f"{name}: time scale", FREE_RUNS))
            factor = scales[name].factor.value
            if factor != 1.0:
                judged[f"{name} at time scale {factor:.3g}"] = AtTimeScale(one, factor)
    judged[NothingMoves.kind], judged[GoesOn.kind] = NothingMoves(step_s), GoesOn(step_s)
    entries = _entries(judged, runs, plan, stage)
    apart = {name: parting_mm(one, runs) for name, one in simulators.items()}
    return entries, replace(summarise(entries, runs, plan, seed, scales), parting_mm=apart)


def steps_in(hours: float, step_s: float) -> int:
    """A horizon in steps.

    Raises:
        BadInput: not a whole number.
    """
    steps = round(hours * 3600.0 / step_s)
    if steps < 1 or abs(steps * step_s - hours * 3600.0) > 1.0:
        raise BadInput(f"--horizons: {hours:g} h is not a whole number of the simulator's steps of {step_s:g} s")
    return steps


def _entries(
    simulators: Mapping[str, Simulator[Any]], runs: Sequence[MeasuredRun], plan: Plan, stage: Stage
) -> list[Entry]:
    count = 1 + len(starts_of(runs, plan))
    entries = []
    for name, one in simulators.items():
        with _named(name):
            entries.append(Entry(name, judge(one, runs, plan, stage(name, count))))
    return entries


@contextlib.contextmanager
def _named(name: str) -> Iterator[None]:
    """A simulator's errors with its name."""
    try:
        yield
    except BadInput as problem:
        raise BadInput(f"{name}: {problem}") from problem
