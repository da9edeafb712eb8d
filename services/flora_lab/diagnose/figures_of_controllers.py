"""Picture of what a diagnosis is worth to controllers, as PNG bytes: fitness plant by plant, and collisions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from flora_lab.diagnose.controllers_told import KINDS
from flora_lab.diagnose.figure_parts import MEASURED, WIDE_IN
from flora_lab.figure_style import BLUE, GREY, GRID, ORANGE, new_figure, png

_COLUMNS: Final = (
    ("without_effect", "as it is; plants\nwithout the causes", GREY),
    ("base", "as it is;\nplants with them", BLUE),
    ("extended", "extended;\nplants with them", ORANGE),
)
_BOX: Final = 0.5
_JITTER: Final = 0.1
_BAR: Final = 0.36
"""Half of the width, in columns, of the bar that is the mean."""


def controllers(fitness: Mapping[str, Any]) -> bytes:
    """Fitness on each plant, by kind of controllers and by where they were evolved; below it the collisions.

    Args:
        fitness: kind to what :func:`flora_lab.diagnose.controller_gain.controller_gain` tells; one or more.
    """
    figure = new_figure(WIDE_IN, 4.4)
    axes = figure.subplots(2, len(fitness), sharex=True, sharey="row", height_ratios=(3.0, 1.0), squeeze=False)
    for (strip, bars), (kind, told) in zip(axes.T, fitness.items(), strict=True):
        strip.set_title(KINDS[kind], fontsize=10)
        _strips(strip, told)
        shares = [100.0 * told[key]["collisions"] for key, _, _ in _COLUMNS]
        bars.bar(range(len(_COLUMNS)), shares, _BOX, color=[colour for _, _, colour in _COLUMNS])
        for place, share in enumerate(shares):
            put = {"xytext": (0, 2), "textcoords": "offset points", "ha": "center", "fontsize": 8}
            bars.annotate(f"{share:.0f} %", (place, share), **put)
        bars.set_xticks(range(len(_COLUMNS)), [name for _, name, _ in _COLUMNS], fontsize=9)
        bars.set_xlabel("simulator that they were evolved in; plants that they were run on", fontsize=9)
    most = max(100.0 * told[key]["collisions"] for told in fitness.values() for key, _, _ in _COLUMNS)
    axes[1, 0].set_ylim(0.0, max(10.0, 1.35 * most))
    axes[0, 0].set_ylabel("fitness", fontsize=9)
    axes[1, 0].set_ylabel("collisions,\n% of runs", fontsize=9)
    for ax in axes.ravel():
        ax.tick_params(axis="y", labelsize=8)
        ax.grid(axis="y", color=GRID, linewidth=0.6)
        ax.set_axisbelow(True)
    return png(figure)


def _strips(ax: Axes, told: Mapping[str, Any]) -> None:
    """A box, the plants and their mean for each column; lines join what one plant is worth to both simulators."""
    columns = [np.array(told[key]["of_plants"]) for key, _, _ in _COLUMNS]
    aside = np.random.default_rng(0).uniform(-_JITTER, _JITTER, len(columns[0]))
    ax.plot([1.0 + aside, 2.0 + aside], columns[1:], color=GRID, linewidth=0.8, zorder=1)
    for place, (values, (_, _, colour)) in enumerate(zip(columns, _COLUMNS, strict=True)):
        low, high = np.percentile(values, (25.0, 75.0))
        ax.bar(place, high - low, _BOX, bottom=low, color=colour, alpha=0.22, linewidth=0, zorder=2)
        ax.scatter(place + aside, values, s=14, color=colour, linewidths=0, zorder=3)
        ax.hlines(values.mean(), place - _BAR, place + _BAR, color=MEASURED, linewidth=1.8, zorder=4)
