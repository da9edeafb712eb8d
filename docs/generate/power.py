"""The power budget of ``docs/how-to/wire-the-pi.md``, computed from what flora-led itself reckons with.

``make docs`` writes the tables between their marks; a test compares. Two figures stand side by side: flora-led's own,
by which it keeps to ``current_cap_a``, and what the same bytes draw if a pixel takes 60 mA at full white, as data
sheets of WS2812B allow. Supply, fuses and wires are chosen by the second.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common.files import write_text
from flora_common.runs import Light
from flora_led.core import CHANNEL_A, IDLE_A, PIXELS, PIXELS_PER_STRIP, Rgb, current_a, shown
from flora_led.service import LedSection

PAGE: Final = Path(__file__).parents[1] / "how-to" / "wire-the-pi.md"

SUPPLY_V: Final = 5.0
WORST_PIXEL_A: Final = 0.060
"""One pixel at full white, by the data sheets of WS2812B; beside it :data:`IDLE_A` as in flora-led."""
COPPER_OHM_MM2_PER_M: Final = 0.0178
"""Resistivity of copper wire at room temperature."""
FEED_M: Final = 1.5
"""From the supply to a strip, one way."""
WIRES_MM2: Final = (0.75, 1.5, 2.5)
BITS_PER_PIXEL: Final = 24
BIT_S: Final = 1.25e-6
"""WS2812B at 800 kHz."""

DEFAULTS: Final = LedSection()
WHITE: Final[Rgb] = (255, 255, 255)


@dataclass(frozen=True, slots=True)
class Draw:
    """What is asked of the chain, and what it draws.

    Attributes:
        what: for people.
        colour: of a lit pixel, as it is written.
        own_a: by flora-led's own figures.
        worst_a: with :data:`WORST_PIXEL_A`.
    """

    what: str
    colour: Rgb
    own_a: float
    worst_a: float


def draw(what: str, light: Light, colour: Rgb, cap_a: float = DEFAULTS.current_cap_a) -> Draw:
    """The chain with a light, as flora-led would write it under a cap."""
    left, right, _ = shown(light, colour, cap_a)
    grb = b"".join(bytes((green, red, blue)) * PIXELS_PER_STRIP for red, green, blue in (left, right))
    worst_a = PIXELS * IDLE_A + sum(grb) / 255.0 * WORST_PIXEL_A / 3.0
    return Draw(what, max(left, right), current_a(grb), worst_a)


def draws() -> list[Draw]:
    """The rows of the budget."""
    cap = f"capped at {DEFAULTS.current_cap_a:g} A"
    return [
        draw("dark", "dark", DEFAULTS.colour),
        draw("one lamp, the default colour", "left", DEFAULTS.colour),
        draw("both lamps, the default colour", "both", DEFAULTS.colour),
        draw("one lamp, full white", "left", WHITE),
        draw(f"both lamps, full white, {cap}", "both", WHITE),
        draw("both lamps, full white, without a cap", "both", WHITE, cap_a=1000.0),
    ]


def strip_a(colour: Rgb) -> float:
    """One strip at a colour, at worst."""
    return PIXELS_PER_STRIP * (IDLE_A + sum(colour) / 255.0 * WORST_PIXEL_A / 3.0)


def drop_v(current: float, wire_mm2: float) -> float:
    """Voltage lost on the way to a strip and back."""
    return 2.0 * FEED_M * COPPER_OHM_MM2_PER_M / wire_mm2 * current


def budget() -> Iterator[str]:
    """The table of currents."""
    own, worst = f"{1000 * 3 * CHANNEL_A:g} mA", f"{1000 * WORST_PIXEL_A:g} mA"
    yield f"| light | pixel (R, G, B) | at {own} a white pixel | at {worst} | power at {worst} |"
    yield "|---|---|---|---|---|"
    for one in draws():
        cells = [one.what, str(one.colour), f"{one.own_a:.2f} A", f"{one.worst_a:.2f} A"]
        yield "| " + " | ".join([*cells, f"{SUPPLY_V * one.worst_a:.0f} W"]) + " |"


def wires() -> Iterator[str]:
    """The table of voltages lost in the feed of one strip."""
    loads = [("the default colour", strip_a(DEFAULTS.colour)), ("full white", strip_a(WHITE))]
    yield "| one strip at | draws | " + " | ".join(f"{mm2:g} mm²" for mm2 in WIRES_MM2) + " |"
    yield "|---" * (2 + len(WIRES_MM2)) + "|"
    for name, amperes in loads:
        lost = [f"{drop_v(amperes, mm2):.2f} V" for mm2 in WIRES_MM2]
        yield f"| {name} | {amperes:.2f} A | " + " | ".join(lost) + " |"


def refresh_ms() -> float:
    """How long the whole chain takes to be written."""
    return 1000.0 * PIXELS * BITS_PER_PIXEL * BIT_S


def with_tables(text: str) -> str:
    """A page with the tables between ``<!-- power: NAME -->`` and ``<!-- end -->`` made anew.

    Raises:
        LookupError: the page lacks the marks of a table.
    """
    for name, lines in (("budget", budget()), ("wires", wires())):
        begin, end = f"<!-- power: {name}, by `make docs` -->\n", "<!-- end -->"
        made = begin + "\n" + "\n".join(lines) + "\n\n" + end
        text, count = re.subn(re.escape(begin) + ".*?" + end, lambda _, made=made: made, text, flags=re.DOTALL)
        if count != 1:
            raise LookupError(f"the page has {count} places for the table `{name}`, not one: {begin.strip()} … {end}")
    return text


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write the power budget into its page.")
    parser.add_argument("file", type=Path, nargs="?", default=PAGE)
    file: Path = parser.parse_args().file
    write_text(file, with_tables(file.read_text(encoding="utf-8")))
    print(f"wrote the tables in {file}")
