"""Curves over the generations of an evolution, drawn alike in all figures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from flora_common.arrays import Array, FloatArray
from flora_lab.figure_style import GRID


def generations(count: int) -> FloatArray:
    """Their numbers, from 0 as everywhere in an evolution's folder."""
    return np.arange(float(count))


def draw_curve(ax: Axes, values: Array, **style: Any) -> Line2D:
    """A line through the values of all generations; a dot where there is only one."""
    marker = "o" if len(values) == 1 else ""
    (line,) = ax.plot(generations(len(values)), values, marker=marker, **style)
    return line


def generation_axis(ax: Axes) -> None:
    """Generations from left to right, and a grid."""
    ax.set_xlabel("generation")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    ax.grid(color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
