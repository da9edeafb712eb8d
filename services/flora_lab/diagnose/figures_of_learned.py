"""The figure of a simulator by the paper's recipe, before and after it was mended."""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_lab.diagnose.figure_parts import MEASURED, WIDE_IN
from flora_lab.diagnose.mended_simulator import BASE, CLOCK, MEMORY, Mended
from flora_lab.figure_style import BLUE, COLOURS, GRID, ORANGE, drawable, new_figure, png

NAMES: Final = {BASE: "as learned", CLOCK: "its clock set right", MEMORY: "and a memory beside it"}
_COLOURS: Final = {BASE: BLUE, CLOCK: COLOURS[4], MEMORY: ORANGE}
_BEYOND: Final = 1.3
"""Simulated plants that run away are shown as far as so many times the measured height or lean."""


def heights(mended: Mended) -> bytes:
    """Height and side of the tip over time, measured and running free from the first stem, a column per run."""
    count = len(mended.runs)
    figure = new_figure(min(WIDE_IN, 3.4 * count + 0.6), 4.6)
    grid = figure.subplots(2, count, sharex=True, squeeze=False)
    rows = ((1, "tip height, cm", 0.0), (0, "tip to the right, cm", -1.0))
    for row, (axis, label, least) in enumerate(rows):
        most = _BEYOND * max(float(np.nanmax(np.abs(run.points_cm[:, -1, axis]))) for run in mended.runs)
        for column, run in enumerate(mended.runs):
            ax = grid[row, column]
            hours = np.arange(len(run)) * run.step_s / 3600.0
            ax.plot(hours, run.points_cm[:, -1, axis], color=MEASURED, linewidth=1.6, label="measured")
            for name, colour in _COLOURS.items():
                if name in mended.stems_cm:
                    tips = mended.stems_cm[name][column][:, -1, axis]
                    ax.plot(hours, tips, color=colour, linewidth=1.3, label=NAMES[name])
            ax.set_ylim(least * most, most)
            ax.grid(color=GRID, linewidth=0.6)
            if column == 0:
                ax.set_ylabel(label)
            if row == 0:
                ax.set_title(drawable(run.name, 24), fontsize=9, parse_math=False)
            else:
                ax.set_xlabel("hours")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, frameon=False)
    return png(figure)
