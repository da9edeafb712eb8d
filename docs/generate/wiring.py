"""``docs/images/wiring.png``: Pi, level shifter, both strips, supplies, flash and camera, with the code's own pins."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drawing import GREY, block, dot, draw, note, sheet, wire
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flora_flash.handshake import FlashSection
from flora_led.core import PIXELS, PIXELS_PER_STRIP
from flora_led.service import LedSection

FILE: Final = Path(__file__).parents[1] / "images" / "wiring.png"

HEADER: Final = {17: 11, 18: 12}
"""Position on the Pi's 40-pin header of the GPIO lines that are drawn."""
DATA_GPIO: Final = int(LedSection().pin.removeprefix("D"))
FLASH_GPIO: Final = FlashSection().line

RED: Final = "#c8372d"
BLACK: Final = "#333333"
DATA: Final = "#0072B2"
SWITCHED: Final = "#8a5a00"
RIBBON: Final = "#777777"
FILL: Final = "#f4f1ea"


def picture() -> Figure:
    """The whole wiring, 120 by 78 units."""
    figure, ax = sheet(11.0, 7.0, 120.0, 78.0)
    _pi(ax)
    _level_shifter(ax)
    _strips(ax)
    _supply(ax)
    _flash(ax)
    _ground(ax)
    _legend(ax)
    return figure


def _pi(ax: Axes) -> None:
    block(ax, (4.0, 30.0), (20.0, 32.0), "Raspberry Pi", fill=FILL, dy=12.5)
    for y, gpio, name in ((52.0, DATA_GPIO, "data"), (38.0, FLASH_GPIO, "flash")):
        note(ax, (23.2, y), f"{name}: GPIO{gpio}, pin {HEADER[gpio]}", ha="right")
    note(ax, (23.2, 45.0), "GND, pin 14", ha="right")
    block(ax, (4.0, 69.0), (11.0, 6.0), "camera", fill=FILL)
    wire(ax, [(9.5, 69.0), (9.5, 62.0)], RIBBON, width=5.0)
    note(ax, (11.5, 65.5), "flat cable", colour=RIBBON)
    block(ax, (4.0, 18.0), (20.0, 6.0), "the Pi's own supply", fill=FILL)
    wire(ax, [(14.0, 24.0), (14.0, 30.0)], RED, width=2.4)
    note(ax, (15.0, 27.0), "USB")


def _level_shifter(ax: Axes) -> None:
    block(ax, (35.0, 46.0), (15.0, 12.0), "74AHCT125", fill=FILL, dy=3.0)
    note(ax, (35.8, 52.0), "1A", ha="left")
    note(ax, (49.2, 52.0), "1Y", ha="right")
    note(ax, (42.5, 56.9), "VCC", ha="center")
    note(ax, (42.5, 47.1), "1OE, GND", ha="center")
    wire(ax, [(24.0, 52.0), (35.0, 52.0)], DATA)
    note(ax, (29.5, 53.4), "3.3 V", colour=DATA, ha="center")
    wire(ax, [(50.0, 52.0), (55.0, 52.0)], DATA)
    block(ax, (55.0, 50.6), (6.0, 2.8), "330 Ω", fill=FILL)
    wire(ax, [(61.0, 52.0), (68.0, 52.0)], DATA)
    note(ax, (62.0, 53.4), "5 V", colour=DATA)
    wire(ax, [(42.5, 58.0), (42.5, 66.0), (56.0, 66.0)], RED)
    dot(ax, (56.0, 66.0), RED)


def _strips(ax: Axes) -> None:
    last = PIXELS_PER_STRIP - 1
    for low, name, pixels in ((50.0, "left strip", f"0 … {last}"), (32.0, "right strip", f"{last + 1} … {PIXELS - 1}")):
        block(ax, (68.0, low - 2.0), (40.0, 8.0), f"{name}: pixels {pixels}", fill="#e8f0fa")
        note(ax, (68.8, low + 2.0), "DIN")
        note(ax, (107.2, low + 2.0), "DOUT", ha="right")
        # Power goes in at both ends.
        for x in (72.0, 104.0):
            wire(ax, [(x, low + 6.0), (x, low + 9.0)], RED, width=2.6)
            wire(ax, [(x, low - 2.0), (x, low - 5.0)], BLACK, width=2.6)
        wire(ax, [(72.0, low + 9.0), (104.0, low + 9.0)], RED, width=2.6)
        wire(ax, [(72.0, low - 5.0), (104.0, low - 5.0)], BLACK, width=2.6)
    note(ax, (88.0, 60.4), "5 V at both ends", colour=RED, ha="center")
    note(ax, (88.0, 43.7), "GND at both ends", colour=BLACK, ha="center")
    wire(ax, [(108.0, 52.0), (114.0, 52.0), (114.0, 24.0), (64.0, 24.0), (64.0, 34.0), (68.0, 34.0)], DATA)
    note(
        ax,
        (108.0, 22.4),
        "data goes on from the left strip's end to the right one's beginning",
        colour=DATA,
        ha="right",
    )


