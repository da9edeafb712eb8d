"""The tables of an evolution's page."""

from __future__ import annotations

import itertools

import numpy as np

from flora_common.counted import counted
from flora_lab import judging
from flora_lab.evolve.evolution_folder import EpisodeTrack, Evolution, RunEntry, standing
from flora_lab.evolve.task import Task
from flora_lab.evolve_report import words
from flora_lab.html_page import pairs, table


def asked(evolution: Evolution) -> str:
    """What was asked."""
    info, task = evolution.info, evolution.task
    return pairs(
        [
            ("task", f"{task.name}: {_scenarios_text(task)}"),
            ("a run of the plant ends", f"at {task.stop_height_cm:g} cm, at the obstacle, or after {task.hours:g} h"),
            ("simulator", f"{info.simulator.name}, {info.simulator.kind}"),
            ("its weights, SHA-256", info.simulator.weights_sha256),
            ("its data set, SHA-256", info.simulator.dataset_sha256 or "none"),
            ("plants", plants_text(evolution)),
            ("runs", str(info.runs)),
            ("generations", f"{info.generations} of each run, numbered from 0"),
            ("population", str(info.population)),
            ("seed", str(info.seed)),
            ("software", info.software),
        ]
    )


def plants_text(evolution: Evolution) -> str:
    """Which plants a controller's fitness is of."""
    individuals = evolution.info.individuals
    if individuals.count == 0:
        return "the simulator's typical plant"
    judged = {"mean": "the mean over them counts", "worst": "the worst counts"}[individuals.judge]
    following = f", each following one of {individuals.members} members or their mean" if individuals.members else ""
    return f"{individuals.count} drawn from seed {individuals.seed}{following}; {judged}"


def by_fitness(evolution: Evolution) -> list[RunEntry]:
    """Runs, the best first; of equals the one with the lowest number."""
    return sorted(evolution.info.run, key=lambda run: (-standing(run), run.number))


def runs(evolution: Evolution) -> str:
    """What each run came to, the best first."""
    has_impossible = not evolution.task.is_possible.all()
    names = ["run", "fitness", "generation", "hidden nodes", "links", "begun anew", "seed"]
    if evolution.info.individuals.held_out:
        names.insert(2, "on other plants")
    if has_impossible:
        names.insert(2, "without impossible")
    rows = []
    for run in by_fitness(evolution):
        extinct = int(evolution.history.is_extinct[run.number - 1].sum())
        row = [str(run.number), judging.percent(run.best_fitness), str(run.generation_of_best), str(run.nodes)]
        row += [str(run.links), str(extinct) if extinct else "", str(run.seed)]
        if run.held_out_fitness is not None:
            row.insert(2, judging.percent(run.held_out_fitness))
        if has_impossible:
            row.insert(2, judging.percent(run.best_fitness_possible))
        rows.append(row)
    return table(names, rows)


def scenarios(evolution: Evolution) -> str:
    """What the best controller came to in each scenario."""
    names = ["scenario", "target, cm", "obstacle, cm", "fitness", "ended because", "hours", "least distance"]
    rows = [_scenario_row(episode, evolution.task) for episode in evolution.episodes]
    return table([*names, "lamp changes"], rows)


def time_taken(evolution: Evolution) -> str:
    """Where the time went."""
    took = evolution.info.took
    parts = (
        ("simulated plants and networks", took.evaluation_s),
        ("NEAT: reproduction and species", took.neat_s),
        ("the rest of the runs", took.other_s),
    )
    worked = sum(seconds for _, seconds in parts)
    commands = f", {took.commands} commands added up" if took.commands > 1 else ""
    steps = int(evolution.history.episode_steps.sum())
    simulated = int(evolution.history.plant_steps.sum())
    return pairs(
        [
            (f"from start to end{commands}", _seconds(took.wall_s)),
            *((name, f"{_seconds(seconds)}{_share(seconds, worked)}") for name, seconds in parts),
            ("steps of all episodes", f"{steps:,}"),
            ("steps of plants that were simulated for them", f"{simulated:,}{_share(simulated, steps)}"),
        ]
    )


def controller_files(evolution: Evolution) -> str:
    """Controller files with their hashes, that of the best first."""
    best = evolution.info.run[evolution.info.best_run - 1]
    rows = [[evolution.best.name, best.sha256, f"run {best.number}"]]
    rows += [[run.controller, run.sha256, f"run {run.number}"] for run in by_fitness(evolution)]
    return table(["file", "SHA-256", "of"], rows)


def _scenario_row(episode: EpisodeTrack, task: Task) -> list[str]:
    target, obstacle = episode.scenario.target, episode.scenario.obstacle
    return [
        episode.scenario.name + ("" if episode.scenario.is_possible else " (impossible)"),
        f"({target.x_cm:g}, {target.y_cm:g}), radius {target.radius_cm:g}",
        f"({obstacle.x_cm:g}, {obstacle.y_cm:g}), {obstacle.width_cm:g} x {obstacle.height_cm:g}",
        judging.percent(episode.fitness),
        words.ended(episode.reason, task),
        f"{words.hours_of(episode):.1f}",
        f"{episode.clearance_cm:.1f} cm",
        str(sum(a != b for a, b in itertools.pairwise(np.asarray(episode.is_right).tolist()))),
    ]


def _scenarios_text(task: Task) -> str:
    count = len(task.scenarios)
    impossible = sum(not scenario.is_possible for scenario in task.scenarios)
    text = counted(count, "scenario")
    return text + (f", {impossible} of them impossible for any plant" if impossible else "")


def _seconds(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.1f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _share(part: float, whole: float) -> str:
    return f" ({100.0 * part / whole:.0f} %)" if whole else ""
