"""Pictures of a diagnosis, as PNG bytes: measured plants black, the simulator blue, the extended one orange."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from flora_common.arrays import Array
from flora_lab.diagnose import residual_statistics as statistics
from flora_lab.diagnose.diagnosis import SIMULATOR_NAMES
from flora_lab.diagnose.figure_parts import CHANCE, LAMP_TINTS, MEASURED, WIDE_IN, legend
from flora_lab.diagnose.replayed import MM
from flora_lab.diagnose.residuals import FINE_BINS, FINE_H, SWING_PERIODS_H, ResidualTables
from flora_lab.diagnose.rhythm import Swing
from flora_lab.figure_style import BLUE, GREY, GRID, ORANGE, drawable, new_figure, png

_LOWEST_NATS: Final = -6.0
"""Bars of causes that are worse than this end here."""
_LEAST_SWING_MM: Final = 0.1
_CHANCE_SD: Final = 2.0
_HEIGHT_BIN_CM: Final = 1.0
GAIN_NAMES: Final = {
    **SIMULATOR_NAMES,
    "boosted": "black box on top (boosting)",
    "still": "“nothing moves”",
}
GAIN_COLOURS: Final = {"base": BLUE, "extended": ORANGE, "boosted": "#8f959b", "still": "#d3d7db"}


def by_phase(base: ResidualTables, extended: ResidualTables | None) -> bytes:
    """The tip's residual by the time since a switch, for either lamp, and that of growth by the time of day."""
    figure = new_figure(WIDE_IN, 3.5)
    left, right, clock = figure.subplots(1, 3)
    left.sharey(right)
    at = (np.arange(FINE_BINS) + 0.5) * FINE_H
    for s, (ax, side) in enumerate(zip((left, right), statistics.SIDES, strict=True)):
        ax.set_facecolor(LAMP_TINTS[side])
        _reference_band(ax, at, base.reference.by_switch_mm[base.plant][:, s])
        _runs_and_mean(ax, at, base.shown.by_switch_mm[base.plant][:, s], BLUE)
        if extended is not None:
            _runs_and_mean(ax, at, extended.shown.by_switch_mm[base.plant][:, s], ORANGE)
        ax.set_title(f"{side} lamp on", fontsize=10)
        ax.set_xlabel("hours since it came on", fontsize=9)
        ax.set_xlim(0.0, FINE_BINS * FINE_H)
        ax.set_xticks(np.arange(0.0, FINE_BINS * FINE_H + 1e-6, 3.0))
        ax.axhline(0.0, color=MEASURED, linewidth=0.8)
        ax.tick_params(labelsize=8)
    left.set_ylabel("tip, measured minus simulated, mm:\nto the right (+) or left (−)", fontsize=9)
    at = (np.arange(statistics.CLOCKS) + 0.5) * statistics.CLOCK_H
    _reference_band(clock, at, base.reference.by_clock_mm_h[base.plant])
    _runs_and_mean(clock, at, base.shown.by_clock_mm_h[base.plant], BLUE)
    if extended is not None:
        _runs_and_mean(clock, at, extended.shown.by_clock_mm_h[base.plant], ORANGE)
    clock.axhline(0.0, color=MEASURED, linewidth=0.8)
    clock.set_title("growth by time of day", fontsize=10)
    clock.set_xlabel("hour of the day, from the start", fontsize=9)
    clock.set_ylabel("growth, measured minus\nsimulated, mm/h", fontsize=9)
    clock.set_xlim(0.0, 24.0)
    clock.set_xticks(np.arange(0.0, 25.0, 6.0))
    clock.tick_params(labelsize=8)
    legend(figure, extended is not None, measured=False, reference=True)
    return png(figure)


