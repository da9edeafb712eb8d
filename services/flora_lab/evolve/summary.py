"""What ``flora-lab evolve`` says when it is over."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import Any

from flora_common.counted import counted
from flora_lab.evolve.evolution_folder import BEST_FILE, EvolutionFile, RunEntry
from flora_lab.judging import percent


def as_json(info: EvolutionFile, output: Path) -> dict[str, Any]:
    """The figures that scripts want."""
    best = _best(info)
    return {
        "output": str(output),
        "task": info.task,
        "runs": info.runs,
        "generations": info.generations,
        "population": info.population,
        "seed": info.seed,
        "median_best_fitness": median(run.best_fitness for run in info.run),
        "median_best_fitness_possible": median(run.best_fitness_possible for run in info.run),
        "best_run": best.number,
        "best_fitness": best.best_fitness,
        "best_fitness_possible": best.best_fitness_possible,
        "best_held_out_fitness": best.held_out_fitness,
        "best_controller": str(output / BEST_FILE),
        "best_controller_sha256": best.sha256,
        "by_scenario": {
            episode.scenario: {"fitness": episode.fitness, "reason": episode.reason, "hours": episode.hours}
            for episode in info.episode
        },
        "took": {
            "wall_s": info.took.wall_s,
            "commands": info.took.commands,
            "evaluation_s": info.took.evaluation_s,
            "neat_s": info.took.neat_s,
            "other_s": info.took.other_s,
        },
    }


def text(info: EvolutionFile, output: Path) -> str:
    """A few lines for people."""
    best = _best(info)
    lines = [
        f"task       {info.task}: {counted(info.runs, 'run')} of {counted(info.generations, 'generation')}, "
        f"population {info.population}",
        f"fitness    {percent(median(run.best_fitness for run in info.run))} median over runs, "
        f"{percent(best.best_fitness)} {_word(best)} (run {best.number}, generation {best.generation_of_best})",
    ]
    if any(run.best_fitness_possible != run.best_fitness for run in info.run):
        possible = median(run.best_fitness_possible for run in info.run)
        lines.append(
            f"           {percent(possible)} median, {percent(best.best_fitness_possible)} {_word(best)} "
            "without the scenarios that no plant can do"
        )
    if best.held_out_fitness is not None:
        others = f"{counted(info.individuals.held_out, 'plant')} that nothing was evolved on"
        lines.append(f"           {percent(best.held_out_fitness)} of the best on {others}, the most of all runs")
    name = "episodes"
    for episode in info.episode:
        lines.append(
            f"{name:<10} {episode.scenario}: {percent(episode.fitness)} after {episode.hours:.1f} h ({episode.reason})"
        )
        name = ""
    took = info.took
    commands = f" in {took.commands} commands" if took.commands > 1 else ""
    lines.append(
        f"time       {took.wall_s:.0f} s{commands}; of all work {took.evaluation_s:.0f} s simulated plants, "
        f"{took.neat_s:.0f} s NEAT, {took.other_s:.0f} s the rest"
    )
    lines.append(f"wrote {output}")
    return "\n".join(lines) + "\n"


def _best(info: EvolutionFile) -> RunEntry:
    return info.run[info.best_run - 1]


def _word(best: RunEntry) -> str:
    """Of several runs on drawn plants the best is the one that does best on others, whatever it has on its own."""
    return "best" if best.held_out_fitness is None else "that of the chosen one"
