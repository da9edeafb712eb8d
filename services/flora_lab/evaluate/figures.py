"""Simulated and virtual plants in one picture: where their tips went, and how their stems stood at the end."""

from __future__ import annotations

from typing import Final

from matplotlib.axes import Axes

from flora_lab.evaluate.evaluation import Evaluation
from flora_lab.evaluate.gap import Row
from flora_lab.evaluate.trial import TWIN, Trial
from flora_lab.evolve_report.scene import draw_scenario, window_of
from flora_lab.figure_style import COLOURS, GREY, drawable, new_figure, png

MOST_PANELS: Final = 12
COLUMNS: Final = 3
PANEL_WIDE_IN: Final = 3.3
TITLE_SIGNS: Final = 40
VIRTUAL: Final = "black"


def tracks_figure(one: Evaluation) -> bytes:
    """A panel for each controller in each scenario; of very many the first. PNG bytes."""
    panels = list(dict.fromkeys((row.controller, row.scenario) for row in one.rows))
    shown = panels[:MOST_PANELS]
    window = window_of(one.plan.task, [drawn for t in one.trials for drawn in (t.stems_cm[-1], t.stems_cm[:, -1])])
    columns = min(COLUMNS, len(shown))
    high = -(-len(shown) // columns)
    tall_in = PANEL_WIDE_IN * min(window.shape, 2.0) + 0.5
    figure = new_figure(0.4 + PANEL_WIDE_IN * columns, high * tall_in + 0.5)
    axes = figure.subplots(high, columns, squeeze=False).ravel()
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(one.simulators)} | {TWIN: VIRTUAL}
    for ax, (controller, scenario) in zip(axes, shown, strict=False):
        draw_scenario(ax, scenario, window)
        for row in one.rows:
            if (row.controller, row.scenario) == (controller, scenario):
                _draw(ax, row, colours[row.place])
        title = f"{drawable(controller, TITLE_SIGNS)}\n{drawable(scenario.name, TITLE_SIGNS)}"
        ax.set_title(title, fontsize=8, parse_math=False)
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    axes[0].set_ylabel("cm", fontsize=8)
    words = {name: drawable(name, TITLE_SIGNS) for name in one.simulators} | {TWIN: "virtual plants, as measured"}
    lines = [axes[0].plot([], [], color=colours[place], label=words[place])[0] for place in one.places]
    legend = figure.legend(handles=lines, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    for label in legend.get_texts():
        label.set_parse_math(False)
    if len(shown) < len(panels):
        figure.suptitle(f"the first {MOST_PANELS} of {len(panels)}", fontsize=9, color=GREY)
    return png(figure)


def _draw(ax: Axes, row: Row, colour: str) -> None:
    for trial in row.plants:
        _draw_trial(ax, trial, colour, wide=1.4 if row.place == TWIN else 0.8)
    if row.typical is not None:
        _draw_trial(ax, row.typical, colour, wide=2.0)


def _draw_trial(ax: Axes, trial: Trial, colour: str, *, wide: float) -> None:
    """The stem at the end, and the tip's way there."""
    ax.plot(*trial.stems_cm[:, -1].T, color=colour, linewidth=0.5, alpha=0.6)
    ax.plot(*trial.stems_cm[-1].T, color=colour, linewidth=wide, solid_capstyle="round")
