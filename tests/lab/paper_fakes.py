"""Results of the paper's steps with numbers that nobody worked for, and all the parts that a report is made of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from evolution_fakes import Fake, read_fake

from flora_common.arrays import FloatArray
from flora_common.experiment_file import FORMAT, Controller, ExperimentFile, Measured, Pictures, Really
from flora_common.runs import CameraSection, Light, ObstacleSection, RunFile, TargetSection
from flora_common.shapes import STEM_POINTS
from flora_common.tracks import Track
from flora_lab.dataset.recipe import PAPER_VECTORS, Recipe
from flora_lab.dataset.store import CountEntry, DatasetFile, RunEntry
from flora_lab.evolve.task import LEFT, MIDDLE
from flora_lab.paper.pipeline import SIDES, Side, steps_of
from flora_lab.paper.results import DatasetRun, Reality, Results, SimulatedTrial, VirtualPlant
from flora_lab.paper.scales import SMOKE, Asked
from flora_lab.simulator.store import Provenance, SimulatorFile

HOURS = 72
VECTORS = 4200
ASKED = Asked(SMOKE, 3)
JPEG = cv2.imencode(".jpg", np.full((30, 40, 3), 60, dtype=np.uint8))[1].tobytes()
CAMERA = CameraSection(anchor_px=(80.0, 110.0), px_per_cm=4.0, width_px=160, height_px=120)


def track(tips_cm: FloatArray, light: list[Light]) -> Track:
    """Straight stems an hour apart whose tips are these."""
    share = np.linspace(0.0, 1.0, STEM_POINTS)
    points = share[None, :, None] * tips_cm[:, None, :]
    return Track(3600.0 * np.arange(len(tips_cm)), tuple(light), points, {})


def dataset_run(name: str, *, closed: bool = False) -> DatasetRun:
    """A plant that rises by 7.2 cm a day from 2 cm, under lamps that change every six hours."""
    heights = 2.0 + 0.3 * np.arange(HOURS + 1)
    light: list[Light] = ["dark", *("left" if (k // 6) % 2 else "right" for k in range(HOURS))]
    target = TargetSection(3.0, 17.9) if closed else None
    run = RunFile(camera=CAMERA, interval_s=300.0, target=target)
    return DatasetRun(name, run, track(np.column_stack([0.0 * heights, heights]), light))


def virtual_plant(seed: int, *, right_h: int = 37, reached: float | None = 0.924) -> VirtualPlant:
    """A plant that goes to the right for so long, is in the middle two hours later, and then goes to the left."""
    hours = np.arange(HOURS + 1.0)
    tips = np.column_stack([np.where(hours <= right_h, 0.2 * hours, 7.4 - 4.0 * (hours - right_h)), 5.0 + 0.2 * hours])
    tips[:, 0] = np.maximum(tips[:, 0], -6.0)
    light: list[Light] = ["dark", *("right" if k < right_h else "left" for k in range(HOURS))]
    outcome = ExperimentFile(
        format=FORMAT,
        software="fake",
        controller=Controller("c", "a" * 64),
        seed=seed,
        target=TargetSection(-5.12, 17.9),
        obstacle=ObstacleSection(-6.3, 12.5),
        hours=72.0,
        stop_height_cm=21.0,
        measured=Measured("time", 72.0, reached, None if reached is None else 60.0, 0.8, 0.95, 1.5, 870, 869, 1),
        true=Really(1.2, 0.1, 0.2),
        pictures=Pictures(870, 0, 0, 0),
        restarts={},
        took_s=80.0,
        run="rig/runs/bean",
    )
    return VirtualPlant(outcome, track(tips, light), JPEG)


def _simulator(recipe: str, settings: dict[str, Any], results: dict[str, Any], split: str) -> SimulatorFile:
    provenance = Provenance(recipe, 3, "flora test", split=split, settings=settings, results=results)
    return SimulatorFile(1, recipe, 300.0, "c" * 64, provenance)


def simulators(own_split: str = "by plant") -> dict[Side, SimulatorFile]:
    """Both."""
    errors = {f"mae_{part}": 4.9e-4 for part in ("train", "validate", "test")}
    paper = {
        **errors,
        "mae_test_mm": 0.32,
        "nothing_moves_test": 6.5e-4,
        "epochs": 29,
        "loss_train": [1e-3, 5e-4],
        "loss_validate": [1e-3, 5.1e-4],
        "vectors_train": 700,
        "vectors_validate": 200,
        "vectors_test": 100,
    }
    settings = {"cells": 50, "batch": 30, "learning_rate": 0.001, "epochs": 200, "patience": 10}
    return {
        "paper": _simulator("paper", settings, paper, "rows"),
        "own": _simulator("sequence", {"rate": 0.008, "epochs": 80}, {"epochs": 44}, own_split),
    }


def results(folder: Path, *, own_split: str = "by plant", generations: int = 12) -> Results:
    """All of it; evolutions are written into the folder and read back."""
    names = ["open-1", "open-2", "closed-1"]
    counts = [CountEntry("tracks", 219, 216), CountEntry("jumps", 4300, VECTORS)]
    evolutions = {
        (side, task.name): read_fake(folder / f"{side}-{task.name}", Fake(task, 6, generations, seed=k))
        for k, (side, task) in enumerate((side, task) for side in SIDES for task in (LEFT, MIDDLE))
    }
    foretold = {
        "paper": SimulatedTrial("paper", "typical", 0.7, 0.75, "collision", 7.0),
        "own": SimulatedTrial("own", "typical", 0.9, 0.95, "height", 70.0),
    }
    return Results(
        asked=ASKED,
        took_s={step.name: 12.0 for step in steps_of(ASKED, is_silent=True)},
        runs=tuple(dataset_run(name, closed=name.startswith("closed")) for name in names),
        data=DatasetFile(
            format=1,
            vectors=VECTORS,
            paper_vectors=PAPER_VECTORS,
            data_sha256="d" * 64,
            software="flora test",
            numpy="2",
            recipe=Recipe(),
            run=[RunEntry(name, name, f"{name}.csv", "e" * 64, 73) for name in names],
            count=counts,
        ),
        simulators=simulators(own_split),
        curves={},
        evolutions=evolutions,
        reality={
            "paper": Reality((virtual_plant(20001), virtual_plant(20002, reached=None)), foretold),
            "own": Reality((virtual_plant(20001, right_h=0),), foretold),
        },
    )
