"""The comparison: every quantity that the paper tells, beside what it is here by either recipe.

Settings are read from what the steps wrote, like results: a table that told them from the program's own constants
would agree with the paper whatever had been done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from flora_common.controller_file import LEFT_AT_MOST, ControllerFile, load_controller
from flora_common.vision.paper import PaperSettings
from flora_lab.evolve.task import LEFT, MIDDLE, Task
from flora_lab.paper import remarks
from flora_lab.paper.measures import (
    Steering,
    converged_generation,
    growth_cm_per_day,
    hours_to_height,
    steering,
    switching_h,
)
from flora_lab.paper.pipeline import SIDES, Side
from flora_lab.paper.published import PUBLISHED, Published
from flora_lab.paper.results import Results, VirtualPlant

Values = tuple[float | None, ...]
"""One number, or several of a kind; None among them where there is none."""
PERCENT: Final = 100.0
MINUTE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Cell:
    """What a quantity is here: by the paper's recipe and by ours; None where there is no equivalent.

    ``note`` says why it is not there, or why it differs; empty where there is nothing to say.
    """

    by_paper: Values | None = None
    by_own: Values | None = None
    note: str = ""

    def by(self, side: Side) -> Values | None:
        """In a column."""
        return self.by_paper if side == "paper" else self.by_own


@dataclass(frozen=True, slots=True)
class Row:
    """A quantity of the paper, and what it is here."""

    published: Published
    ours: Cell


def rows(results: Results) -> list[Row]:
    """A row for each quantity, in the order of the paper."""
    cells = {
        **_setup(results),
        **_experiments(results),
        **_data(results),
        **_training(results),
        **_tasks(results),
        **_evolution(results),
        **_reality(results),
    }
    return [Row(one, cells[one.key]) for one in PUBLISHED]


def both(*values: float | None, note: str = "") -> Cell:
    """The same by either recipe."""
    return Cell(values, values, note)


def per_side(tell: Callable[[Side], Values], note: str = "") -> Cell:
    """By either recipe."""
    return Cell(tell("paper"), tell("own"), note)


def nowhere(note: str) -> Cell:
    """No equivalent."""
    return Cell(note=note)


def _setup(results: Results) -> dict[str, Cell]:
    lamps = results.runs[0].run.lamps
    cells = {
        "lamp_height_cm": both(lamps.height_cm),
        "lamp_distance_cm": both(lamps.distance_cm),
    }
    for key in ("camera_height_cm", "camera_distance_cm", "flash_height_cm", "leds_per_strip"):
        cells[key] = nowhere(remarks.BUILT_ALIKE)
    for key in ("box_cm", "pot_l", "led_wavelength_nm", "led_lumen", "led_power_w"):
        cells[key] = nowhere(remarks.NOT_IN_THE_BOX)
    return cells


def _experiments(results: Results) -> dict[str, Cell]:
    runs = results.runs
    open_loop = [run for run in runs if not run.is_closed_loop]
    waits = [switching_h(run.track) for run in open_loop]
    known = [wait for wait in waits if wait is not None]
    stop_cm = results.evolutions["own", LEFT.name].task.stop_height_cm
    reached = [hours for run in runs if (hours := hours_to_height(run.track, stop_cm)) is not None]
    growth = float(np.median([growth_cm_per_day(run.track) for run in runs]))
    share = f" {len(reached)} of {len(runs)} come so high in their {remarks.hours_text(runs[0].track)}."
    return {
        "growth_cm_per_day": both(growth, note=remarks.GROWTH),
        "open_loop_runs": both(float(len(open_loop))),
        "closed_loop_runs": both(float(len(runs) - len(open_loop))),
        "switching_h": both(float(np.median(known)) if known else None),
        "interval_min": both(runs[0].run.interval_s / MINUTE_S),
        "hours_to_stop": both(float(np.median(reached)) if reached else None, note=remarks.HOURS_TO_STOP + share),
    }


def _data(results: Results) -> dict[str, Cell]:
    recipe, vision = results.data.recipe, PaperSettings()
    shifts = 2 * len(recipe.generic.exponents)
    return {
        "stem_points": both(float(results.runs[0].track.points_cm.shape[1])),
        "picture_share": nowhere(remarks.PIXELS),
        "theta_1": Cell((vision.theta_1,), None, remarks.STEM_FINDER),
        "theta_2_px": Cell((vision.theta_2_px,), None, remarks.STEM_FINDER),
        "theta_3": Cell((float(recipe.noise.theta_3),), None, remarks.OWN_NEEDS_NO_SET),
        "omega": Cell((recipe.noise.omega,)),
        "noise_sequences": Cell((float(recipe.noise.sequences),)),
        "translations": Cell((float(shifts**2),)),
        "translation_exponents": Cell(tuple(float(one) for one in recipe.generic.exponents)),
        "jump_times": Cell((recipe.jump_times,)),
        "vectors": Cell((float(results.data.vectors),), None, remarks.vectors(len(results.runs))),
    }


def _training(results: Results) -> dict[str, Cell]:
    theirs, own = (results.simulators[side].provenance for side in SIDES)
    got, asked = theirs.results, theirs.settings
    weights = {"inputs": 2 * 9 + 1, "outputs": 2 * 9}
    counts = np.array([got[f"vectors_{part}"] for part in ("train", "validate", "test")], dtype=np.float64)
    shares = tuple((PERCENT * counts / counts.sum()).tolist())
    still = remarks.nothing_moves(got["nothing_moves_test"])
    return {
        "lstm_layers": Cell(
            (float(weights["inputs"]), float(asked["cells"]), float(weights["outputs"])), None, remarks.OWN_RECIPE
        ),
        "split_percent": Cell(shares, None, remarks.own_split(own.split)),
        "batch": Cell((float(asked["batch"]),)),
        "learning_rate": Cell((asked["learning_rate"],), _known(own.settings, "rate")),
        "most_epochs": Cell((float(asked["epochs"]),), _known(own.settings, "epochs")),
        "patience": Cell((float(asked["patience"]),), _known(own.settings, "patience")),
        "epochs": Cell((float(got["epochs"]),), _known(own.results, "epochs"), remarks.EPOCHS),
        "loss_train": Cell((got["loss_train"][-1],), None, remarks.LOSSES),
        "loss_validate": Cell((got["loss_validate"][-1],)),
        "mae_train": Cell((got["mae_train"],)),
        "mae_validate": Cell((got["mae_validate"],)),
        "mae_test": Cell((got["mae_test"],), None, still),
        "mae_mm": Cell((got["mae_test_mm"],), None, remarks.ONE_STEP),
    }


def _tasks(results: Results) -> dict[str, Cell]:
    left, middle = (results.evolutions["own", task.name].task for task in (LEFT, MIDDLE))
    controllers = {side: load_controller(results.evolutions[side, LEFT.name].best).file for side in SIDES}
    first = left.scenarios[0]
    stem, target, obstacle = first.target, middle.scenarios[0].target, first.obstacle
    return {
        "controller_inputs": per_side(lambda side: _inputs(controllers[side]), remarks.INPUTS),
        "threshold": both(LEFT_AT_MOST),
        "target_radius_cm": both(stem.radius_cm),
        "left_target_cm": both(stem.x_cm, stem.y_cm),
        "obstacle_size_cm": both(obstacle.width_cm, obstacle.height_cm),
        "left_obstacles_cm": both(*_centres(left)),
        "middle_target_cm": both(target.x_cm, target.y_cm),
        "middle_obstacles_cm": both(*_centres(middle)),
        "obstacle_height_cm": both(obstacle.y_cm),
        "stop_height_cm": both(left.stop_height_cm),
    }


def _evolution(results: Results) -> dict[str, Cell]:
    def by_side(task: Task, tell: Callable[[Any], Values], note: str = "") -> Cell:
        return per_side(lambda side: tell(results.evolutions[side, task.name]), note)

    cells = {
        "evolution_runs": by_side(LEFT, lambda one: (float(one.info.runs),)),
        "generations": by_side(LEFT, lambda one: (float(one.info.generations),), remarks.sizes(results)),
        "more_generations": nowhere(remarks.NO_EARLIER_TASK),
    }
    for task in (LEFT, MIDDLE):
        cells[f"{task.name}_converged"] = by_side(
            task, lambda one: (float(converged_generation(one.history.best_so_far)),), remarks.CONVERGED
        )
        cells[f"{task.name}_fitness"] = by_side(
            task,
            lambda one: (PERCENT * one.info.run[one.info.best_run - 1].best_fitness,),
            remarks.fitness(results, task),
        )
        cells[f"{task.name}_hours"] = by_side(
            task, lambda one: tuple(entry.hours for entry in one.info.episode), remarks.clock(results, task)
        )
    return cells


def _reality(results: Results) -> dict[str, Cell]:
    plants = {side: results.reality[side].plants for side in SIDES}
    ways = {side: [_way(plant) for plant in plants[side]] for side in SIDES}

    def by_plant(tell: Callable[[VirtualPlant], float | None], note: str = "") -> Cell:
        return per_side(lambda side: tuple(tell(plant) for plant in plants[side]), note)

    def by_way(tell: Callable[[Steering], float | None], note: str = "") -> Cell:
        return per_side(lambda side: tuple(tell(way) for way in ways[side]), note)

    obstacle = [plant.outcome.obstacle for side in SIDES for plant in plants[side]]
    return {
        "reality_obstacle_cm": both(obstacle[0].x_cm, obstacle[0].y_cm, note=remarks.UNSEEN_OBSTACLE),
        "reality_plants": per_side(lambda side: (float(len(plants[side])),), remarks.VIRTUAL),
        "right_light_h": by_way(lambda way: way.right_h, remarks.STEADY),
        "tip_at_switch_cm": per_side(lambda side: tuple(value for way in ways[side] for value in way.tip_cm)),
        "to_middle_h": by_way(lambda way: way.to_middle_h, remarks.TO_MIDDLE),
        "left_light_h": by_way(lambda way: way.left_h),
        "reality_fitness": by_plant(lambda plant: PERCENT * plant.fitness, remarks.reality(results)),
        "best_fitness": by_plant(lambda plant: PERCENT * plant.outcome.measured.best_fitness),
        "reality_hours": by_plant(lambda plant: plant.outcome.measured.ended_h, remarks.ends(results)),
        "slow_above_h": nowhere(remarks.NO_SICK_PLANT),
        "slow_end_h": nowhere(remarks.NO_SICK_PLANT),
    }


def _way(plant: VirtualPlant) -> Steering:
    track = plant.track
    within = track.time_s <= 3600.0 * plant.outcome.measured.ended_h + 1e-6
    count = max(2, int(within.sum()))
    return steering(track.time_s[:count], track.light[:count], track.points_cm[:count, -1])


def _inputs(file: ControllerFile) -> Values:
    """How many tell of the stem, of the target, and of the obstacle."""
    names = [one.name for one in file.inputs]
    target = sum(name.startswith("target") for name in names)
    obstacle = sum(name.startswith("obstacle") for name in names)
    return (float(len(names) - target - obstacle), float(target), float(obstacle))


def _centres(task: Task) -> list[float]:
    return [scenario.obstacle.x_cm for scenario in task.scenarios]


def _known(table: Mapping[str, Any], name: str) -> Values | None:
    value = table.get(name)
    return (float(value),) if isinstance(value, int | float) else None
