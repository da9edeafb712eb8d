"""The same checks on every chain of pixels that works here."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from device_fakes import fake_box
from flora_common.errors import LampsDead
from flora_led.backends import Strips
from flora_led.backends.neopixel import NeoPixelStrips, is_pi
from flora_led.backends.virtual import VirtualStrips
from flora_led.core import BYTES_PER_STRIP, CHAIN_BYTES, DARK

ON_A_PI = [pytest.mark.pi, pytest.mark.skipif(not is_pi(), reason="needs a Raspberry Pi and its strips")]


@pytest.fixture(params=["neopixel", "virtual", pytest.param("pi", marks=ON_A_PI)])
def strips(request: pytest.FixtureRequest) -> Iterator[Strips]:
    if request.param == "virtual":
        with fake_box() as box:
            strips = VirtualStrips(box.address)
            yield strips
            strips.close()
    else:
        plain = NeoPixelStrips("D18", agnostic=request.param == "neopixel")
        yield plain
        plain.show(DARK, DARK)
        plain.close()


def test_bytes_are_green_red_blue_left_before_right(strips: Strips) -> None:
    grb = strips.show((1, 2, 3), (40, 50, 60))
    assert grb == bytes((2, 1, 3)) * 144 + bytes((50, 40, 60)) * 144


def test_dark_is_all_zero_and_the_lamps_do_not_mix(strips: Strips) -> None:
    assert strips.show(DARK, DARK) == bytes(CHAIN_BYTES)
    assert strips.show((255, 255, 255), DARK)[BYTES_PER_STRIP:] == bytes(BYTES_PER_STRIP)
    assert strips.show(DARK, (255, 255, 255))[:BYTES_PER_STRIP] == bytes(BYTES_PER_STRIP)


def test_the_virtual_box_gets_the_very_bytes() -> None:
    with fake_box() as box:
        strips = VirtualStrips(box.address)
        assert strips.show((9, 8, 7), DARK) == box.grb
        box.refuse.add("strips")
        with pytest.raises(LampsDead, match="strips is broken"):
            strips.show(DARK, DARK)
        strips.close()


def test_a_box_that_is_silent_is_lamps_dead() -> None:
    with fake_box() as box:
        box.silent.add("strips")
        strips = VirtualStrips(box.address, timeout_s=0.1)
        with pytest.raises(LampsDead, match="did not answer"):
            strips.show(DARK, DARK)
        strips.close()
