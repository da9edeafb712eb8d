"""The figures of a run report, as SVG text: shapes in the plane, tip and lamps over time, fitness over time."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib as mpl

mpl.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from flora_common.runs import Light
from flora_lab.figure_style import GREY, LAMP_COLOURS, OBSTACLE, TARGET
from flora_lab.report.summary import RunSummary


def shapes(summary: RunSummary, *, count: int = 25) -> str:
    """Stems through time in the plane, with obstacle and target."""
    figure, axes = plt.subplots(figsize=(4.6, 5.2))
    rows = np.unique(np.linspace(0, summary.stop_row, count).round().astype(int))
    norm = Normalize(0.0, float(summary.track.time_s[summary.stop_row] / 3600) or 1.0)
    colours = mpl.colormaps["viridis"]
    for row in rows:
        points, hour = summary.track.points_cm[row], summary.track.time_s[row] / 3600
        axes.plot(points[:, 0], points[:, 1], color=colours(norm(hour)), linewidth=1.4)
    tips = summary.track.points_cm[: summary.stop_row + 1, -1]
    axes.plot(tips[:, 0], tips[:, 1], color="black", linewidth=0.5, alpha=0.7)
    _task(axes, summary)
    axes.plot(0, 0, "k^", markersize=6)
    axes.set(xlabel="x (cm)", ylabel="y (cm)", aspect="equal")
    figure.colorbar(mpl.cm.ScalarMappable(norm, colours), ax=axes, label="hours", shrink=0.7)
    return _svg(figure)


def tip_and_lamps(summary: RunSummary) -> str:
    """Tip position over time; the band shows which lamp shone."""
    figure, axes = plt.subplots(figsize=(8.4, 3.2))
    hours = summary.track.time_s / 3600
    axes.plot(hours, summary.track.points_cm[:, -1, 1], color="#2a7f3f", label="tip height y")
    axes.plot(hours, summary.track.points_cm[:, -1, 0], color="black", label="tip x (right is positive)")
    if summary.run.target is not None:
        axes.axhline(summary.run.target.x_cm, color=TARGET, linestyle=":", linewidth=1, label="target x")
    _lamp_band(axes, [f.time_s / 3600 for f in summary.frames], [f.light or "dark" for f in summary.frames])
    axes.margins(y=0.12)  # the band is not to lie on a curve
    axes.set(xlabel="hours", ylabel="cm", xlim=(0, max(hours[-1], 0.1)))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False, fontsize=8)
    return _svg(figure)


def fitness_curve(summary: RunSummary) -> str:
    """The paper's fitness of the tip over time; empty text where there is no target."""
    if summary.fitness_over_time is None:
        return ""
    figure, axes = plt.subplots(figsize=(8.4, 2.6))
    hours = summary.track.time_s / 3600
    axes.plot(hours, 100 * summary.fitness_over_time, color="black")
    stop_h = hours[summary.stop_row]
    axes.axvline(stop_h, color=GREY, linestyle="--", linewidth=1)
    side = "right" if stop_h > 0.5 * hours[-1] else "left"
    axes.text(stop_h, 5, f" {summary.stop_reason} ", color=GREY, fontsize=8, ha=side)
    axes.set(xlabel="hours", ylabel="fitness (%)", ylim=(min(0.0, 100 * summary.fitness_over_time.min()), 105))
    axes.set_xlim(0, max(hours[-1], 0.1))
    return _svg(figure)


def _task(axes: Axes, summary: RunSummary) -> None:
    target, obstacle = summary.run.target_or_none(), summary.run.obstacle_or_none()
    if obstacle is not None:
        corner = (obstacle.left_cm, obstacle.bottom_cm)
        axes.add_patch(Rectangle(corner, obstacle.width_cm, obstacle.height_cm, facecolor=OBSTACLE, alpha=0.6))
    if target is not None:
        axes.add_patch(Circle((target.x_cm, target.y_cm), target.radius_cm, facecolor=TARGET, alpha=0.4))
        axes.plot(target.x_cm, target.y_cm, "+", color=TARGET)


def _lamp_band(axes: Axes, hours: Sequence[float], lights: Sequence[Light]) -> None:
    """A strip under the curves; neighbouring frames of one lamp are one rectangle."""
    starts = [i for i in range(len(lights)) if i == 0 or lights[i] != lights[i - 1]]
    for start, end in zip(starts, [*starts[1:], len(lights) - 1], strict=True):
        axes.axvspan(hours[start], hours[end], ymin=0.0, ymax=0.045, color=LAMP_COLOURS[lights[start]], linewidth=0)
    sides: tuple[Light, Light] = ("left", "right")
    for k, light in enumerate(sides):
        where = 0.80 + 0.10 * k
        axes.text(where, 1.02, f"{light} lamp", color=LAMP_COLOURS[light], fontsize=8, transform=axes.transAxes)


def _svg(figure: Figure) -> str:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    text = io.StringIO()
    # No date and a fixed salt: the same run gives the same bytes.
    with mpl.rc_context({"svg.hashsalt": "flora"}):
        figure.savefig(text, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
