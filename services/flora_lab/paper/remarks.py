"""Why a quantity differs from the paper's, or is not there: a sentence or two for a row of the comparison.

What has been measured once and for all stands in docs/results/simulators.md; numbers here are those of the run at hand.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.counted import counted
from flora_common.tracks import Track
from flora_lab.evolve.task import Task
from flora_lab.paper.pipeline import SIDES, Side, evolving
from flora_lab.paper.results import Results
from flora_lab.paper.scales import PIXEL_CM

BUILT_ALIKE: Final = "The virtual box is built to this measure; no file of a run tells it."
NOT_IN_THE_BOX: Final = "No file of a run tells it; the virtual plant knows direction and level of light only."
GROWTH: Final = "Median over the dataset runs, from seedling to end. The paper cites it for beans in general."
HOURS_TO_STOP: Final = "Median over the dataset runs."
PIXELS: Final = (
    f"Stems are the plant's own. For the paper's recipe they are told in whole pixels of {10 * PIXEL_CM:g} mm, "
    "which photographs at 1/8 of their size have."
)
STEM_FINDER: Final = "As `flora-lab track --method paper` has it; no photographs are taken for the training set."
OWN_NEEDS_NO_SET: Final = "Our recipe learns from the runs themselves, without copies."
OWN_RECIPE: Final = "Ours is no network from stem to stem: it learns the law by which a growing stem bends."
EPOCHS: Final = "The weights that are kept are those of the best epoch; of this the paper says nothing."
LOSSES: Final = "The paper's normalised unit is taken as 65 cm, so that its errors are the 1 mm that it tells."
ONE_STEP: Final = "One step hides what a simulator gets wrong: docs/results/simulators.md compares runs of days."
INPUTS: Final = "As many of them as the best controller for the left target is told."
NO_EARLIER_TASK: Final = "Its earlier task, targets without an obstacle, is not done here."
CONVERGED: Final = (
    "Ours: the first generation from which the median over runs of the best fitness stays within one percentage point "
    "of its last value; the paper judges by eye."
)
UNSEEN_OBSTACLE: Final = (
    "The paper's tasks have no obstacle there. The controller of our recipe was evolved round larger ones near to it, "
    "on drawn plants (task round)."
)
VIRTUAL: Final = "Virtual plants through camera, stem finder, network and lamps; none was learned from."
STEADY: Final = "Ours: as long as the lamp has 95 % of the time. Values are one for each plant."
TO_MIDDLE: Final = "Ours: until the tip is within 1 cm of the middle; none where it was not to the right."
NO_SICK_PLANT: Final = "Virtual plants differ, but none is ill."


def hours_text(track: Track) -> str:
    """How long a run is."""
    return f"{(track.time_s[-1] - track.time_s[0]) / 3600.0:.0f} h"


def vectors(runs: int) -> str:
    """Of the size of the training set."""
    return (
        f"From {counted(runs, 'run')}. How long the paper's runs are, and which movements it chose by hand, is not "
        "told; counts after each step are below."
    )


def own_split(words: str) -> str:
    """Of the split of our recipe."""
    return f"Ours: {words}." if words else ""


def nothing_moves(error: float) -> str:
    """Of the error on the test set."""
    return (
        f"A stem that does not move has {error:.2e} on this test set: virtual tracks have no error of measurement but "
        "whole pixels. Copies of a test stem are in the training set, in the paper and here."
    )


def sizes(results: Results) -> str:
    """Of the evolutions."""
    parts = []
    for side, where in zip(SIDES, ("In the simulator of the paper's recipe", "in ours"), strict=True):
        size = evolving(results.asked.scale, side)
        plants = counted(size.individuals, "drawn plant") if size.individuals else "the typical plant"
        how = f", NEAT with the settings `{size.neat}`" if size.neat else ""
        parts.append(f"{where} {size.population} controllers on {plants}{how}")
    return f"{', '.join(parts)}. The paper does not tell its population."


def fitness(results: Results, task: Task) -> str:
    """Of the best controllers."""
    medians = " and ".join(
        f"{100 * np.median([run.best_fitness for run in results.evolutions[side, task.name].info.run]):.1f}"
        for side in SIDES
    )
    words = f"The median run comes to {medians} %."
    if task.is_possible.all():
        return words
    possible = " and ".join(f"{100 * _best_possible(results, task, side):.1f}" for side in SIDES)
    return f"{words} Without the scenario that no plant can do, the best have {possible} %."


def _best_possible(results: Results, task: Task, side: Side) -> float:
    info = results.evolutions[side, task.name].info
    return info.run[info.best_run - 1].best_fitness_possible


def clock(results: Results, task: Task) -> str:
    """Of simulated time."""
    theirs, own = (
        float(np.mean([entry.hours for entry in results.evolutions[side, task.name].info.episode])) for side in SIDES
    )
    words = "Ours: hours at the end of each scenario."
    if own > 2.0 * theirs:
        return (
            f"{words} The plant of the paper's recipe is {own / theirs:.0f} times as fast as ours, and too fast, like "
            "the paper's: told in whole pixels a stem moves by a pixel or not at all, pairs without a change are "
            "dropped, and the mean absolute error favours the most likely whole step (The clock, in "
            "docs/results/simulators.md)."
        )
    return words


def reality(results: Results) -> str:
    """Of the fitness on virtual plants."""
    parts = []
    for side, name in zip(SIDES, ("the paper's recipe", "ours"), strict=True):
        one = results.reality[side]
        foretold = one.simulated[side].fitness
        mean = np.mean([plant.fitness for plant in one.plants])
        parts.append(f"{name} {100 * foretold:.1f} %, {100 * (foretold - mean):+.1f} points above the plants' mean")
    return f"When the target is reached, else at the end. Each simulator foretold: {'; '.join(parts)}."


def ends(results: Results) -> str:
    """Of how the runs ended."""
    words = [", ".join(plant.outcome.measured.ended for plant in results.reality[side].plants) for side in SIDES]
    hours = results.asked.scale.reality_hours
    return f"They ended by: {words[0]}; {words[1]}. Ours end after {hours:g} h at the latest; the paper's went on."