def along_stem(base: ResidualTables, extended: ResidualTables | None) -> bytes:
    """How far off the stem is from its foot to its tip, and how that changes with time and with its height."""
    figure = new_figure(WIDE_IN, 3.3)
    stem, time, height = figure.subplots(1, 3, width_ratios=(1.0, 1.5, 1.0))
    points = np.arange(2, 2 + base.shown.profile_mm[base.plant].shape[1])
    low, high = np.percentile(base.reference.profile_mm[base.plant], (5.0, 95.0), axis=0)
    stem.fill_betweenx(points, low, high, color=CHANCE, linewidth=0)
    for tables, colour in ((base, BLUE), (extended, ORANGE)):
        if tables is None:
            continue
        profile = tables.shown.profile_mm[base.plant]
        stem.plot(profile.T, points, color=colour, linewidth=0.7, alpha=0.4)
        stem.plot(np.sqrt(statistics.mean_over_runs(profile**2)), points, color=colour, linewidth=2.4)
        for run in tables.runs:
            error = np.hypot(*run.error_mm(base.plant)[:, -1].T)
            width = max(1, round(3.0 / run.step_h))
            time.plot(run.time_h, statistics.smoothed(error, width), color=colour, linewidth=0.7, alpha=0.4)
        time.plot(*_pooled(tables, base), color=colour, linewidth=2.4)
        at_cm, of_runs = _by_height(tables, base)
        height.plot(at_cm, of_runs.T, color=colour, linewidth=0.7, alpha=0.4)
        height.plot(at_cm, np.sqrt(statistics.mean_over_runs(of_runs**2)), color=colour, linewidth=2.4)
    stem.set_yticks(points, ["foot", *map(str, points[1:-1]), "tip"])
    stem.tick_params(labelsize=8)
    stem.set_ylim(2, points[-1])
    stem.set_xlim(left=0.0)
    stem.set_xlabel("distance from the measured stem, mm", fontsize=9)
    stem.set_title("where along the stem", fontsize=10)
    time.set_title("at the tip, over the run", fontsize=10)
    time.set_xlabel("hours since the start", fontsize=9)
    time.set_ylabel("distance, mm", fontsize=9)
    time.set_xlim(0.0, max(float(run.time_h[-1]) for run in base.runs))
    height.set_title("at the tip, by its height", fontsize=10)
    height.set_xlabel("measured height of the tip, cm", fontsize=9)
    height.set_ylim(bottom=0.0, top=max(ax.get_ylim()[1] for ax in (time, height)))
    time.set_ylim(height.get_ylim())
    for ax in (time, height):
        ax.tick_params(labelsize=8)
        ax.grid(color=GRID, linewidth=0.6)
    legend(figure, extended is not None, measured=False, reference=True)
    return png(figure)