def _supply(ax: Axes) -> None:
    block(ax, (24.0, 69.0), (20.0, 6.0), "5 V, 15 A", fill=FILL)
    wire(ax, [(44.0, 73.0), (56.0, 73.0)], RED, width=2.6)
    dot(ax, (56.0, 73.0), RED)
    wire(ax, [(56.0, 73.0), (56.0, 66.0), (56.0, 59.0)], RED, width=2.6)
    wire(ax, [(56.0, 73.0), (72.0, 73.0), (72.0, 59.0)], RED, width=2.6)
    block(ax, (61.0, 71.6), (6.0, 2.8), "10 A", fill=FILL)
    wire(ax, [(56.0, 59.0), (56.0, 57.0), (66.0, 57.0), (66.0, 41.0), (72.0, 41.0)], RED, width=2.6)
    block(ax, (63.0, 44.6), (6.0, 2.8), "10 A", fill=FILL)
    block(ax, (77.0, 64.6), (16.0, 2.8), "1000 µF, 10 V", fill=FILL)
    wire(ax, [(72.0, 66.0), (77.0, 66.0)], RED)
    wire(ax, [(93.0, 66.0), (117.0, 66.0), (117.0, 45.0), (104.0, 45.0)], BLACK)
    note(ax, (94.0, 67.5), "one at each strip")


def _flash(ax: Axes) -> None:
    wire(ax, [(24.0, 38.0), (31.0, 38.0)], SWITCHED)
    block(ax, (31.0, 34.0), (16.0, 8.0), "MOSFET\nor relay", fill=FILL)
    block(ax, (31.0, 18.0), (9.0, 6.0), "12 V", fill=FILL)
    block(ax, (47.0, 18.0), (11.0, 6.0), "flash\nlamp", fill="#fff3b0")
    wire(ax, [(40.0, 21.0), (47.0, 21.0)], RED)
    block(ax, (41.5, 19.6), (4.0, 2.8), "2 A", fill=FILL)
    wire(ax, [(52.5, 24.0), (52.5, 38.0), (47.0, 38.0)], SWITCHED)
    note(ax, (31.5, 44.0), "10 kΩ from its input to GND", colour=SWITCHED)


def _ground(ax: Axes) -> None:
    """One ground for all: without it no signal has a level."""
    rail = 8.0
    wire(ax, [(2.0, rail), (117.0, rail)], BLACK, width=3.0)
    note(ax, (60.0, 5.6), "one common ground: Pi, level shifter, both strips, 5 V supply, 12 V supply", ha="center")
    wire(ax, [(24.0, 45.0), (27.0, 45.0), (27.0, rail)], BLACK)
    wire(ax, [(42.5, 46.0), (42.5, 45.2), (60.0, 45.2), (60.0, rail)], BLACK)
    wire(ax, [(24.0, 72.0), (19.0, 72.0), (19.0, 77.0), (1.5, 77.0), (1.5, rail), (2.0, rail)], BLACK, width=2.6)
    wire(ax, [(39.0, 34.0), (39.0, 30.0), (29.0, 30.0), (29.0, rail)], BLACK)
    wire(ax, [(36.0, 18.0), (36.0, rail)], BLACK)
    wire(ax, [(104.0, 45.0), (117.0, 45.0), (117.0, rail)], BLACK, width=2.6)
    wire(ax, [(104.0, 27.0), (110.0, 27.0), (110.0, rail)], BLACK, width=2.6)
    for at in ((27.0, rail), (29.0, rail), (36.0, rail), (60.0, rail), (110.0, rail), (117.0, rail), (117.0, 45.0)):
        dot(ax, at, BLACK)


def _legend(ax: Axes) -> None:
    for x, colour, name in (
        (64.0, RED, "supply"),
        (77.0, BLACK, "ground"),
        (90.0, DATA, "data"),
        (101.0, SWITCHED, "flash"),
    ):
        wire(ax, [(x, 15.0), (x + 4.0, 15.0)], colour, width=2.6)
        note(ax, (x + 5.0, 15.0), name)
    note(ax, (64.0, 12.0), "drawn from the default configuration; not to scale", colour=GREY)


if __name__ == "__main__":
    draw("Draw the wiring.", FILE, picture)
