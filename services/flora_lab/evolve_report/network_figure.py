"""A controller's network as PNG bytes."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D

from flora_common.controller_file import LoadedController
from flora_common.counted import counted
from flora_lab.evolve_report.network_layout import Group, Layout, layout_of
from flora_lab.figure_style import BLUE, GREY, ORANGE, new_figure, png

WIDEST_PT: Final = 4.0
"""Line of the greatest weight."""
UNREAD: Final = "#b0b0b0"
"""Inputs that no link comes from."""
FAINTEST: Final = 0.15
"""How much of its colour the line of the smallest weight has."""
CURVE_PLACES: Final = 40


def network_figure(loaded: LoadedController) -> bytes:
    """Inputs, hidden nodes by depth, and the output; enabled links, by sign and size of their weights."""
    layout = layout_of(loaded)
    rows = sum(len(group.inputs) + 1 for group in layout.groups)
    figure = new_figure(9.0, max(3.0, 1.0 + 0.2 * rows))
    ax = figure.subplots()
    _draw_links(ax, layout)
    _draw_nodes(ax, layout, loaded)
    for group in layout.groups:
        _name_inputs(ax, group, layout)
    ax.set(xlim=(-0.24, 1.13), ylim=(-0.03, 1.05))
    ax.set_axis_off()
    figure.legend(
        [Line2D([], [], color=BLUE, linewidth=2.5), Line2D([], [], color=ORANGE, linewidth=2.5)],
        ["positive weight", "negative weight"],
        loc="outside lower center",
        ncols=2,
        frameon=False,
        fontsize=9,
    )
    figure.suptitle(_title(layout), fontsize=10)
    return png(figure)


def _title(layout: Layout) -> str:
    weights = [abs(weight) for _, _, weight in layout.links]
    text = f"{counted(len(layout.hidden), 'hidden node')}, {counted(len(weights), 'link')}"
    if weights:
        text += f", weights up to {max(weights):.1f}"
    return text + (
        f"; {counted(layout.left_out, 'hidden node')} with smaller weights left out" if layout.left_out else ""
    )


def _draw_links(ax: Axes, layout: Layout) -> None:
    """The strongest last, so that they are on top."""
    ordered = sorted(layout.links, key=lambda link: abs(link[2]))
    largest = max((abs(weight) for _, _, weight in ordered), default=0.0) or 1.0
    curves, colours, widths = [], [], []
    for source, to, weight in ordered:
        share = abs(weight) / largest
        curves.append(_curve(layout.at[source], layout.at[to]))
        colours.append((*to_rgb(BLUE if weight > 0.0 else ORANGE), FAINTEST + (1.0 - FAINTEST) * share))
        widths.append(0.4 + (WIDEST_PT - 0.4) * share)
    ax.add_collection(LineCollection(curves, colors=colours, linewidths=widths, capstyle="round", zorder=1))


def _curve(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """A line that leaves and arrives level, shape (places, 2)."""
    share = np.linspace(0.0, 1.0, CURVE_PLACES)
    bend = share**2 * (3.0 - 2.0 * share)
    return np.stack([start[0] + (end[0] - start[0]) * share, start[1] + (end[1] - start[1]) * bend], axis=1)


def _draw_nodes(ax: Axes, layout: Layout, loaded: LoadedController) -> None:
    for key in loaded.network.inputs:
        colour = "black" if key in layout.read else UNREAD
        ax.scatter(*layout.at[key], s=18, color=colour, zorder=2)
    size = 190 if len(layout.hidden) <= 20 else 90
    for node in loaded.network.nodes:
        if node.key not in layout.at:
            continue
        is_output = node.key in loaded.network.outputs
        x, y = layout.at[node.key]
        ax.scatter([x], [y], s=260 if is_output else size, facecolors="white", edgecolors="black", zorder=3)
        if not is_output:
            text = str(node.key)
            ax.text(x, y, text, fontsize=6.5 if size > 100 and len(text) < 4 else 5, ha="center", va="center", zorder=4)
    for key in loaded.network.outputs:
        x, y = layout.at[key]
        ax.text(x, y, "C", fontsize=9, ha="center", va="center", zorder=4)
        ax.text(x + 0.03, y, "\u2264 0.5: left\n> 0.5: right", fontsize=8, va="center")


def _name_inputs(ax: Axes, group: Group, layout: Layout) -> None:
    heights = [layout.at[key][1] for _, key in group.inputs]
    for (name, key), y in zip(group.inputs, heights, strict=True):
        colour = "black" if key in layout.read else UNREAD
        ax.text(-0.015, y, _short(name), fontsize=8, ha="right", va="center", color=colour)
    x = -0.125
    ax.plot([x, x], [min(heights) - 0.008, max(heights) + 0.008], color=GREY, linewidth=1.2)
    middle = (min(heights) + max(heights)) / 2.0
    ax.text(x - 0.012, middle, group.name, fontsize=9, ha="right", va="center", color=GREY)


def _short(name: str) -> str:
    """The name of an input beside that of its group."""
    short = name.removeprefix("target_").removeprefix("obstacle_")
    return {"x1": "anchor x1", "y1": "anchor y1", "x10": "tip x10", "y10": "tip y10"}.get(short, short)
