"""The best controller's episodes as PNG bytes: the stem through time in each scenario, and which lamp shone when."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from flora_common.arrays import BoolArray, FloatArray
from flora_lab import judging
from flora_lab.evolve.evolution_folder import EpisodeTrack, Evolution
from flora_lab.evolve.task import Task
from flora_lab.evolve_report import words
from flora_lab.evolve_report.scene import Window, draw_lamps, draw_scenario, light_lamps, side, window_of
from flora_lab.figure_style import GREY, LAMP_COLOURS, TARGET, new_figure, png

STEMS: Final = 6
"""As many stems are drawn in a panel, from light (the start) to dark (the end)."""
MOST_PANELS: Final = 12
COLUMNS: Final = 4
PANEL_WIDE_IN: Final = 2.9
STRIP_IN: Final = 0.75
HEAD_IN: Final = 0.9


def stems_figure(evolution: Evolution) -> bytes:
    """A panel for each scenario; of very many the first, which the page's table goes beyond."""
    shown = evolution.episodes[:MOST_PANELS]
    window = window_of(evolution.task, [episode.stems_cm for episode in shown])
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    tall = PANEL_WIDE_IN * min(window.shape, 2.0)
    figure = new_figure(0.4 + PANEL_WIDE_IN * columns, rows * (tall + STRIP_IN + HEAD_IN))
    heights = [tall, STRIP_IN] * rows
    axes = figure.subplots(2 * rows, columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    longest_h = max(words.hours_of(episode) for episode in shown) or 1.0
    for k in range(rows * columns):
        above, below = axes[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
        if k < len(shown):
            _panel(above, shown[k], evolution.task, window)
            _lamp_strip(below, shown[k], longest_h)
            if k % columns:
                below.set_yticklabels([])
        else:
            above.set_axis_off()
            below.set_axis_off()
    axes[0, 0].set_ylabel("cm", fontsize=8)
    if len(shown) < len(evolution.episodes):
        text = f"the first {MOST_PANELS} of {len(evolution.episodes)} scenarios"
        figure.suptitle(text, fontsize=9, color=GREY)
    return png(figure)


def task_figure(task: Task) -> bytes:
    """What is asked: the stem at the start, obstacle and target of each scenario; of very many the first."""
    shown = task.scenarios[:MOST_PANELS]
    window = window_of(task)
    columns = min(6, len(shown))
    rows = -(-len(shown) // columns)
    wide = 1.75
    figure = new_figure(0.3 + wide * columns, rows * (wide * min(window.shape, 2.0) + 0.5))
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, scenario in zip(axes, shown, strict=False):
        draw_scenario(ax, scenario, window)
        ax.plot(*task.start_stem_cm.T, color="black", linewidth=1.8)
        ax.axhline(task.stop_height_cm, color=GREY, linestyle=":", linewidth=0.8)
        ax.set_title(words.panel_title(scenario), fontsize=8, parse_math=False)
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    return png(figure)


def lamp_spans(is_right: BoolArray, time_s: FloatArray) -> list[tuple[bool, float, float]]:
    """Which lamp shone from when to when: (right or left, hours from the start, for how many hours).

    Args:
        is_right: shape (n - 1,).
        time_s: shape (n,).
    """
    if not len(is_right):
        return []
    changes = np.flatnonzero(np.diff(is_right)) + 1
    edges = [0, *changes.tolist(), len(is_right)]
    hours = (time_s - time_s[0]) / 3600.0
    return [(bool(is_right[a]), float(hours[a]), float(hours[b] - hours[a])) for a, b in pairwise(edges)]


def _panel(ax: Axes, episode: EpisodeTrack, task: Task, window: Window) -> None:
    draw_scenario(ax, episode.scenario, window)
    tips = episode.stems_cm[:, -1]
    ax.plot(*tips.T, color=TARGET, linewidth=0.7, alpha=0.8)
    for row, colour in _shown_rows(len(episode.time_s)):
        ax.plot(*episode.stems_cm[row].T, color=colour, linewidth=1.9, solid_capstyle="round")
    light = side(bool(episode.is_right[-1])) if len(episode.is_right) else None
    light_lamps(draw_lamps(ax), light)
    title = words.panel_title(episode.scenario)
    end = f"{words.ended(episode.reason, task)}, {words.hours_of(episode):.1f} h"
    ax.set_title(f"{title}\n{judging.percent(episode.fitness)}: {end}", fontsize=8, parse_math=False)


def _lamp_strip(ax: Axes, episode: EpisodeTrack, longest_h: float) -> None:
    """Two rows, the right lamp's above; dots over them mark when the stems above were."""
    rows: Sequence[tuple[bool, float]] = ((True, 1.0), (False, 0.0))
    for is_right, bottom in rows:
        spans = [(begin, long) for lit, begin, long in lamp_spans(episode.is_right, episode.time_s) if lit == is_right]
        ax.broken_barh(spans, (bottom + 0.05, 0.9), facecolors=LAMP_COLOURS[side(is_right)], linewidth=0)
    hours = (episode.time_s - episode.time_s[0]) / 3600.0
    for row, colour in _shown_rows(len(hours)):
        ax.plot(hours[row], 2.4, "o", color=colour, markersize=4, clip_on=False)
    ax.set(xlim=(0.0, longest_h), ylim=(0.0, 2.7), yticks=[0.5, 1.5])
    ax.set_yticklabels(["left", "right"])
    ax.tick_params(labelsize=7, length=2)
    ax.set_xlabel("hours", fontsize=8)


def _shown_rows(count: int) -> list[tuple[int, Any]]:
    """Rows of the stems that are drawn, evenly in time, with their colours."""
    rows = np.unique(np.linspace(0, count - 1, STEMS).round().astype(int)).tolist()
    shades = mpl.colormaps["Greens"](np.linspace(0.35, 1.0, len(rows)))
    return list(zip(rows, shades.tolist(), strict=True))
