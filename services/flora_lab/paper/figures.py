"""The paper's pictures, drawn alike for both simulators, and how virtual plants were steered. PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from flora_common.runs import Light
from flora_lab.evolve.evolution_folder import EpisodeTrack
from flora_lab.evolve.task import Task
from flora_lab.evolve_report.fitness_figures import fitness_boxes, functional_boxes
from flora_lab.evolve_report.paper_results import BEST_PERCENT
from flora_lab.evolve_report.scene import Window, draw_lamps, draw_scenario, light_lamps, side, window_of
from flora_lab.evolve_report.stems_figure import lamp_spans
from flora_lab.figure_style import BLUE, GREY, LAMP_COLOURS, ORANGE, TARGET, new_figure, png
from flora_lab.paper.measures import SECONDS_PER_HOUR
from flora_lab.paper.pipeline import SIDE_WORDS, SIDES, TASKS, Side
from flora_lab.paper.published import LEFT_PICTURES_H, MIDDLE_PICTURES_H
from flora_lab.paper.results import Results, VirtualPlant

PANEL_WIDE_IN: Final = 2.4
MOST_PLANTS: Final = 4
LAMP_BAR: Final = 0.05
"""Height of the bar that tells the lamps, as a share of its axes."""
SCENARIOS: Final = {"left": 1, "middle": 0}
"""Of which scenario stems are shown: with the left target the second, of which the paper's text speaks. With the middle
one the paper does not say."""
PICTURES_H: Final = {"left": LEFT_PICTURES_H, "middle": MIDDLE_PICTURES_H}


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture with its words.

    Attributes:
        name: of its file, without the ending.
        paper: which of the paper's figures it repeats.
        alt: what it shows, for those who do not see it.
        caption: how to read it.
        data: PNG bytes.
    """

    name: str
    paper: str
    alt: str
    caption: str
    data: bytes


def draw_all(results: Results) -> list[Picture]:
    """All of them but photographs, in the order of the paper."""
    return [*_curves(results), *(one for task in TASKS for one in _of_task(results, task)), steering_figure(results)]


def _curves(results: Results) -> list[Picture]:
    return [
        Picture(
            f"training-{of}",
            "training of the LSTM-based model",
            f"Training and validation loss over epochs, {SIDE_WORDS[of]}",
            f"Losses over epochs, {SIDE_WORDS[of]}.",
            results.curves[of],
        )
        for of in SIDES
        if of in results.curves
    ]


def _of_task(results: Results, task: Task) -> list[Picture]:
    words = {of: f"{task.name} target, simulator of {SIDE_WORDS[of]}" for of in SIDES}
    histories = {of: results.evolutions[of, task.name].history for of in SIDES}
    found = [
        Picture(
            f"boxes-{task.name}-{of}",
            f"box plots of the best fitness of each generation, {task.name} target",
            f"Box plots of the best fitness over generations, {words[of]}",
            f"Best fitness of a generation over runs, {words[of]}.",
            fitness_boxes(histories[of], task, BEST_PERCENT[task.name]),
        )
        for of in SIDES
    ]
    found += [
        Picture(
            f"functional-boxes-{task.name}-{of}",
            f"functional box plot of the best fitness of each generation, {task.name} target",
            f"Functional box plot of the best fitness over generations, {words[of]}",
            f"Whole runs in order, {words[of]}.",
            functional_boxes(histories[of]),
        )
        for of in SIDES
    ]
    hours = ", ".join(f"{hour:g}" for hour in PICTURES_H[task.name])
    caption = (
        f"The paper's are at {hours} simulated hours; these are at the same shares of each episode, with the "
        "hours over them. Obstacle grey, target red; circles: the lamps, filled when lit."
    )
    found.append(
        Picture(
            f"stems-{task.name}",
            f"stem geometry of a simulated plant at three times, {task.name} target",
            f"Stems at three times in both simulators, {task.name} target",
            caption,
            stems_figure(results, task),
        )
    )
    return found


