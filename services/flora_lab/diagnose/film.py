"""Measured and simulated stems as a film: they grow side by side under the same lamps, all runs under one clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.lines import Line2D

from flora_common.arrays import FloatArray
from flora_common.runs import Light
from flora_lab.diagnose.figure_parts import MEASURED, WIDE_IN, legend
from flora_lab.diagnose.replayed import Replayed
from flora_lab.diagnose.residuals import ResidualTables
from flora_lab.figure_style import BLUE, LAMP_COLOURS, ORANGE, drawable, new_figure
from flora_lab.gif import gif, pictures_of

FRAMES: Final = 73
"""One an hour for a run of three days."""
FRAME_MS: Final = 130
MOST_PANELS: Final = 4
WIDEST_PANEL_IN: Final = 3.2
TALLEST_IN: Final = 4.4
DPI: Final = 100
MARGIN_CM: Final = 0.8
HEAD_CM: Final = 3.0
TRAIL_H: Final = 12.0
LAMPS: Final[tuple[Light, Light]] = ("left", "right")
_LAMP_SIDES: Final = (0.1, 0.9)


def film(base: ResidualTables, extended: ResidualTables | None) -> bytes:
    """An animated GIF of the first four runs: measured black, the simulator blue, the extended one orange."""
    runs = base.runs[:MOST_PANELS]
    stems = [[run.measured_cm, run.simulated_cm(base.plant)] for run in runs]
    if extended is not None:
        for own, run in zip(stems, extended.runs, strict=False):
            own.append(run.simulated_cm(base.plant))
    every = np.concatenate([stem.reshape(-1, 2) for own in stems for stem in own])
    half = float(np.nanpercentile(np.abs(every[:, 0]), 99.9)) + MARGIN_CM
    top = float(np.nanmax(every[:, 1])) + HEAD_CM
    wide = min(WIDEST_PANEL_IN, WIDE_IN / len(runs))
    tall = min(TALLEST_IN, wide * top / (2.0 * half))
    figure = new_figure(max(5.2, wide * len(runs)), tall + 0.85, dpi=DPI)
    axes = figure.subplots(1, len(runs), squeeze=False, sharey=True)[0]
    legend(figure, extended is not None)
    clock = figure.suptitle(" ", fontsize=10, family="monospace", y=0.02, va="bottom")
    panels = []
    for ax, run, own in zip(axes, runs, stems, strict=True):
        ax.set(xlim=(-half, half), ylim=(0.0, top))
        ax.set_aspect("equal", adjustable="box")
        ax.tick_params(labelsize=7)
        ax.spines[["top", "right"]].set_visible(False)
        ax.set_title(drawable(run.name, 20), fontsize=9).set_parse_math(False)
        panels.append(_Panel.on(ax, run, own))
    figure.supxlabel(" ", fontsize=10)
    longest_h = max(float(run.time_h[-1]) for run in runs)

    def show(moment_h: float) -> None:
        clock.set_text(f"{moment_h:5.1f} h")
        for panel in panels:
            panel.show(moment_h)

    moments_h = np.linspace(0.0, longest_h, min(FRAMES, max(len(run.time_h) for run in runs)))
    moving = [clock, *(artist for panel in panels for artist in panel.moving)]
    return gif(pictures_of(figure, moving, moments_h.tolist(), show), frame_ms=FRAME_MS)


@dataclass(frozen=True, slots=True)
class _Panel:
    """What moves in one run's picture; the measured stem is the first of the stems, and drawn over the others."""

    run: Replayed
    stems: list[FloatArray]
    lines: list[Line2D]
    tips: list[Line2D]
    trails: list[Line2D]
    lamps: tuple[PathCollection, PathCollection]

    @classmethod
    def on(cls, ax: Axes, run: Replayed, stems: list[FloatArray]) -> _Panel:
        lines, tips, trails = [], [], []
        for k, colour in zip(range(len(stems)), (MEASURED, BLUE, ORANGE), strict=False):
            order = 10 - k
            lines += ax.plot([], [], color=colour, linewidth=2.4, solid_capstyle="round", zorder=order)
            tips += ax.plot([], [], "o", color=colour, markersize=4, zorder=order)
            trails += ax.plot([], [], color=colour, linewidth=0.6, alpha=0.5, zorder=order - 5)
        place: dict[str, Any] = {"transform": ax.transAxes, "s": 60, "linewidths": 1.4}
        left, right = (
            ax.scatter([x], [0.94], edgecolors=LAMP_COLOURS[side], **place)
            for x, side in zip(_LAMP_SIDES, LAMPS, strict=True)
        )
        return cls(run, stems, lines, tips, trails, (left, right))

    @property
    def moving(self) -> list[Artist]:
        """From the back to the front."""
        return sorted([*self.lamps, *self.lines, *self.tips, *self.trails], key=lambda artist: artist.get_zorder())

    def show(self, moment_h: float) -> None:
        """As it is so long after the start."""
        row = min(int(np.searchsorted(self.run.time_h, moment_h)), len(self.run.time_h) - 1)
        since = max(0, row - round(TRAIL_H / self.run.step_h))
        for stem, line, tip, trail in zip(self.stems, self.lines, self.tips, self.trails, strict=True):
            line.set_data(*stem[row].T)
            tip.set_data(stem[row, -1:, 0], stem[row, -1:, 1])
            trail.set_data(*stem[since : row + 1, -1].T)
        for lamp, circle in enumerate(self.lamps):
            shines = self.run.light[row, lamp] > 0.0
            circle.set_facecolor(LAMP_COLOURS[LAMPS[lamp]] if shines else "white")
