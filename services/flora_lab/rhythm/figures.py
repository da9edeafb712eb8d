"""The picture of a search: a row for each track, the tip beside its band and the spectrum beside what noise has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator

from flora_lab.figure_style import BLUE, GREY, GRID, ORANGE, drawable, new_figure, png
from flora_lab.rhythm.judgement import Rhythm
from flora_lab.rhythm.lattice import detrended, lattice

MOST_ROWS: Final = 12


def rhythms(judged: Sequence[Rhythm]) -> bytes:
    """PNG of up to :data:`MOST_ROWS` tracks, the first ones."""
    shown = judged[:MOST_ROWS]
    figure = new_figure(11.0, 0.6 + 3.1 * len(shown))
    axes = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(2.0, 1.0))
    for (left, right), rhythm in zip(axes, shown, strict=True):
        _track(left, rhythm)
        _spectrum(right, rhythm)
    if len(judged) > len(shown):
        figure.supxlabel(f"the first {len(shown)} of {len(judged)} tracks", fontsize=9, color=GREY)
    return png(figure)


def _track(ax: Axes, rhythm: Rhythm) -> None:
    track = rhythm.track
    at = track.start + track.step * np.arange(len(track.x))
    values = detrended(rhythm.values)
    band = rhythm.cycles
    ax.plot(
        at, np.where(track.known, values, np.nan), color=GREY, linewidth=0.9, label="tip, without its straight line"
    )
    ax.plot(at, band.band, color=BLUE if rhythm.swings else GREY, linewidth=1.6, alpha=0.9, label="in the swing's band")
    if rhythm.swings:
        peaks = track.start + track.step * band.peaks
        ax.plot(peaks, np.interp(peaks, at, band.band), "v", color=ORANGE, markersize=6, label="clear peaks")
    ax.set_title(drawable(track.name), fontsize=10, loc="left", parse_math=False)
    ax.set_xlabel("hours" if track.time_unit == "h" else "frames")
    ax.set_ylabel(f"{rhythm.along}, {track.unit}")
    ax.grid(color=GRID, linewidth=0.6)
    ax.legend(fontsize=8, frameon=False, loc="best")


def _spectrum(ax: Axes, rhythm: Rhythm) -> None:
    track, found = rhythm.track, rhythm.found
    at = track.step / lattice(len(track.x)).at
    ax.plot(at, found.power, color="black", linewidth=0.9, marker="o", markersize=2.5, label="measured")
    ax.plot(at, found.noise_alone, color=GREY, linestyle="--", linewidth=1.4, label="noise alone")
    label = "noise and swing" if rhythm.swings else "best swing, not claimed"
    ax.plot(at, found.both, color=ORANGE if rhythm.swings else GREY, linewidth=1.6, alpha=0.9, label=label)
    ax.set_xscale("log")
    ax.set_yscale("log")
    low, high = rhythm.searched
    ax.axvspan(low, high, color=BLUE, alpha=0.06, linewidth=0)
    ax.set_xlim(at[0], at[-1])
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    ax.xaxis.set_major_formatter(lambda value, _place: f"{value:g}")
    ax.xaxis.set_minor_locator(NullLocator())
    floor = float(np.percentile(found.power, 2))
    ax.set_ylim(bottom=0.3 * max(floor, 1e-9 * float(found.power.max())))
    ax.set_xlabel(f"period, {track.time_unit} (searched: shaded)")
    ax.set_ylabel(f"power, {track.unit}²")
    ax.set_title(f"p = {found.p:.3g}", fontsize=10)
    ax.legend(fontsize=8, frameon=False, loc="best")
