"""An evaluation as one JSON object, for scripts."""

from __future__ import annotations

from collections import Counter
from typing import Any

from flora_lab.evaluate.evaluation import Evaluation
from flora_lab.evaluate.folder import FORMAT
from flora_lab.evaluate.gap import MEASURES, REAL_PLANTS, Gap, Row, averages, gaps
from flora_lab.evolve.task import Scenario
from flora_lab.simulator.store import software


def as_json(one: Evaluation) -> dict[str, Any]:
    """Every number, with units in the names; fitness from 0 to 1; null where there is none."""
    plan = one.plan
    return {
        "format": FORMAT,
        "software": software(),
        "controllers": [
            {"name": c.name, "file": str(c.path), "sha256": c.sha256, "evolved_for": c.loaded.file.task.name}
            for c in plan.controllers
        ],
        "task": plan.task.name,
        "scenarios": [_scenario(row) for row in plan.task.scenarios],
        "hours": plan.task.hours,
        "stop_height_cm": plan.task.stop_height_cm,
        "repeat": plan.repeat,
        "seed": plan.seed,
        "simulators": [
            {"name": name, "kind": info.kind, "weights_sha256": info.weights_sha256}
            for name, info in one.simulators.items()
        ],
        "on_twin": one.on_twin,
        "trials": [trial.numbers() for trial in one.trials],
        "summary": [_row(row) for row in one.rows],
        "averages": [
            {
                "place": a.place,
                "controller": a.controller,
                "possible_only": a.possible_only,
                **{measure: {"typical": a.typical[measure], "mean": a.mean[measure]} for measure in MEASURES},
            }
            for a in averages(plan, one.rows)
        ],
        "gap": [_gap(gap) for gap in gaps(one.rows)],
        "paper": {"real_plants_fitness": list(REAL_PLANTS)} if one.has_real_plants else None,
        "failed": dict(one.failed),
    }


def _scenario(scenario: Scenario) -> dict[str, Any]:
    target, obstacle = scenario.target, scenario.obstacle
    return {
        "name": scenario.name,
        "is_possible": scenario.is_possible,
        "target_cm": [target.x_cm, target.y_cm],
        "target_radius_cm": target.radius_cm,
        "obstacle_cm": [obstacle.x_cm, obstacle.y_cm],
        "obstacle_size_cm": [obstacle.width_cm, obstacle.height_cm],
    }


def _row(row: Row) -> dict[str, Any]:
    trials = row.trials
    return {
        "place": row.place,
        "controller": row.controller,
        "scenario": row.scenario.name,
        "is_possible": row.scenario.is_possible,
        "plants": len(row.plants),
        **{
            measure: {"typical": row.of_typical(measure), "mean": row.mean(measure), "worst": row.worst(measure)}
            for measure in MEASURES
        },
        "reached": sum(trial.fitness_at_target is not None for trial in trials),
        "ended": dict(Counter(trial.ended for trial in trials)),
        "hours": sum(trial.hours for trial in trials) / len(trials),
        "clearance_cm": min(trial.clearance_cm for trial in trials),
    }


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "simulator": gap.simulator,
        "controller": gap.controller,
        "scenario": gap.scenario,
        **{measure: {"of_typical": gap.of_typical[measure], "of_drawn": gap.of_drawn[measure]} for measure in MEASURES},
    }
