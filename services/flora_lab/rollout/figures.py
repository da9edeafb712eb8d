"""Pictures of simulators beside the measured plant, as PNG bytes: errors over time, tip paths, and stems."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from flora_common.arrays import FloatArray
from flora_common.counted import counted
from flora_lab.figure_style import BLUE, COLOURS, GREY, GRID, ORANGE, new_figure, png
from flora_lab.rollout.free_running import NO_START, FreeRun, Judged
from flora_lab.rollout.intervals import FEWEST_PLANTS, LEVEL, by_plant, median
from flora_lab.rollout.predictors import GoesOn, NothingMoves
from flora_lab.rollout.report import hours_text, like_another
from flora_lab.rollout.summary import Entry, Place, Start, Summary, errors_at
from flora_lab.simulator.measured import MeasuredRun

Style = Literal["-", "--", "-.", ":"]

PREDICTOR_STYLES: Final = {NothingMoves.kind: ":", GoesOn.kind: "-."}
STYLES: Final = ("-", "--", (0, (5, 1, 1, 1)), (0, (1, 1)))
LEAST_MM: Final = (0.02, 1.0)
"""Between these is the bottom of the error axis."""
EDGE: Final = 0.2
"""Around the measured plant, as a share of its height."""
PLACES: Final = 36
"""Times at which the errors are drawn, evenly on the axis, which is logarithmic."""
STEM_HOURS: Final = (0.0, 24.0, 48.0, 72.0)


def errors_over_time(entries: Sequence[Entry], summary: Summary) -> bytes:
    """Median tip error over plants against the time since the start, a panel for each kind of start."""
    free: tuple[tuple[Start, str], ...] = (
        ("unseen", "from the first stem"),
        ("watched", f"after watching {summary.plan.watch_h:g} h"),
        ("often", f"after watching {summary.plan.watch_h:g} h\nand again every {summary.plan.every_h:g} h"),
    )
    panels = [(start, title) for start, title in free if start == "unseen" or entries[0].judged.watched is not None]
    figure = new_figure(1.0 + 4.2 * len(panels), 4.4)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    lowest = [LEAST_MM[1]]
    for ax, (start, title) in zip(axes, panels, strict=True):
        for index, entry in enumerate(entries):
            if entry.name not in like_another(start):
                lowest.append(_error_curve(ax, entry, start, summary, index))
        ax.set_title(title, fontsize=11)
        ax.set_xlabel("time since the start")
        ax.grid(color=GRID, linewidth=0.6)
    ticks = sorted({1, *summary.plan.horizons, round(72.0 * 3600.0 / summary.step_s)})
    axes[0].set_xscale("log")
    axes[0].set_xticks([tick * summary.step_s / 3600.0 for tick in ticks])
    axes[0].set_xticks([], minor=True)
    axes[0].set_xticklabels([hours_text(tick, summary.step_s) for tick in ticks])
    axes[0].set_yscale("log", nonpositive="clip")
    axes[0].set_ylim(bottom=max(LEAST_MM[0], 0.6 * min(lowest)))
    axes[0].yaxis.set_major_formatter(lambda value, _place: f"{value:g}")
    axes[0].set_ylabel("tip error, mm (median over plants)")
    handles, labels = axes[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), frameon=False)
    plants = summary.plants
    band = "" if plants < FEWEST_PLANTS else f"; bands: {100 * LEVEL:.0f} % intervals over plants"
    figure.suptitle(f"{counted(len(summary.runs), 'run')} of {counted(plants, 'plant')}{band}", fontsize=10)
    return png(figure)


def _error_curve(ax: Axes, entry: Entry, start: Start, summary: Summary, index: int) -> float:
    """Draw one simulator's errors; returns the least, in mm."""
    longest = len(entry.judged.unseen.simulated_cm) - 1
    if start == "often":  # beyond, all that is left is the start of the panel before
        longest = min(longest, max(summary.plan.horizons))
    steps = np.unique(np.geomspace(1, max(longest, 1), PLACES).round().astype(int))
    found = []
    for step in steps.tolist():
        errors, run = errors_at(entry.judged, Place(start, step, "tip_mm"))
        found.append(median(by_plant(errors, [summary.runs[i].plant for i in run]), summary.seed))
    most = max(estimate.plants for estimate in found)
    # where runs have ended, the plants that are left are others
    told = [(step, e) for step, e in zip(steps.tolist(), found, strict=True) if e.plants == most and most]
    hours = [step * summary.step_s / 3600.0 for step, _ in told]
    predictor = PREDICTOR_STYLES.get(entry.name)
    colour = GREY if predictor else COLOURS[index % len(COLOURS)]
    style = predictor or STYLES[index % len(STYLES)]
    ax.plot(hours, [e.value for _, e in told], color=colour, linestyle=style, linewidth=1.8, label=entry.name)
    band = [(hour, e.low, e.high) for hour, (_, e) in zip(hours, told, strict=True) if e.low is not None]
    if band:
        ax.fill_between(*np.array(band, dtype=np.float64).T, color=colour, alpha=0.18, linewidth=0)
    return min((e.value for _, e in told), default=LEAST_MM[1])


