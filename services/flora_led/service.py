"""Commands in, light out, and what is really lit said aloud."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

from flora_common.app import App, Timer
from flora_common.errors import LampsDead
from flora_common.messages import Lamps, LightCommand, Setup, Tick
from flora_common.open_loop import OpenLoopSection
from flora_common.setup_run import SETUP_LEASE_S
from flora_led.backends import Strips
from flora_led.core import DARK, Fallback, Lease, Wanted, current_a, lit, shown

AGAIN_S: Final = 5.0
SHORTEST_LOOK_S: Final = 1.0
LONGEST_LOOK_S: Final = 30.0

Level = Annotated[int, msgspec.Meta(ge=0, le=255)]


class LedSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[led]``. The lease guards the plant, so it is in rig time."""

    backend: Literal["neopixel", "virtual"] = "neopixel"
    """The chain of 288 pixels, or that of the virtual grow box."""

    pin: Annotated[
        str,
        msgspec.Meta(
            pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=32, extra={"words": "the name of a pin, such as D18"}
        ),
    ] = "D18"
    """The chain's data line, by its name in Blinka's ``board``."""

    twin: str = ""
    """For ``virtual``: where flora-twin answers; empty for that of ``[rig.clock]``."""

    colour: tuple[Level, Level, Level] = (90, 60, 255)
    """Red, green and blue of a lit lamp; bending answers to blue, the rest lets the plant and people see."""

    current_cap_a: Annotated[float, msgspec.Meta(ge=0.5, le=100.0)] = 8.0
    """The most that both strips together may draw, by 48 mA for a pixel at full white and 1 mA for a dark one; all
    colours are scaled down to it."""

    lease_s: Annotated[float, msgspec.Meta(gt=0.0, le=604_800.0)] = 900.0
    """Seconds of rig time for which a command holds; not less than two and a half times the time between photographs,
    once two were asked for."""

    fallback: Fallback = "dark"
    """What shines before the first command and when the lease of the last one is over; ``hold`` keeps its light."""

    open_loop: OpenLoopSection = OpenLoopSection()


class LedService:
    """One command after the other, each confirmed from the bytes.

    Args:
        app: the running service.
        strips: where the bytes go.
    """

    def __init__(self, app: App[LedSection], strips: Strips) -> None:
        self._app = app
        self._strips = strips
        self._lease = Lease(app.config.lease_s, app.config.fallback, app.config.open_loop)
        self._ready = False
        self._now: Wanted | None = None
        """What shines; None where the last write failed."""
        self._timers: dict[str, Timer] = {}
        app.on(LightCommand, self._command)
        app.on(Setup, self._setup)
        app.on(Tick, self._beat)
        app.on_ready(self._resume)
        app.on_exit(self._leave_dark)
        self._strips.show(DARK, DARK)

    def _resume(self) -> None:
        """The bus has handed over what it kept."""
        self._ready = True
        self._shine(self._wanted())
        self._look_later()

    def _wanted(self) -> Wanted:
        return self._lease.wanted(self._app.clock.mono_ns())

    def _command(self, command: LightCommand) -> None:
        self._lease.command(command, self._app.clock.mono_ns())
        if not self._lease.in_setup:
            self._shine(self._wanted())

    def _setup(self, setup: Setup) -> None:
        was_active = self._lease.in_setup
        self._lease.setup(setup)
        self._cancel("setup")
        if setup.active:
            self._timers["setup"] = self._app.after(SETUP_LEASE_S, self._setup_silent)
        if setup.active or was_active:
            self._shine(self._wanted())

    def _setup_silent(self) -> None:
        self._app.log.warning("setup_run_silent", after_s=SETUP_LEASE_S)
        self._lease.setup(None)
        self._shine(self._wanted())

    def _beat(self, tick: Tick) -> None:
        """What shines without fresh commands is told again with each tick, so that it does not look like silence."""
        self._lease.beat(tick)
        wanted = self._wanted()
        is_unanswered = wanted.setup_step == 0 and tick.tick > wanted.tick + 1
        if wanted != self._now or wanted.fallback or is_unanswered:
            self._shine(wanted)

    def _look(self) -> None:
        """Has the lease run out?"""
        wanted = self._wanted()
        if wanted != self._now:
            self._shine(wanted)

    def _look_later(self) -> None:
        """By real time too: the beat may be what has died."""
        self._look()
        real_s = self._app.clock.real_s_until(self._lease.until_ns)
        self._app.after(min(LONGEST_LOOK_S, max(SHORTEST_LOOK_S, real_s)), self._look_later)

    def _shine(self, wanted: Wanted) -> None:
        """Write, read back, confirm; a command that shines already is only confirmed again."""
        if not self._ready:
            return
        self._cancel("again")
        left, right, scale = shown(wanted.light, self._app.config.colour, self._app.config.current_cap_a)
        try:
            grb = self._strips.show(left, right)
        except LampsDead as problem:
            self._now = None
            self._app.trouble("strips", str(problem))
            self._timers["again"] = self._app.after(AGAIN_S, self._look)
            return
        self._now = wanted
        self._app.trouble("strips", "")
        is_over = wanted.fallback and self._lease.until_ns > 0
        self._app.trouble("lease", f"{wanted.reason}: fallback {wanted.light}" if is_over else "")
        self._app.publish(
            Lamps(
                tick=wanted.tick,
                lit=lit(grb),
                commanded=wanted.commanded,
                current_a=current_a(grb),
                scale=scale,
                fallback=wanted.fallback,
                setup_step=wanted.setup_step,
                reason=wanted.reason,
            )
        )

    def _leave_dark(self) -> None:
        try:
            grb = self._strips.show(DARK, DARK)
        except LampsDead as problem:
            self._app.log.problem("strips_not_dark", str(problem))
        else:
            self._say_dark(grb)
        self._strips.close()

    def _say_dark(self, grb: bytes) -> None:
        """The bus keeps our last word: it must not say for ever that a lamp shines. No answer to any tick."""
        if self._ready:
            commanded = self._wanted().commanded
            self._app.publish(
                Lamps(
                    lit=lit(grb),
                    commanded=commanded,
                    current_a=current_a(grb),
                    fallback=True,
                    reason="flora-led has been stopped",
                )
            )

    def _cancel(self, key: str) -> None:
        timer = self._timers.pop(key, None)
        if timer is not None:
            timer.cancel()
