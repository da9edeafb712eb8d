"""flora-led: choose the strips, and hand them to the service."""

from __future__ import annotations

from collections.abc import Sequence

from flora_common.app import App
from flora_common.config import RigSection
from flora_common.service import Action, run_service
from flora_led.backends import Strips
from flora_led.core import DARK
from flora_led.service import LedSection, LedService


def open_strips(rig: RigSection, config: LedSection) -> Strips:
    """The strips that the configuration names."""
    if config.backend == "virtual":
        from flora_led.backends.virtual import VirtualStrips  # noqa: PLC0415 - only what is used is loaded

        return VirtualStrips(config.twin or rig.clock.twin)
    from flora_led.backends.neopixel import NeoPixelStrips  # noqa: PLC0415

    return NeoPixelStrips(config.pin)


def build(app: App[LedSection]) -> None:
    if app.config.backend == "neopixel":
        from flora_led.backends.neopixel import is_pi  # noqa: PLC0415

        if not is_pi():
            app.log.warning("no_pi", reason="no Raspberry Pi: the driver runs, but its bytes light nothing")
    LedService(app, open_strips(app.rig, app.config))


def dark(rig: RigSection, config: LedSection) -> None:
    """One shot: both lamps off, for systemd when the service has died."""
    strips = open_strips(rig, config)
    strips.show(DARK, DARK)
    strips.close()


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-led",
        LedSection,
        build,
        argv=argv,
        description="Drives both LED strips and says what is really lit.",
        actions=[Action("--dark", "switch both lamps off and end", dark)],
    )
