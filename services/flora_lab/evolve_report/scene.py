"""A scenario in the plane: obstacle, target, anchor and lamps, drawn alike in figures and film."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.patches import Circle, Rectangle

from flora_common.arrays import FloatArray
from flora_common.runs import Light
from flora_lab.evolve.task import Scenario, Task
from flora_lab.figure_style import LAMP_COLOURS, OBSTACLE, TARGET

MARGIN_CM: Final = 1.5
HEAD_CM: Final = 3.5
"""Above everything else, for the lamps."""
LAMP_PLACES: Final[dict[Light, float]] = {"left": 0.09, "right": 0.91}
"""Across the axes, as a share of their width; the lamps themselves are farther away than can be drawn."""
OFF: Final = "white"


@dataclass(frozen=True, slots=True)
class Window:
    """The part of the plane that is shown, the same in all panels of a figure, cm."""

    left_cm: float
    right_cm: float
    bottom_cm: float
    top_cm: float

    @property
    def shape(self) -> float:
        """Height over width."""
        return (self.top_cm - self.bottom_cm) / (self.right_cm - self.left_cm)


def window_of(task: Task, stems_cm: Iterable[FloatArray] = ()) -> Window:
    """A window in which all obstacles, targets and stems are, stems of shape (..., 2).

    A stem that goes astray farther than twice the task's height is cut off, so that the others can be seen.
    """
    places = [task.start_stem_cm]
    for scenario in task.scenarios:
        target, obstacle = scenario.target, scenario.obstacle
        centre = np.array([target.x_cm, target.y_cm])
        places.append(np.stack([centre - target.radius_cm, centre + target.radius_cm]))
        places.append(np.array([(obstacle.left_cm, obstacle.bottom_cm), (obstacle.right_cm, obstacle.top_cm)]))
    limit = 2.0 * task.stop_height_cm
    places.extend(np.clip(stem.reshape(-1, 2), -limit, limit) for stem in stems_cm)
    every = np.concatenate(places)
    low, high = every.min(axis=0), every.max(axis=0)
    high[1] = max(high[1], task.stop_height_cm)
    return Window(
        float(low[0]) - MARGIN_CM,
        float(high[0]) + MARGIN_CM,
        min(float(low[1]), 0.0) - 0.5 * MARGIN_CM,
        float(high[1]) + HEAD_CM,
    )


def draw_scenario(ax: Axes, scenario: Scenario, window: Window) -> None:
    """Obstacle, target and anchor on axes of equal scale, without lamps and stem."""
    target, obstacle = scenario.target, scenario.obstacle
    corner = (obstacle.left_cm, obstacle.bottom_cm)
    ax.add_patch(Rectangle(corner, obstacle.width_cm, obstacle.height_cm, facecolor=OBSTACLE, linewidth=0))
    ax.add_patch(Circle((target.x_cm, target.y_cm), target.radius_cm, facecolor=TARGET, alpha=0.3, linewidth=0))
    ax.plot(target.x_cm, target.y_cm, "+", color=TARGET, markersize=6)
    ax.plot(0.0, 0.0, "k^", markersize=4, clip_on=False)
    ax.set(xlim=(window.left_cm, window.right_cm), ylim=(window.bottom_cm, window.top_cm))
    ax.set_aspect("equal", adjustable="box")
    ax.tick_params(labelsize=7)


def draw_lamps(ax: Axes) -> dict[Light, PathCollection]:
    """A circle for each lamp at the top of the axes, both off."""
    circles: dict[Light, PathCollection] = {}
    for light, x in LAMP_PLACES.items():
        place: dict[str, Any] = {"transform": ax.transAxes, "zorder": 3}
        circles[light] = ax.scatter([x], [0.94], s=70, edgecolors=LAMP_COLOURS[light], linewidths=1.5, **place)
        circles[light].set_facecolor(OFF)
    return circles


def light_lamps(circles: dict[Light, PathCollection], light: Light | None) -> None:
    """Fill the circle of the lamp that shines; none where ``light`` is None."""
    for name, circle in circles.items():
        circle.set_facecolor(LAMP_COLOURS[name] if name == light else OFF)


def side(is_right: bool) -> Light:
    """The lamp's name."""
    return "right" if is_right else "left"
