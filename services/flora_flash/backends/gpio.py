"""A lamp behind a relay or transistor at a GPIO line, by libgpiod's own Python binding (version 2).

``get_value`` on a Pi reads the level of the pin itself, not the last value written: a shorted or overloaded line is
seen. The kernel gives the line back when the process dies by whatever cause.
"""

from __future__ import annotations

from flora_common.errors import ConfigError, FlashDead


class GpioLamp:
    """One output line.

    Args:
        chip: device file, such as ``/dev/gpiochip0``.
        line: number of the line on that chip; on a Pi the BCM number.
        active_low: the lamp is on while the line is low.
    """

    def __init__(self, chip: str, line: int, *, active_low: bool) -> None:
        try:
            import gpiod  # noqa: PLC0415 - on the Pi only
        except ImportError as problem:
            raise ConfigError('[flash] backend = "gpio" needs the package gpiod, version 2: install flora[rig]') from (
                problem
            )
        if not hasattr(gpiod, "request_lines"):
            raise ConfigError('[flash] backend = "gpio" needs gpiod version 2; this is version 1, from apt')
        self.excuse = f"line {line} of {chip} stayed at its old level"
        self._name = f"{chip} line {line}"
        self._line = line
        self._value = gpiod.line.Value
        settings = gpiod.LineSettings(
            direction=gpiod.line.Direction.OUTPUT, output_value=gpiod.line.Value.INACTIVE, active_low=active_low
        )
        try:
            self._request = gpiod.request_lines(chip, consumer="flora-flash", config={line: settings})
        except (OSError, ValueError) as problem:
            raise FlashDead(f"{self._name}: cannot be used as an output ({problem})") from problem

    def switch(self, on: bool) -> bool:
        try:
            self._request.set_value(self._line, self._value.ACTIVE if on else self._value.INACTIVE)
            return bool(self._request.get_value(self._line) == self._value.ACTIVE)
        except OSError as problem:
            raise FlashDead(f"{self._name}: {problem}") from problem

    def close(self) -> None:
        self._request.release()
