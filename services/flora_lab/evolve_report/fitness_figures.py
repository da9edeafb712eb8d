"""How fitness rises over the generations of several runs, as PNG bytes: the paper's two figures, and one more.

Wahby et al. 2018, section "Evolving controllers in simulation": box plots and functional box plots of the best fitness
of each generation over 20 runs.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes

from flora_common.arrays import FloatArray
from flora_common.counted import counted
from flora_lab.evolve.evolution_folder import History
from flora_lab.evolve.task import Task, averages
from flora_lab.evolve_report.curves import draw_curve, generation_axis, generations
from flora_lab.evolve_report.functional_box import functional_box
from flora_lab.evolve_report.words import panel_title
from flora_lab.figure_style import BLUE, COLOURS, GREY, ORANGE, new_figure, png

BOXES: Final = 21
"""As many generations have a box at most: the first, others at even distances, and the last."""
FEWEST_RUNS: Final = 5
"""A box says nothing about fewer; they are drawn one by one."""
LEAST_OUTSIDE: Final = 0.001
"""A run is an outlier only where it is this far beyond the fence: 0.1 %, the last digit that people read."""
MOST_SCENARIOS: Final = 12
"""As many scenarios have a curve of their own."""
PAPER_LABEL: Final = "one of the paper's best controllers"


def fitness_boxes(history: History, task: Task, paper_percent: float | None = None) -> bytes:
    """Best fitness of each generation: box plots over runs, and the median over runs at every generation.

    Args:
        history: of the runs.
        task: a second panel leaves out its impossible scenarios, where it has any.
        paper_percent: what the paper says of its best controllers, over all scenarios.
    """
    panels = _panels(history, task)
    figure = new_figure(0.6 + 4.7 * max(len(panels), 1.6), 4.0)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for ax, (title, fitness) in zip(axes, panels, strict=True):
        _boxes(ax, 100.0 * fitness)
        is_whole_task = ax is axes[0]
        if is_whole_task and history.is_extinct.any():
            _best_so_far(ax, 100.0 * history.best_so_far)
        if is_whole_task and paper_percent is not None:
            label = f"{PAPER_LABEL}: {paper_percent:g} %"
            ax.axhline(paper_percent, color=GREY, linestyle="--", linewidth=1.2, label=label)
        ax.set_title(title, fontsize=10)
        ax.legend(loc="lower right", fontsize=8, framealpha=0.9)
    _fitness_axis(axes[0], "best fitness of a generation")
    return png(figure)


def functional_boxes(history: History) -> bytes:
    """Best fitness of each generation as a functional box plot: whole runs, from the most central to outliers."""
    figure = new_figure(8.1, 4.0)
    ax = figure.subplots()
    fitness = 100.0 * history.best_fitness
    if len(fitness) < FEWEST_RUNS:
        _single_runs(ax, fitness)
    else:
        box = functional_box(fitness, least=100.0 * LEAST_OUTSIDE)
        places = generations(fitness.shape[1])
        ax.fill_between(places, *box.envelope, color=BLUE, alpha=0.15, linewidth=0, label="all but outliers")
        ax.fill_between(places, *box.region, color=BLUE, alpha=0.4, linewidth=0, label="deeper half of the runs")
        for k, place in enumerate(box.outliers):
            name = _outliers_text(box.outliers) if k == 0 else None
            draw_curve(ax, fitness[place], color=ORANGE, linestyle="--", linewidth=0.9, label=name)
        name = f"median curve: run {box.median + 1}"
        draw_curve(ax, fitness[box.median], color="black", linewidth=1.8, label=name)
    ax.set_title(_title(len(fitness)), fontsize=10)
    ax.legend(loc="lower right", fontsize=8, framealpha=0.9)
    _fitness_axis(ax, "best fitness of a generation")
    return png(figure)


def scenario_curves(history: History, task: Task) -> bytes:
    """Fitness of each generation's best genome in each scenario, median over runs."""
    figure = new_figure(8.1, 4.0)
    ax = figure.subplots()
    middle = 100.0 * np.median(history.by_scenario, axis=0)
    shown = task.scenarios[:MOST_SCENARIOS]
    for k, scenario in enumerate(shown):
        colour = COLOURS[k % len(COLOURS)]
        style = ("-" if k < len(COLOURS) else "-.") if scenario.is_possible else ":"
        draw_curve(ax, middle[:, k], color=colour, linestyle=style, linewidth=1.5, label=str(k))
    left_out = len(task.scenarios) - MOST_SCENARIOS
    ax.set_title(
        "median over runs" + (f"; {counted(left_out, 'more scenario')} not drawn" if left_out > 0 else ""), fontsize=10
    )
    legend = figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    for text, scenario in zip(legend.get_texts(), shown, strict=True):
        text.set_parse_math(False)
        text.set_text(panel_title(scenario))
    _fitness_axis(ax, "fitness of a generation's best")
    return png(figure)


