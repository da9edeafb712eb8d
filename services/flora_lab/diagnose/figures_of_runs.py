"""Pictures of runs: the way of the tip, and whole stems."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes

from flora_common.arrays import Array
from flora_lab.diagnose.figure_parts import CHANCE, MEASURED, WIDE_IN, lamps, legend, side_of_lamp
from flora_lab.diagnose.residuals import ResidualTables
from flora_lab.figure_style import BLUE, ORANGE, drawable, new_figure, png

MOST_RUNS: Final = 6
STEM_HOURS: Final = (12.0, 24.0, 36.0, 48.0, 60.0, 72.0)
_NEARLY_H: Final = 1.5
"""A run that ends so much before a time is shown as it was at its end."""
_TALLEST_IN: Final = 2.5


def paths(base: ResidualTables, extended: ResidualTables | None) -> bytes:
    """The tip over time, sideways and upwards, a row of two panels for each run; the lamps behind it."""
    runs = base.runs[:MOST_RUNS]
    figure = new_figure(WIDE_IN, 0.75 + 1.85 * len(runs))
    grid = figure.subplots(len(runs), 2, squeeze=False, width_ratios=(2.1, 1.0), sharex=True)
    for row, run in enumerate(runs):
        other = extended.runs[row] if extended is not None else None
        for axis, ax in enumerate(grid[row]):
            lamps(ax, run)
            low, high = run.chance_cm[..., axis]
            ax.fill_between(run.time_h, low, high, color=CHANCE, linewidth=0, alpha=0.75, zorder=1)
            ax.plot(run.time_h, run.measured_cm[:, -1, axis], color=MEASURED, linewidth=1.3, zorder=4)
            ax.plot(run.time_h, run.simulated_cm(base.plant)[:, -1, axis], color=BLUE, linewidth=1.5, zorder=2)
            if other is not None:
                own = other.simulated_cm(base.plant)[:, -1, axis]
                ax.plot(run.time_h, own, color=ORANGE, linewidth=1.5, zorder=3)
            ax.set_xlim(0.0, run.time_h[-1])
            ax.set_xticks(np.arange(0.0, run.time_h[-1] + 1e-6, 12.0 if run.time_h[-1] > 30.0 else 6.0))
            ax.tick_params(labelsize=8)
        seen = run.measured_cm[:, -1, 0]
        _limits(grid[row, 0], np.concatenate([seen, run.simulated_cm(base.plant)[:, -1, 0], *run.chance_cm[..., 0]]))
        title = grid[row, 0].set_title(drawable(run.name), fontsize=9, loc="left", fontweight="bold")
        title.set_parse_math(False)
        grid[row, 0].set_ylabel("tip to the right (+)\nor left (−), cm", fontsize=8)
        grid[row, 1].set_ylabel("height of the tip, cm", fontsize=8)
    for ax in grid[-1]:
        ax.set_xlabel("hours since the start", fontsize=8)
    legend(figure, extended is not None, lamps=True, chance=True)
    return png(figure)


def stems(base: ResidualTables, extended: ResidualTables | None) -> bytes:
    """Whole stems at some times, a row for each run."""
    runs = base.runs[:MOST_RUNS]
    hours = [hour for hour in STEM_HOURS if hour <= max(float(run.time_h[-1]) for run in runs) + _NEARLY_H]
    hours = hours or [float(runs[0].time_h[-1])]
    every = [run.measured_cm for run in runs] + [run.simulated_cm(base.plant) for run in runs]
    across = np.concatenate([stem[..., 0].ravel() for stem in every])
    half = max(3.0, float(np.nanpercentile(np.abs(across), 99.8)) + 0.8)
    top = max(5.0, float(np.nanmax(np.concatenate([stem[..., 1].ravel() for stem in every]))) + 1.0)
    wide = WIDE_IN / len(hours)
    figure = new_figure(WIDE_IN, 0.6 + len(runs) * min(_TALLEST_IN, 0.25 + (wide - 0.3) * top / (2.0 * half)))
    grid = figure.subplots(len(runs), len(hours), squeeze=False, sharex=True, sharey=True)
    for row, run in enumerate(runs):
        for ax, hour in zip(grid[row], hours, strict=True):
            at = min(int(np.searchsorted(run.time_h, hour - 1e-6)), len(run.time_h) - 1)
            side_of_lamp(ax, run, at)
            lines = [(run.simulated_cm(base.plant), BLUE, 2)]
            if extended is not None:
                lines.append((extended.runs[row].simulated_cm(base.plant), ORANGE, 3))
            for stem, colour, order in [*lines, (run.measured_cm, MEASURED, 4)]:
                ax.plot(*stem[at].T, color=colour, linewidth=2.0, solid_capstyle="round", zorder=order)
                ax.plot(*stem[at, -1], "o", color=colour, markersize=3.5, zorder=order)
            if not np.isfinite(run.measured_cm[at]).any():
                ax.text(0.5, 0.97, "not measured", fontsize=7, ha="center", va="top", transform=ax.transAxes)
            ax.set(xlim=(-half, half), ylim=(0.0, top))
            ax.set_aspect("equal", adjustable="box")
            ax.tick_params(labelsize=7)
            if row == 0:
                ax.set_title(f"{hour:g} h", fontsize=9)
        label = grid[row, 0].set_ylabel(drawable(run.name, 20), fontsize=8, fontweight="bold")
        label.set_parse_math(False)
    legend(figure, extended is not None, lamps=True)
    return png(figure)


def _limits(ax: Axes, values: Array) -> None:
    """Wide enough for all but what goes far astray."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, (0.2, 99.8))
    room = 0.08 * max(high - low, 1.0)
    ax.set_ylim(low - room, high + room)
