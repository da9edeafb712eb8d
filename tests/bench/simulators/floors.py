"""How well any model could foretell: the virtual plants' own equations, once with and once without their constants.

Both go on from the plant's true state, memory of light and phases included, and without anything happening by chance.
What is left of the error with the plant's own constants is chance; what is left with those of the typical plant is
chance and individuality. No model that sees stems alone can be expected to do better than the second from a single
stem, nor better than the first after watching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import LEVELS
from flora_common.tracks import Track
from flora_twin.grow import FRAME_S, stem_points_cm
from flora_twin.parameters import PlantParameters, draw_individual
from flora_twin.plant import STEP_S, Plants, State

CHANCE = {"growth_noise": 0.0, "wander_per_cm_h": 0.0, "nutation_per_cm_h": 0.0}
STATE_OF_BIRTH = ("initial_length_cm", "initial_lean_rad")
_STEPS = round(FRAME_S / STEP_S)


def tip_errors_mm(seeds: Sequence[int], tracks: Sequence[Track], start_row: int) -> dict[str, FloatArray]:
    """Errors of the tip from a row on.

    Args:
        seeds: the individuals.
        tracks: what they did, one row per five minutes.
        start_row: from where.

    Returns:
        ``own constants`` and ``typical constants`` to shape (rows after the start, plants).
    """
    levels = np.array([[LEVELS[light] for light in track.light] for track in tracks])  # (plants, rows, 2)
    plants = Plants(list(seeds))
    for row in range(1, start_row + 1):
        _frame(plants, levels[:, row])
    state = plants.state()
    own = [replace(draw_individual(seed), **CHANCE) for seed in seeds]
    typical = [_typical(draw_individual(seed)) for seed in seeds]
    measured = np.stack([track.points_cm[:, -1] for track in tracks], axis=1)
    errors = {}
    for name, parameters in (("own constants", own), ("typical constants", typical)):
        foretold = Plants.from_state(_with(state, parameters))
        tips = []
        for row in range(start_row + 1, measured.shape[0]):
            _frame(foretold, levels[:, row])
            lines, used = foretold.centreline_cm(), foretold.segments
            tips.append([stem_points_cm(lines[i, : used[i] + 1])[-1] for i in range(len(seeds))])
        away = np.array(tips) - measured[start_row + 1 :]
        errors[name] = 10.0 * np.hypot(away[..., 0], away[..., 1])
    return errors


def _frame(plants: Plants, levels: FloatArray) -> None:
    for _ in range(_STEPS):
        plants.step(levels[:, 0], levels[:, 1], STEP_S)


def _typical(individual: PlantParameters) -> PlantParameters:
    """The mean plant, born as this one was."""
    mean = PlantParameters()
    born = {field.name: getattr(individual, field.name) for field in fields(mean) if field.name in STATE_OF_BIRTH}
    return replace(mean, **born, **CHANCE, growth_rhythm=0.0)


def _with(state: State, parameters: Sequence[PlantParameters]) -> State:
    changed = dict(state)
    changed["parameters"] = np.stack([p.as_array() for p in parameters])
    changed["drift"] = np.zeros_like(state["drift"])
    return changed