def box_generations(count: int) -> list[int]:
    """Which generations, counted from 0, have a box."""
    step = max(1, -(-(count - 1) // (BOXES - 1)))
    places = [place for place in range(0, count, step) if place <= count - 1 - step / 2]
    return [*places, count - 1]


def _panels(history: History, task: Task) -> list[tuple[str, FloatArray]]:
    """What is drawn beside each other: title and fitness, shape (runs, generations)."""
    runs = _title(len(history.best_fitness))
    if task.is_possible.all():
        return [(runs, history.best_fitness)]
    possible = averages(task, history.by_scenario).of_possible
    return [
        (f"all scenarios, {runs}", history.best_fitness),
        ("the same genomes, without impossible scenarios", possible),
    ]


def _title(runs: int) -> str:
    return counted(runs, "run") + (f"; box plots need {FEWEST_RUNS}" if runs < FEWEST_RUNS else "")


def _boxes(ax: Axes, fitness: FloatArray) -> None:
    """Box plots and the median of fitness in percent, shape (runs, generations)."""
    if len(fitness) < FEWEST_RUNS:
        _single_runs(ax, fitness)
        return
    places = box_generations(fitness.shape[1])
    step = places[1] - places[0] if len(places) > 1 else 1
    ax.boxplot(
        [fitness[:, place] for place in places],
        positions=places,
        widths=0.55 * step,
        manage_ticks=False,
        patch_artist=True,
        boxprops={"facecolor": "#cfe3f0", "edgecolor": BLUE, "linewidth": 0.9},
        whiskerprops={"color": BLUE, "linewidth": 0.9},
        capprops={"color": BLUE, "linewidth": 0.9},
        medianprops={"color": "black", "linewidth": 1.4},
        flierprops={"marker": "o", "markersize": 2.5, "markerfacecolor": "none", "markeredgecolor": ORANGE},
    )
    draw_curve(ax, np.median(fitness, axis=0), color="black", linewidth=1.0, label="median over runs")


def _best_so_far(ax: Axes, fitness: FloatArray) -> None:
    """Where populations are left for new ones, which begin low, the runs' best are not those of the generation."""
    draw_curve(ax, np.median(fitness, axis=0), color=ORANGE, linewidth=1.4, label="median of the runs' best so far")


def _single_runs(ax: Axes, fitness: FloatArray) -> None:
    """Too few for boxes: every run, and where there are two or more their median."""
    for k, curve in enumerate(fitness):
        draw_curve(ax, curve, color=COLOURS[k], linewidth=1.1, label=f"run {k + 1}")
    if len(fitness) > 1:
        draw_curve(ax, np.median(fitness, axis=0), color="black", linewidth=1.6, label="median")


def _fitness_axis(ax: Axes, name: str) -> None:
    for other in ax.figure.axes:
        generation_axis(other)
    ax.set_ylabel(name)
    ax.yaxis.set_major_formatter(lambda value, _place: f"{value:g} %")


def _outliers_text(outliers: tuple[int, ...]) -> str:
    names = ", ".join(str(place + 1) for place in outliers[:8]) + (", …" if len(outliers) > 8 else "")
    return f"outlier: run {names}" if len(outliers) == 1 else f"outliers: runs {names}"
