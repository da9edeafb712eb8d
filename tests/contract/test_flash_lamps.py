"""The same checks on every flash lamp that works here."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from enum import Enum
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from device_fakes import fake_box
from flora_common.errors import ConfigError, DeviceError, FlashDead
from flora_flash.backends import Lamp, NoLamp
from flora_flash.backends.gpio import GpioLamp
from flora_flash.backends.virtual import VirtualLamp


class Value(Enum):
    INACTIVE = 0
    ACTIVE = 1


class FakeGpio(ModuleType):
    """As much of gpiod 2 as is used, with one line that can be stuck or refused."""

    line = SimpleNamespace(Value=Value, Direction=SimpleNamespace(OUTPUT="output"))

    def __init__(self) -> None:
        super().__init__("gpiod")
        self.level, self.is_stuck, self.refusal = Value.INACTIVE, False, None
        self.released = False
        self.asked: dict[str, Any] = {}

    def LineSettings(self, **settings: Any) -> dict[str, Any]:
        return settings

    def request_lines(self, chip: str, *, consumer: str, config: dict[int, Any]) -> FakeGpio:
        if self.refusal is not None:
            raise self.refusal
        self.asked = {"chip": chip, "consumer": consumer, **config}
        return self

    def set_value(self, line: int, value: Value) -> None:
        assert line in self.asked
        if not self.is_stuck:
            self.level = value

    def get_value(self, line: int) -> Value:
        return self.level

    def release(self) -> None:
        self.released = True


@pytest.fixture
def gpio(monkeypatch: pytest.MonkeyPatch) -> FakeGpio:
    fake = FakeGpio()
    monkeypatch.setitem(sys.modules, "gpiod", fake)
    return fake


@pytest.fixture(params=["gpio", "virtual"])
def lamp(request: pytest.FixtureRequest, gpio: FakeGpio) -> Iterator[Lamp]:
    with fake_box() as box:
        lamp: Lamp = (
            VirtualLamp(box.address) if request.param == "virtual" else GpioLamp("/dev/gpiochip0", 17, active_low=False)
        )
        yield lamp
        lamp.close()


def test_it_says_what_it_does(lamp: Lamp) -> None:
    assert [lamp.switch(on) for on in (True, True, False, True, False)] == [True, True, False, True, False]
    assert lamp.excuse


def test_a_line_that_is_stuck_is_not_confirmed(gpio: FakeGpio) -> None:
    lamp = GpioLamp("/dev/gpiochip0", 17, active_low=True)
    assert gpio.asked[17] == {"direction": "output", "output_value": Value.INACTIVE, "active_low": True}
    gpio.is_stuck = True
    assert lamp.switch(True) is False
    lamp.close()
    assert gpio.released


@pytest.mark.parametrize("refusal", [OSError(16, "Device or resource busy"), ValueError("no such line")])
def test_a_line_that_cannot_be_had_is_one_clear_line(gpio: FakeGpio, refusal: Exception) -> None:
    gpio.refusal = refusal
    with pytest.raises(FlashDead, match="gpiochip0 line 17"):
        GpioLamp("/dev/gpiochip0", 17, active_low=False)


def test_without_the_library_the_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(ConfigError, match=r"install flora\[rig\]"):
        GpioLamp("/dev/gpiochip0", 17, active_low=False)
    monkeypatch.setitem(sys.modules, "gpiod", ModuleType("gpiod"))
    with pytest.raises(ConfigError, match="version 1"):
        GpioLamp("/dev/gpiochip0", 17, active_low=False)


def test_a_dead_bulb_in_the_box_is_not_confirmed() -> None:
    with fake_box() as box:
        lamp = VirtualLamp(box.address)
        box.flash_dead = True
        assert lamp.switch(True) is False
        box.refuse.add("flash")
        with pytest.raises(DeviceError):
            lamp.switch(True)
        lamp.close()


def test_no_lamp_never_confirms_light() -> None:
    lamp = NoLamp()
    assert (lamp.switch(True), lamp.switch(False)) == (False, False)
