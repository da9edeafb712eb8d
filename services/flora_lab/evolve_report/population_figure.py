"""What becomes of the populations, as PNG bytes: species, and the size of the best network, over the generations."""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.evolution_folder import History
from flora_lab.evolve_report.curves import draw_curve, generation_axis, generations
from flora_lab.figure_style import BLUE, GREY, new_figure, png

BAND: Final = (10.0, 90.0)
"""Percentiles over runs between which the band lies."""


def population_figure(history: History) -> bytes:
    """Species, and hidden nodes and links of the generation's best genome: median over runs, and a band."""
    panels: tuple[tuple[str, Array], ...] = (
        ("species", history.species),
        ("hidden nodes of the best", history.nodes),
        ("links of the best", history.links),
    )
    figure = new_figure(11.0, 3.0)
    axes = figure.subplots(1, len(panels), sharex=True)
    for ax, (title, counts) in zip(axes, panels, strict=True):
        low, high = np.percentile(counts, BAND, axis=0)
        ax.fill_between(generations(counts.shape[1]), low, high, color=BLUE, alpha=0.25, linewidth=0)
        draw_curve(ax, np.median(counts, axis=0), color=BLUE, linewidth=1.5)
        ax.set_title(title, fontsize=10)
        generation_axis(ax)
        ax.set_ylim(0.0, max(1.0, 1.05 * float(high.max())))
        ax.locator_params(axis="y", integer=True)
    if len(history.species) > 1:
        text = f"median of {len(history.species)} runs; band: {BAND[0]:g} to {BAND[1]:g} % of them"
        figure.supxlabel(text, fontsize=8, color=GREY)
    return png(figure)
