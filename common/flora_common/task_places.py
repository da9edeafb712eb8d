"""Where target and obstacle of a task may lie, so that a plant can be set it at all; for virtual box and lab alike."""

from __future__ import annotations

import math
from typing import Final

from flora_common.errors import BadInput
from flora_common.geometry import collides
from flora_common.shapes import Obstacle, Target

BOX_WIDTH_CM: Final = 120.0
BOX_HEIGHT_CM: Final = 200.0
"""The grow box (section "Bio-hybrid setup"): the anchor stands in the middle of its width."""


def check_places(
    target: Target,
    obstacle: Obstacle,
    *,
    stop_height_cm: float,
    where: str,
    stop_height: str = "stop_height_cm",
) -> None:
    """Whether a stem can stand at the anchor, and a tip come to the target.

    Args:
        target, obstacle: the task.
        stop_height_cm: height of the tip at which runs end, in cm.
        where: they are from; the error begins with it.
        stop_height: what that height is called there.

    Raises:
        BadInput: the first thing that does not hold, in one line.
    """
    numbers = (target.x_cm, target.y_cm, target.radius_cm)
    edges = (obstacle.left_cm, obstacle.bottom_cm, obstacle.right_cm, obstacle.top_cm)
    if not all(math.isfinite(number) for number in numbers + edges):
        raise BadInput(f"{where}: holds a number that is not finite")
    box = f"the box, {BOX_WIDTH_CM:g} cm wide and {BOX_HEIGHT_CM:g} cm high above the anchor"
    if not _in_box(target.x_cm, target.y_cm):
        raise BadInput(f"{where}: target ({target.x_cm:g}, {target.y_cm:g}) cm is outside {box}")
    if not (_in_box(*edges[:2]) and _in_box(*edges[2:])):
        raise BadInput(
            f"{where}: obstacle from ({edges[0]:g}, {edges[1]:g}) to ({edges[2]:g}, {edges[3]:g}) cm reaches outside "
            f"{box}"
        )
    if target.contains(0.0, 0.0):
        raise BadInput(f"{where}: the target lies on the anchor; there is nowhere to grow to")
    if target.y_cm - target.radius_cm > stop_height_cm:
        raise BadInput(
            f"{where}: the target begins {target.y_cm - target.radius_cm:g} cm high and runs end at {stop_height}, "
            f"{stop_height_cm:g} cm"
        )
    if collides([(target.x_cm, target.y_cm)] * 2, obstacle):
        raise BadInput(f"{where}: target ({target.x_cm:g}, {target.y_cm:g}) cm is inside the obstacle")
    if collides([(0.0, 0.0)] * 2, obstacle):
        raise BadInput(f"{where}: the obstacle covers the anchor; no stem can stand there")


def _in_box(x_cm: float, y_cm: float) -> bool:
    return abs(x_cm) <= BOX_WIDTH_CM / 2 and 0.0 <= y_cm <= BOX_HEIGHT_CM