def one_run(run: MeasuredRun, index: int, entry: Entry, summary: Summary) -> bytes:
    """Tip paths, and stems at four times, measured and simulated.

    Args:
        run, index: which of the summary's runs.
        entry: the simulator.
        summary: for what was watched.
    """
    judged = entry.judged
    hours = stem_hours(run.hours)
    simulated = _tracks(judged, index, len(run))
    figure = new_figure(13.0, 4.5)
    axes = figure.subplots(1, 1 + len(hours), sharex=True, sharey=True)
    rows = [min(len(run) - 1, round(hour * 3600.0 / run.step_s)) for hour in hours]
    _path(axes[0], run.points_cm[:, -1], rows, "black", "-")
    for track, colour, style in simulated:
        _path(axes[0], track[:, -1], rows, colour, style)
    axes[0].set(title="path of the tip", ylabel="y, cm", xlabel="x, cm")
    for ax, hour, row in zip(axes[1:], hours, rows, strict=True):
        ax.plot(*run.points_cm[row].T, color="black", linewidth=2.6)
        for track, colour, style in simulated:
            ax.plot(*track[row].T, color=colour, linestyle=style, linewidth=1.6, marker="o", markersize=2.5)
        ax.set(title=f"{hour:g} h", xlabel="x, cm")
    low, high = _window(run)
    axes[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    outside = any(np.nanmax(np.maximum(low - track, track - high)) > 0.0 for track, _, _ in simulated)
    for ax in axes:
        ax.set_aspect("equal", adjustable="box")
        ax.grid(color=GRID, linewidth=0.6)
    legend: list[tuple[str, str, Style]] = [("measured", "black", "-")]
    legend.append((f"{entry.name}, from the first stem", BLUE, "--"))
    if len(simulated) > 1:
        legend.append((f"{entry.name}, after watching {summary.plan.watch_h:g} h", ORANGE, "-"))
    handles = [Line2D([], [], color=colour, linestyle=style, linewidth=1.8) for _, colour, style in legend]
    names = [name for name, _, _ in legend]
    # Twice the usual padding keeps it off the panels' labels.
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False, borderpad=0.8, borderaxespad=0.0)
    title = f"{run.name} ({run.plant}), running free; dots on the path are where the stems are"
    title += f"; {entry.name} also goes outside the picture" if outside else ""
    figure.suptitle(f"{title}\n", fontsize=10)  # the empty line keeps it off the panels' titles
    return png(figure)


def stem_hours(run_hours: float) -> tuple[float, ...]:
    """When stems are drawn: at :data:`STEM_HOURS`; of a shorter run at its beginning, thirds and end."""
    if run_hours >= STEM_HOURS[-1] - 0.5:
        return STEM_HOURS
    return tuple(round(run_hours * share, 1) for share in (0.0, 1 / 3, 2 / 3, 1.0))


def _window(run: MeasuredRun) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right corner around the measured plant, cm; a simulated one may be far outside."""
    low, high = np.nanmin(run.points_cm, axis=(0, 1)), np.nanmax(run.points_cm, axis=(0, 1))
    edge = EDGE * (high[1] - low[1])
    return low - edge, high + edge


def _tracks(judged: Judged, index: int, rows: int) -> list[tuple[FloatArray, str, Style]]:
    """Simulated stems by the run's rows, shape (rows, 10, 2), NaN before the start; with colour and style of a line."""
    found: list[tuple[FloatArray, str, Style]] = [(_by_row(judged.unseen, index, rows), BLUE, "--")]
    if judged.watched is not None and judged.watched.start_rows[index] != NO_START:
        found.append((_by_row(judged.watched, index, rows), ORANGE, "-"))
    return found


def _by_row(run: FreeRun, index: int, rows: int) -> FloatArray:
    start = int(run.start_rows[index])
    track = np.full((rows, *run.simulated_cm.shape[2:]), np.nan)
    track[start:] = run.simulated_cm[: rows - start, index]
    return track


def _path(ax: Axes, tips_cm: FloatArray, rows: list[int], colour: str, style: Style) -> None:
    ax.plot(*tips_cm.T, color=colour, linestyle=style, linewidth=1.2)
    ax.plot(*tips_cm[rows].T, color=colour, linestyle="", marker="o", markersize=4)