def spectra(base: ResidualTables, swing: Swing | None) -> bytes:
    """How strongly the tip swings at each period, beside what is left over in reference runs."""
    figure = new_figure(WIDE_IN, 3.2)
    ax = figure.subplots()
    marks: list[Any] = [Line2D([], [], color=BLUE, linewidth=1.5)]
    names = ["measured runs"]
    usual = base.reference.swing_mm[np.isfinite(base.reference.swing_mm).all(axis=1)]
    if len(usual):
        ax.fill_between(SWING_PERIODS_H, usual.min(axis=0), usual.max(axis=0), color=CHANCE, linewidth=0)
        ax.plot(SWING_PERIODS_H, np.median(usual, axis=0), color=GREY, linewidth=1.0)
        marks += [Line2D([], [], color=GREY, linewidth=1.0), Patch(color=CHANCE)]
        names += ["reference runs, median", "all of them"]
    ax.plot(SWING_PERIODS_H, base.shown.swing_mm.T, color=BLUE, linewidth=1.5)
    if swing is not None:
        ax.axvspan(*swing.period_interval_h, color=ORANGE, alpha=0.25, linewidth=0)
        ax.axvline(swing.period_h, color=ORANGE, linewidth=1.4)
        text = f"found: {swing.period_h:.2f} h,\n{MM * swing.amplitude_cm:.0f} mm to either side"
        ax.annotate(
            text,
            (swing.period_h, 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(6, 0),
            textcoords="offset points",
            va="top",
            fontsize=9,
            color=ORANGE,
        )
    ax.set_yscale("log")
    ax.set_ylim(top=4.0 * float(np.nanmax([*base.shown.swing_mm.ravel(), _LEAST_SWING_MM])))
    ax.set_xscale("log")
    ax.set_xlim(SWING_PERIODS_H[0], SWING_PERIODS_H[-1])
    ax.set_xticks([0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0], ["0.75", "1", "1.5", "2", "2.5", "3", "4"])
    ax.set_xticks([], minor=True)
    ax.yaxis.set_major_formatter(lambda value, _place: f"{value:g}")
    ax.yaxis.set_minor_formatter(lambda _value, _place: "")
    ax.set_xlabel("period, hours", fontsize=9)
    ax.set_ylabel("swing of the tip that the\nsimulator lacks, mm", fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color=GRID, linewidth=0.6)
    figure.legend(marks, names, loc="outside upper center", ncols=len(marks), fontsize=8, frameon=False)
    return png(figure)


def evidence(tried: Sequence[tuple[str, float]], chosen: Sequence[str], needed: float) -> bytes:
    """How much better each cause alone explains the runs than none does.

    Args:
        tried: titles of causes and their nats.
        chosen: titles of those that were named.
        needed: nats that a cause needs.
    """
    order = sorted(tried, key=lambda pair: pair[1])
    figure = new_figure(WIDE_IN, 0.9 + 0.23 * len(order))
    ax = figure.subplots()
    nats = np.array([max(value, _LOWEST_NATS) for _, value in order])
    colours = [ORANGE if title in chosen else BLUE if value >= needed else "#b9bfc6" for title, value in order]
    ax.barh(np.arange(len(order)), nats, color=colours, height=0.72)
    ax.set_yticks(np.arange(len(order)), [drawable(title) for title, _ in order], fontsize=9)
    ax.set_xscale("symlog", linthresh=10.0, linscale=1.0)
    most = max(30.0, float(nats.max()) * 1.9)
    ax.set_xlim(_LOWEST_NATS * 1.2, most)
    ticks = [-5, 0, 5, 10, 30, 100, 300, 1000, 3000, 10000, 30000, 100000]
    ax.set_xticks([t for t in ticks if t < most], [str(t).replace("-", "−") for t in ticks if t < most], fontsize=8)
    ax.set_xticks([], minor=True)
    ax.axvline(0.0, color=MEASURED, linewidth=0.8)
    ax.axvline(needed, color=GREY, linewidth=1.0, linestyle="--")
    ax.annotate(
        "enough to\nbe named",
        (needed, 0.02),
        xycoords=("data", "axes fraction"),
        xytext=(4, 0),
        textcoords="offset points",
        fontsize=8,
        color=GREY,
    )
    for place, value in enumerate(nats):
        shown = f"{order[place][1]:.0f}"
        if value > 0.5:
            ax.annotate(shown, (value, place), xytext=(3, 0), textcoords="offset points", va="center", fontsize=8)
    ax.set_xlabel("evidence against “the simulator is right as it is”, nats", fontsize=9)
    ax.margins(y=0.01)
    return png(figure)


def gain(free_running: dict[str, dict[str, float]], one_step: dict[str, float]) -> bytes:
    """Errors on runs that no fit has seen, by simulator, one step ahead and after longer and longer."""
    groups = [("one step\n(5 min)", one_step)] if one_step else []
    groups += [(_after(time), errors) for time, errors in free_running.items()]
    shown = [key for key in GAIN_NAMES if any(key in errors for _, errors in groups)]
    figure = new_figure(WIDE_IN, 3.2)
    ax = figure.subplots()
    width = 0.8 / max(len(shown), 1)
    useful = [errors.get(key, np.nan) for _, errors in groups for key in shown if key != "still"]
    top = 1.15 * float(np.nanmax([*useful, 1e-3]))
    for k, key in enumerate(shown):
        at = np.arange(len(groups)) + (k - 0.5 * (len(shown) - 1)) * width
        values = np.array([errors.get(key, np.nan) for _, errors in groups])
        ax.bar(at, values, width * 0.92, color=GAIN_COLOURS[key], label=GAIN_NAMES[key])
        for x, value in zip(at, values, strict=True):
            if np.isfinite(value):
                text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
                beyond = value > top
                place: dict[str, Any] = {
                    "xytext": (0, -11 if beyond else 2),
                    "textcoords": "offset points",
                    "ha": "center",
                }
                ax.annotate(f"{text} ↑" if beyond else text, (x, min(value, top)), fontsize=8, **place)
    ax.set_xticks(np.arange(len(groups)), [name for name, _ in groups], fontsize=9)
    ax.set_ylim(0.0, top)
    ax.set_ylabel("error of the tip, mm", fontsize=9)
    ax.tick_params(axis="y", labelsize=8)
    figure.legend(fontsize=8, frameon=False, ncols=len(shown), loc="outside upper center")
    return png(figure)


def _after(time: str) -> str:
    return "at the end" if time == "end" else f"after {time.removesuffix('h')} h"


def _pooled(tables: ResidualTables, base: ResidualTables) -> tuple[Array, Array]:
    """Root mean square over runs of the tip's distance, over three hours, and when."""
    shortest = min(len(run.time_h) for run in tables.runs)
    squares = np.stack([(run.error_mm(base.plant)[:shortest, -1] ** 2).sum(axis=1) for run in tables.runs])
    total = statistics.mean_over_runs(squares)
    run = tables.runs[0]
    return run.time_h[:shortest], np.sqrt(statistics.smoothed(total, max(1, round(3.0 / run.step_h))))


def _by_height(tables: ResidualTables, base: ResidualTables) -> tuple[Array, Array]:
    """Middles of bins of the measured tip's height, cm, and the root mean square of its distance, mm, by run.

    Shapes (bins,) and (runs, bins); NaN where a run has less than an hour of photographs in a bin.
    """
    highest_cm = max(float(np.nanmax(run.measured_cm[:, -1, 1])) for run in base.runs)
    ends_cm = np.arange(0.0, highest_cm + 2.0 * _HEIGHT_BIN_CM, _HEIGHT_BIN_CM)
    of_runs = np.full((len(tables.runs), len(ends_cm) - 1), np.nan)
    for own, run in zip(of_runs, tables.runs, strict=True):
        off_mm = np.hypot(*run.error_mm(base.plant)[:, -1].T)
        place = np.digitize(run.measured_cm[:, -1, 1], ends_cm) - 1
        for k in range(len(own)):
            here = off_mm[(place == k) & np.isfinite(off_mm)]
            own[k] = statistics.rms(here) if len(here) * run.step_h >= 1.0 else np.nan
    return 0.5 * (ends_cm[1:] + ends_cm[:-1]), of_runs


def _reference_band(ax: Axes, at: Array, values: Array) -> None:
    """Two standard deviations of reference runs about none, where at least three of them tell."""
    known = np.isfinite(values).sum(axis=0) >= 3
    if known.any():
        spread = _CHANCE_SD * np.sqrt(statistics.mean_over_runs(values[:, known] ** 2))
        ax.fill_between(at[known], -spread, spread, color=CHANCE, linewidth=0)


def _runs_and_mean(ax: Axes, at: Array, values: Array, colour: str) -> None:
    """A thin line for each run, a thick one for their mean where most of them tell."""
    ax.plot(at, values.T, color=colour, linewidth=0.7, alpha=0.45)
    known = np.isfinite(values)
    mean = statistics.mean_over_runs(values)
    ax.plot(at, np.where(known.mean(axis=0) > 0.5, mean, np.nan), color=colour, linewidth=2.6)