def stems_figure(results: Results, task: Task) -> bytes:
    """The stem at the paper's times, as shares of its last one: a row for each simulator."""
    shares = [hour / PICTURES_H[task.name][-1] for hour in PICTURES_H[task.name]]
    place = SCENARIOS[task.name]
    episodes = {of: results.evolutions[of, task.name].episodes[place] for of in SIDES}
    window = window_of(task, [episode.stems_cm for episode in episodes.values()])
    figure = new_figure(0.5 + PANEL_WIDE_IN * len(shares), len(SIDES) * (PANEL_WIDE_IN * min(window.shape, 2.0) + 0.55))
    axes = figure.subplots(len(SIDES), len(shares), squeeze=False)
    for line, of in zip(axes, SIDES, strict=True):
        for ax, share in zip(line, shares, strict=True):
            _moment(ax, episodes[of], share, window)
        line[0].set_ylabel(f"{SIDE_WORDS[of]}, cm", fontsize=8)
    return png(figure)


def _moment(ax: Axes, episode: EpisodeTrack, share: float, window: Window) -> None:
    row = round(share * (len(episode.time_s) - 1))
    draw_scenario(ax, episode.scenario, window)
    ax.plot(*episode.stems_cm[: row + 1, -1].T, color=TARGET, linewidth=0.7)
    ax.plot(*episode.stems_cm[row].T, color="#2a7f3f", linewidth=2.2, solid_capstyle="round")
    light: Light | None = side(bool(episode.is_right[row - 1])) if row else None
    light_lamps(draw_lamps(ax), light)
    ax.set_title(f"{(episode.time_s[row] - episode.time_s[0]) / SECONDS_PER_HOUR:.1f} h", fontsize=9)


def steering_figure(results: Results) -> Picture:
    """Tips of virtual plants over time, and the lamps under them."""
    plants: dict[Side, Sequence[VirtualPlant]] = {of: results.reality[of].plants[:MOST_PLANTS] for of in SIDES}
    columns = max(len(row) for row in plants.values())
    longest_h = max(plant.track.time_s[-1] / SECONDS_PER_HOUR for row in plants.values() for plant in row)
    figure = new_figure(0.8 + max(3.0 * columns, 5.0), 5.6)
    axes = figure.subplots(len(SIDES), columns, squeeze=False, sharex=True, sharey=True)
    for line, of in zip(axes, SIDES, strict=True):
        for k, ax in enumerate(line):
            if k < len(plants[of]):
                _way(ax, plants[of][k], of)
            else:
                ax.set_axis_off()
        line[0].set_ylabel("cm", fontsize=8)
    low, high = axes[0, 0].get_ylim()
    for ax in axes[-1]:
        ax.set(xlim=(0.0, longest_h), ylim=(low - 2.0 * LAMP_BAR * (high - low), high))
        ax.set_xlabel("hours", fontsize=8)
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8
    )
    return Picture(
        "steering",
        "course of an experiment with a real plant, which its text tells",
        "Tips of virtual plants over time and which lamp shone",
        "Controllers evolved in the simulator of the paper's recipe (above) and in ours (below), on the same virtual "
        "plants; dotted: the target. The bar shows which lamp shone.",
        png(figure),
    )


def _way(ax: Axes, plant: VirtualPlant, of: Side) -> None:
    hours, tips = plant.track.time_s / SECONDS_PER_HOUR, plant.track.points_cm[:, -1]
    target = plant.outcome.target
    ax.plot(hours, tips[:, 1], color=BLUE, linewidth=1.3, label="height of the tip")
    ax.plot(hours, tips[:, 0], color=ORANGE, linewidth=1.3, label="tip to the right")
    for level, colour in ((target.y_cm, BLUE), (target.x_cm, ORANGE)):
        ax.axhline(level, color=colour, linestyle=":", linewidth=0.9)
    ax.axhline(0.0, color=GREY, linewidth=0.5)
    is_right = np.array([light == "right" for light in plant.track.light[1:]])
    spans = lamp_spans(is_right, plant.track.time_s)
    for lit_right in (False, True):
        name = side(lit_right)
        bars = [(begin, long) for lit, begin, long in spans if lit == lit_right]
        ax.broken_barh(
            bars,
            (0.0, LAMP_BAR),
            transform=ax.get_xaxis_transform(),
            facecolors=LAMP_COLOURS[name],
            linewidth=0,
            label=f"{name} lamp",
        )
    title = f"{SIDE_WORDS[of]}: plant {plant.outcome.seed}, {100 * plant.fitness:.1f} %"
    ax.set_title(title, fontsize=8)
    ax.tick_params(labelsize=7)
