"""What both drawings of this folder are made with: sheets without axes, boxes with names, lines with arrows, files."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from flora_common.files import write_bytes
from flora_lab.figure_style import new_figure, png

INK: Final = "#222222"
GREY: Final = "#7a7a7a"
PAPER: Final = "#ffffff"
SMALL_PT, TEXT_PT = 8.0, 9.5

Point = tuple[float, float]


def sheet(wide_in: float, high_in: float, width: float, height: float) -> tuple[Figure, Axes]:
    """A figure with one drawing of ``width`` by ``height`` units, y up, the same scale in both directions."""
    figure = new_figure(wide_in, high_in)
    ax = figure.add_subplot()
    plain(ax, (0.0, width), (0.0, height))
    return figure, ax


def plain(ax: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Axes for a drawing to scale."""
    ax.set_xlim(*x)
    ax.set_ylim(*y)
    ax.set_aspect("equal")
    ax.axis("off")


def block(ax: Axes, low: Point, size: Point, name: str, *, fill: str = PAPER, dy: float = 0.0) -> None:
    """A box with a name in its middle, or ``dy`` above it."""
    ax.add_patch(
        FancyBboxPatch(
            low, *size, boxstyle="round,pad=0,rounding_size=0.8", facecolor=fill, edgecolor=INK, linewidth=1.2, zorder=3
        )
    )
    middle = (low[0] + size[0] / 2, low[1] + size[1] / 2 + dy)
    ax.text(*middle, name, ha="center", va="center", fontsize=TEXT_PT, color=INK, zorder=5)


def wire(ax: Axes, points: Sequence[Point], colour: str, *, width: float = 1.8, dashed: bool = False) -> None:
    """A line through points."""
    x, y = zip(*points, strict=True)
    style = (0, (4, 2)) if dashed else "solid"
    ax.plot(x, y, color=colour, linewidth=width, linestyle=style, solid_joinstyle="round", zorder=2)


def note(ax: Axes, at: Point, text: str, *, colour: str = INK, ha: str = "left", va: str = "center") -> None:
    """Small text."""
    ax.text(*at, text, fontsize=SMALL_PT, color=colour, ha=ha, va=va, zorder=6, linespacing=1.25)


def dot(ax: Axes, at: Point, colour: str) -> None:
    """Where wires meet."""
    ax.plot(*at, marker="o", markersize=4.5, color=colour, zorder=4)


def measure(ax: Axes, start: Point, end: Point, text: str, *, above: Point) -> None:
    """A length between two points, its figure beside the middle."""
    arrow = {"arrowstyle": "<->", "color": INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops=arrow, zorder=6)
    middle = ((start[0] + end[0]) / 2 + above[0], (start[1] + end[1]) / 2 + above[1])
    ax.text(*middle, text, fontsize=SMALL_PT, color=INK, ha="center", va="center", zorder=6)


def draw(what: str, file: Path, picture: Callable[[], Figure]) -> None:
    """Write a picture where the command line says, or to its usual file."""
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("file", type=Path, nargs="?", default=file)
    chosen: Path = parser.parse_args().file
    write_bytes(chosen, png(picture()))
    print(f"wrote {chosen}")
