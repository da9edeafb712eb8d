"""``docs/images/box.png``: the box from the front and from the side, to scale, from the figures of the virtual one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drawing import INK, draw, measure, note, plain
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from flora_lab.figure_style import BLUE, GREY, ORANGE, new_figure
from flora_twin.box import BOX, CAMERA

FILE: Final = Path(__file__).parents[1] / "images" / "box.png"

WIDE_CM, HIGH_CM = 120.0, 200.0
"""The grow box, as in the paper; as deep as wide."""
SHOWN_CM = 108.0
"""Of its height: above it there is nothing to see."""
LAMP: Final = "#a9c8ee"
POT: Final = "#b5835a"
VIEW: Final = "#f3ecd8"
STEM: Final = "#2f8f3a"


def _pot_and_plant(ax: Axes) -> None:
    ground, top = BOX.ground_y_cm, BOX.rim_above_soil_cm
    low, high = BOX.pot_bottom_radius_cm, BOX.pot_top_radius_cm
    corners = [(-low, ground), (low, ground), (high, top), (-high, top)]
    ax.add_patch(Polygon(corners, closed=True, facecolor=POT, edgecolor=INK, linewidth=1.0, zorder=4))
    ax.plot([0.0, 0.0], [0.0, 15.0], color=STEM, linewidth=3.0, solid_capstyle="round", zorder=5)


def _flash(ax: Axes) -> float:
    """The lamp, over the pot; returns its height."""
    y = float(BOX.flash_cm[1])
    ax.add_patch(Circle((0.0, y), 3.0, facecolor="#fff3b0", edgecolor=INK, linewidth=1.0, zorder=4))
    return y


def _anchor(ax: Axes) -> None:
    ax.plot(0.0, 0.0, marker="+", color=ORANGE, markersize=11, markeredgewidth=1.8, zorder=7)


def _walls(ax: Axes, left: float) -> None:
    """The box up to where it is cut off."""
    ground = BOX.ground_y_cm
    ax.add_patch(Rectangle((left, ground), WIDE_CM, SHOWN_CM, facecolor="#e9e9e9", edgecolor="none"))
    right, top = left + WIDE_CM, ground + SHOWN_CM
    ax.plot([left, left, right, right], [top, ground, ground, top], color=INK, linewidth=1.5, zorder=2)
    note(ax, (right - 3.0, top - 3.0), f"goes on to {HIGH_CM:g}", ha="right", va="top", colour=GREY)


def _front(ax: Axes) -> None:
    ground, half, soil = BOX.ground_y_cm, WIDE_CM / 2, 0.0
    plain(ax, (-half - 12.0, half + 2.0), (ground - 13.0, ground + SHOWN_CM))
    _walls(ax, -half)
    view_w, view_h = CAMERA.width_px / CAMERA.px_per_cm, CAMERA.height_px / CAMERA.px_per_cm
    top = BOX.camera_y_cm + view_h / 2
    view = Rectangle((-view_w / 2, ground), view_w, top - ground, facecolor=VIEW, edgecolor=GREY, linestyle="--")
    ax.add_patch(view)
    note(ax, (view_w / 2 - 1.0, top - 1.5), f"camera sees {view_w:.0f} x {view_h:.0f}", ha="right", va="top")
    away, high = BOX.lamp_distance_cm, BOX.lamp_height_cm
    for side in (-1, 1):
        low = (side * away - BOX.lamp_radius_cm, high - BOX.lamp_body_cm / 2)
        size = (2 * BOX.lamp_radius_cm, BOX.lamp_body_cm)
        ax.add_patch(Rectangle(low, *size, facecolor=LAMP, edgecolor=BLUE, linewidth=1.4, zorder=4))
        note(ax, (side * away, high + 7.0), "left lamp" if side < 0 else "right lamp", ha="center", colour=BLUE)
        measure(ax, (0.0, high), (side * away, high), f"{away:g}", above=(side * 3.0, 2.5))
    ax.plot([0.0, 0.0], [soil, high + 2.0], color=GREY, linewidth=0.8, linestyle=":", zorder=2)
    measure(ax, (-away, soil), (-away, high), f"{high:g}", above=(-3.5, 0.0))
    ax.plot([-away - 2.0, 0.0], [soil, soil], color=GREY, linewidth=0.8, zorder=3)
    _pot_and_plant(ax)
    flash = _flash(ax)
    note(ax, (5.0, flash), "flash, over the pot")
    measure(ax, (-half + 5.0, ground), (-half + 5.0, flash), f"{BOX.flash_above_ground_cm:g}", above=(3.0, 0.0))
    ax.plot([-half + 3.0, -3.0], [flash, flash], color=GREY, linewidth=0.8, linestyle=":", zorder=2)
    measure(ax, (-half, ground - 4.0), (half, ground - 4.0), f"{WIDE_CM:g}", above=(0.0, -3.0))
    _anchor(ax)
    note(ax, (9.0, soil + 2.5), "anchor (0, 0): where\nthe stem leaves the soil", colour=ORANGE)
    ax.set_title("from the front (cm)", fontsize=11)


def _side(ax: Axes) -> None:
    ground, wall, camera, eye = BOX.ground_y_cm, BOX.wall_z_cm, BOX.camera_distance_cm, BOX.camera_y_cm
    plain(ax, (wall - 4.0, wall + WIDE_CM + 2.0), (ground - 13.0, ground + SHOWN_CM))
    _walls(ax, wall)
    ax.plot([wall, wall], [ground, ground + SHOWN_CM], color="black", linewidth=5.0, zorder=3)
    note(ax, (wall + 3.0, ground + SHOWN_CM - 3.0), "back wall,\nmatte black", va="top")
    slope = CAMERA.height_px / 2 / CAMERA.focal_px
    floor = camera - (eye - ground) / slope
    rays = [(camera, eye), (wall, eye + slope * (camera - wall)), (wall, ground), (floor, ground)]
    ax.add_patch(Polygon(rays, closed=True, facecolor=VIEW, edgecolor=GREY, linestyle="--"))
    low = (float(BOX.lamps_cm[0, 2]) - BOX.lamp_radius_cm, BOX.lamp_height_cm - BOX.lamp_body_cm / 2)
    size = (2 * BOX.lamp_radius_cm, BOX.lamp_body_cm)
    ax.add_patch(Rectangle(low, *size, facecolor=LAMP, edgecolor=BLUE, linewidth=1.4, zorder=4))
    note(ax, (low[0] + size[0] + 1.5, BOX.lamp_height_cm), "lamps", colour=BLUE)
    _pot_and_plant(ax)
    note(ax, (5.0, _flash(ax)), "flash")
    ax.add_patch(Rectangle((camera, eye - 3.0), 5.0, 6.0, facecolor=INK, edgecolor=INK, zorder=4))
    note(ax, (camera + 2.5, eye + 4.5), "camera, level", ha="center", va="bottom")
    measure(ax, (0.0, eye), (camera, eye), f"{camera:g}", above=(10.0, 2.5))
    ax.plot([0.0, 0.0], [0.0, eye + 2.0], color=GREY, linewidth=0.8, linestyle=":", zorder=2)
    measure(ax, (camera + 2.5, ground), (camera + 2.5, eye - 3.0), f"{BOX.camera_above_ground_cm:g}", above=(4.0, 0.0))
    measure(ax, (wall, ground - 4.0), (0.0, ground - 4.0), f"{-wall:g}", above=(0.0, -3.0))
    measure(ax, (0.0, ground - 4.0), (wall + WIDE_CM, ground - 4.0), f"{wall + WIDE_CM:g}", above=(0.0, -3.0))
    _anchor(ax)
    ax.set_title("from the side (cm)", fontsize=11)


def picture() -> Figure:
    """Both views side by side."""
    figure = new_figure(11.0, 5.0)
    front, side = figure.subplots(1, 2)
    _front(front)
    _side(side)
    return figure


if __name__ == "__main__":
    draw("Draw the box.", FILE, picture)
