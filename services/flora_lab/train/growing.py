"""What the recipes of growing simulators have in common: their runs, and what is stored of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from flora_common.errors import BadInput
from flora_common.geometry import polyline_length
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.growing import DataRange, GrowingSimulator
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.store import Provenance, TrackEntry, software
from flora_lab.train.recipes import Trained

SHORTEST_H: Final = 2.0
BEYOND: Final = 1.05
"""A little beyond what was shown is not yet strange."""


def usable(runs: Sequence[RunTrack]) -> list[MeasuredRun]:
    """Runs in equal steps.

    Raises:
        BadInput: a run that is too short to tell how a plant moves, or see :func:`in_steps`.
    """
    found = []
    for run in runs:
        measured = in_steps(run)
        if measured.hours < SHORTEST_H:
            raise BadInput(f"{run.file}: is {measured.hours:.1f} h long; at least {SHORTEST_H:g} h are needed")
        found.append(measured)
    return found


def range_of(runs: Sequence[MeasuredRun]) -> DataRange:
    """What the runs show."""
    points = np.concatenate([run.points_cm[run.is_measured] for run in runs])
    lengths = polyline_length(points)
    return DataRange(BEYOND * float(lengths.max()), BEYOND * float(np.abs(points[:, -1, 0]).max()))


def trained(
    simulator: GrowingSimulator,
    runs: Sequence[MeasuredRun],
    *,
    recipe: str,
    seed: int,
    split: str,
    settings: Mapping[str, Any],
    results: Mapping[str, Any],
    figures: Mapping[str, bytes],
    table: Sequence[str],
) -> Trained:
    """A recipe's result."""
    provenance = Provenance(
        recipe=recipe,
        seed=seed,
        software=software(),
        split=split,
        settings=dict(settings),
        results=dict(results),
        track=[TrackEntry(run.name, run.plant, run.sha256) for run in runs],
    )
    return Trained(
        kind=simulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=provenance,
        figures=figures,
        table=table,
    )
