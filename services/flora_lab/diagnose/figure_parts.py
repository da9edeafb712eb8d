"""What pictures of a diagnosis have in common: colours, lamps behind the curves, and a legend above them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from flora_lab.diagnose.diagnosis import SIMULATOR_NAMES
from flora_lab.diagnose.replayed import Replayed
from flora_lab.diagnose.residual_statistics import SIDES
from flora_lab.figure_style import BLUE, GRID, ORANGE

MEASURED: Final = "#111111"
CHANCE: Final = "#d9dde2"
LAMP_TINTS: Final = {"left": "#e6effa", "right": "#fff4d0"}
"""Paler than the lamps' own colours, so that lines stand out before them."""
WIDE_IN: Final = 9.6


def lamps(ax: Axes, run: Replayed) -> None:
    """A tint behind the hours in which one lamp alone shines."""
    start = run.time_h - run.step_h
    for side, shines in (("left", run.is_left), ("right", run.is_right)):
        edges = np.diff(np.concatenate([[0], shines.astype(np.int64), [0]]))
        for begin, end in zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0], strict=True):
            ax.axvspan(start[begin], run.time_h[end - 1], color=LAMP_TINTS[side], linewidth=0, zorder=0)


def side_of_lamp(ax: Axes, run: Replayed, at: int) -> None:
    """A tint behind the half of the axes from which the lamp shines."""
    for side, shines, low in (("left", run.is_left, 0.0), ("right", run.is_right, 0.5)):
        if shines[at]:
            place: dict[str, Any] = {"transform": ax.transAxes, "linewidth": 0, "zorder": 0}
            ax.add_patch(Rectangle((low, 0.0), 0.5, 1.0, color=LAMP_TINTS[side], **place))


def legend(
    figure: Figure,
    with_extended: bool,
    *,
    measured: bool = True,
    lamps: bool = False,
    chance: bool = False,
    reference: bool = False,
) -> None:
    """What the colours mean, in one row above the picture."""
    marks: list[Any] = [Line2D([], [], color=MEASURED, linewidth=2)] if measured else []
    names = ["measured"] if measured else []
    marks.append(Line2D([], [], color=BLUE, linewidth=2))
    names.append(SIMULATOR_NAMES["base"])
    if with_extended:
        marks.append(Line2D([], [], color=ORANGE, linewidth=2))
        names.append(SIMULATOR_NAMES["extended"])
    if chance or reference:
        marks.append(Patch(color=CHANCE))
        names.append("9 of 10 plants, if nothing were wrong" if chance else "reference runs")
    if lamps:
        marks.extend(Patch(facecolor=LAMP_TINTS[side], edgecolor=GRID) for side in SIDES)
        names.extend(f"{side} lamp" for side in SIDES)
    figure.legend(
        marks, names, loc="outside upper center", ncols=len(marks), fontsize=8, frameon=False, handlelength=1.6
    )
