"""Episodes as a film: the stem grows, lamps shine, all scenarios beside each other under one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.lines import Line2D
from matplotlib.text import Text

from flora_common.runs import Light
from flora_lab import judging
from flora_lab.evolve.evolution_folder import EpisodeTrack
from flora_lab.evolve.task import Task
from flora_lab.evolve_report import words
from flora_lab.evolve_report.scene import Window, draw_lamps, draw_scenario, light_lamps, side, window_of
from flora_lab.figure_style import TARGET, new_figure
from flora_lab.gif import gif, pictures_of

FRAMES: Final = 60
FRAME_MS: Final = 120
MOST_PANELS: Final = 6
COLUMNS: Final = 4
PANEL_WIDE_IN: Final = 2.4
DPI: Final = 100
STEM: Final = "#1d7a33"


def episodes_film(episodes: Sequence[EpisodeTrack], task: Task) -> bytes:
    """An animated GIF of one episode or several; of more than six, the first six.

    Args:
        episodes: one or more.
        task: whose they are.
    """
    shown = list(episodes[:MOST_PANELS])
    window = window_of(task, [episode.stems_cm for episode in shown])
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    wide, tall = PANEL_WIDE_IN * columns, rows * (PANEL_WIDE_IN * min(window.shape, 2.0) + 0.45) + 0.3
    figure = new_figure(wide, tall, dpi=DPI)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    clock = figure.suptitle(" ", fontsize=10, family="monospace")
    panels = [_Panel.on(ax, episode, task, window) for ax, episode in zip(axes, shown, strict=False)]
    longest_s = max(float(episode.time_s[-1] - episode.time_s[0]) for episode in shown)
    moments = np.linspace(0.0, longest_s, min(FRAMES, max(len(episode.time_s) for episode in shown)))
    for panel in panels:
        panel.ax.spines[["top", "right"]].set_visible(False)

    def show(second: float) -> None:
        clock.set_text(f"{second / 3600.0:5.1f} h")
        for panel in panels:
            panel.show(second)

    moving = [clock, *(artist for panel in panels for artist in panel.moving)]
    return gif(pictures_of(figure, moving, moments.tolist(), show), frame_ms=FRAME_MS)


@dataclass(frozen=True, slots=True)
class _Panel:
    """What moves in one scenario."""

    ax: Axes
    episode: EpisodeTrack
    stem: Line2D
    path: Line2D
    tip: Line2D
    lamps: dict[Light, PathCollection]
    told: Text

    @classmethod
    def on(cls, ax: Axes, episode: EpisodeTrack, task: Task, window: Window) -> _Panel:
        draw_scenario(ax, episode.scenario, window)
        ax.set_title(words.panel_title(episode.scenario), fontsize=9)
        ax.title.set_parse_math(False)
        (path,) = ax.plot([], [], color=TARGET, linewidth=0.8)
        (stem,) = ax.plot([], [], color=STEM, linewidth=2.6, solid_capstyle="round")
        (tip,) = ax.plot([], [], "o", color=STEM, markersize=4)
        told = ax.set_xlabel(f"{words.ended(episode.reason, task)}: {judging.percent(episode.fitness)}", fontsize=8)
        return cls(ax, episode, stem, path, tip, draw_lamps(ax), told)

    @property
    def moving(self) -> tuple[Artist, ...]:
        """What is drawn anew in each picture."""
        return (self.path, self.stem, self.tip, *self.lamps.values(), self.told)

    def show(self, second: float) -> None:
        """As it is so long after the start."""
        times = self.episode.time_s - self.episode.time_s[0]
        row = int(np.searchsorted(times, second + 1e-6, side="right")) - 1
        is_over = row == len(times) - 1
        stems = self.episode.stems_cm
        self.stem.set_data(*stems[row].T)
        self.path.set_data(*stems[: row + 1, -1].T)
        self.tip.set_data(stems[row, -1:, 0], stems[row, -1:, 1])
        self.told.set_visible(is_over)
        light_lamps(self.lamps, None if is_over else side(bool(self.episode.is_right[row])))
