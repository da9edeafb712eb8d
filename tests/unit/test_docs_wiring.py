"""The pages that tell how to build and wire a rig: their figures are the code's, and the parts they name are enough."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from flora_flash.handshake import FlashSection
from flora_led.service import LedSection
from flora_twin.box import BOX, CAMERA

ROOT = Path(__file__).parents[2]
GENERATE = ROOT / "docs" / "generate"
WIRING = (ROOT / "docs/how-to/wire-the-pi.md").read_text(encoding="utf-8")
BUILDING = (ROOT / "docs/how-to/build-the-box.md").read_text(encoding="utf-8")
SUPPLY_A, FUSE_A = 15.0, 10.0
"""As the page says."""

Script = Callable[[str], ModuleType]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    def load(name: str) -> ModuleType:
        monkeypatch.syspath_prepend(str(GENERATE))
        module = importlib.import_module(name)
        for mine in (name, "drawing"):
            monkeypatch.delitem(sys.modules, mine, raising=False)
        return module

    return load


def words(text: str) -> str:
    """Without line breaks, which fall anywhere."""
    return " ".join(text.split())


def test_the_tables_are_what_flora_led_reckons_with(script: Script) -> None:
    assert script("power").with_tables(WIRING) == WIRING, "wire-the-pi.md is out of date: run `make docs`"


def test_a_page_that_lost_the_place_of_a_table_is_told(script: Script) -> None:
    with pytest.raises(LookupError, match="the page has 0 places for the table `wires`"):
        script("power").with_tables(WIRING.replace("<!-- power: wires", "<!-- "))


def test_the_parts_are_enough(script: Script) -> None:
    power = script("power")
    assert f"5 V, {SUPPLY_A:g} A (75 W)" in WIRING
    assert f"| fuse of each strip | {FUSE_A:g} A," in WIRING
    possible = [one for one in power.draws() if "without a cap" not in one.what]
    assert max(one.worst_a for one in possible) <= 0.7 * SUPPLY_A
    assert 0.5 * FUSE_A < power.strip_a(power.WHITE) < FUSE_A
    assert power.drop_v(power.strip_a(power.WHITE), 1.5) < 0.4


@pytest.mark.parametrize("supply_a", [3.0, 5.0, 10.0, 15.0])
def test_two_thirds_of_a_supply_are_a_cap_that_it_can_give(script: Script, supply_a: float) -> None:
    worst = script("power").draw("", "both", (255, 255, 255), cap_a=supply_a * 2.0 / 3.0).worst_a
    assert 0.7 * supply_a < worst < 0.9 * supply_a


def test_what_the_text_says_of_the_chain_is_so(script: Script) -> None:
    power = script("power")
    assert f"writing all {power.PIXELS} takes {power.refresh_ms():.1f} ms" in words(WIRING)
    assert f"a strip draws {power.strip_a(power.WHITE):.1f} A at most" in words(WIRING)
    assert f"`current_cap_a`, {LedSection().current_cap_a:g} A." in words(WIRING)
    one = next(one for one in power.draws() if one.what == "one lamp, the default colour")
    assert f"{power.SUPPLY_V * one.worst_a:.0f} W come out of a lamp" in words(BUILDING)


def test_the_pins_are_those_of_the_configuration(script: Script) -> None:
    pin, line = LedSection().pin, FlashSection().line
    header = script("wiring").HEADER
    gpio = int(pin.removeprefix("D"))
    assert f'| GPIO{gpio}, header pin {header[gpio]} | 1A of the level shifter | `[led] pin = "{pin}"` |' in WIRING
    assert f"| GPIO{line}, header pin {header[line]} | the flash's switch | `[flash] line = {line}` |" in WIRING


def test_the_distances_are_those_of_the_virtual_box() -> None:
    width, height = CAMERA.width_px / CAMERA.px_per_cm, CAMERA.height_px / CAMERA.px_per_cm
    sees = f"sees {width:.0f} x {height:.0f} cm, {CAMERA.px_per_cm:.1f} px"
    assert f"At {BOX.camera_distance_cm:g} cm the Pi camera v2 {sees}" in words(BUILDING)
    assert f"{CAMERA.anchor_px[1] / CAMERA.px_per_cm:.0f} cm of it above the anchor" in words(BUILDING)
    away, high = BOX.lamp_distance_cm, BOX.lamp_height_cm
    assert f"| {away:g} to the left and to the right of the plant, {high:g} above the soil," in BUILDING
    far, up = BOX.camera_distance_cm, BOX.camera_above_ground_cm
    assert f"| {far:g} before the plant, {up:g} above the ground, level" in BUILDING
    assert f"| {BOX.flash_above_ground_cm:g} above the ground, over the pot |" in BUILDING
    calibrating = (ROOT / "docs/how-to/calibrate.md").read_text(encoding="utf-8")
    x, y = CAMERA.anchor_px
    assert f"anchor_px = [{x:.1f}, {y:.1f}]\npx_per_cm = {CAMERA.px_per_cm:.2f}\n" in calibrating


@pytest.mark.parametrize(("name", "told"), [("wiring", "data: GPIO18, pin 12"), ("box", "camera sees 89 x 67")])
def test_a_picture_can_be_drawn_and_is_there(script: Script, name: str, told: str) -> None:
    figure = script(name).picture()
    assert told in [text.get_text() for axes in figure.axes for text in axes.texts]
    drawn = (ROOT / "docs" / "images" / f"{name}.png").read_bytes()
    assert re.match(rb"\x89PNG", drawn)
    size_px = tuple(int.from_bytes(drawn[at : at + 4], "big") for at in (16, 20))
    assert size_px == tuple(round(inches * figure.dpi) for inches in figure.get_size_inches())
