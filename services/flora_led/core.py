"""Which lamp is to shine, how bright it may be, and what a chain's bytes say. Pure: time comes in.

The chain: 288 NeoPixels, both strips behind one pin because a Pi drives one only; 0 to 143 is the left lamp, 144 to 287
the right one; three bytes a pixel in the order green, red, blue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from flora_common.clock import NS
from flora_common.messages import LightCommand, Setup, Tick
from flora_common.open_loop import PAPERS_TURNS, OpenLoopSection, open_loop_side
from flora_common.runs import Light

PIXELS_PER_STRIP: Final = 144
PIXELS: Final = 2 * PIXELS_PER_STRIP
BYTES_PER_STRIP: Final = 3 * PIXELS_PER_STRIP
CHAIN_BYTES: Final = 2 * BYTES_PER_STRIP

CHANNEL_A: Final = 0.24 / 5.0 / 3.0
"""One colour of one pixel at full: 0.24 W at 5 V for full white (Wahby et al. 2018, "Bio-hybrid setup"), a third
each."""
IDLE_A: Final = 0.001
"""A pixel's controller alone, dark: about 1 mA (WS2812B at 5 V, an estimate from measurements by makers)."""

LEAST_BEATS: Final = 2.5
"""For so many intervals between photographs a command holds at least, so that one lost photograph darkens nothing."""
SAME_BEAT_S: Final = 1.0
"""Beats that were due so near together are one, told twice."""

Fallback = Literal["dark", "left", "right", "both", "hold", "open-loop"]
Rgb = tuple[int, int, int]
DARK: Final[Rgb] = (0, 0, 0)


def current_a(grb: bytes) -> float:
    """Current that the chain draws with these bytes."""
    return PIXELS * IDLE_A + sum(grb) / 255.0 * CHANNEL_A


def shown(light: Light, colour: Rgb, cap_a: float) -> tuple[Rgb, Rgb, float]:
    """Colours of the left and the right lamp, and the brightness that the cap leaves over (1 is uncapped).

    Args:
        light: which lamps.
        colour: red, green, blue at full brightness, 0 to 255.
        cap_a: most that both strips together may draw, idle current included.
    """
    left, right = light in ("left", "both"), light in ("right", "both")
    demand_a = PIXELS_PER_STRIP * (left + right) * sum(colour) / 255.0 * CHANNEL_A
    allowed_a = max(0.0, cap_a - PIXELS * IDLE_A)
    scale = min(1.0, allowed_a / demand_a) if demand_a > 0.0 else 1.0
    dimmed = (int(colour[0] * scale), int(colour[1] * scale), int(colour[2] * scale))  # down: never above the cap
    return dimmed if left else DARK, dimmed if right else DARK, scale


def lit(grb: bytes) -> Light:
    """What shines with these bytes."""
    left, right = any(grb[:BYTES_PER_STRIP]), any(grb[BYTES_PER_STRIP:])
    if left and right:
        return "both"
    return "left" if left else "right" if right else "dark"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is to shine, and why.

    Attributes:
        commanded: the last command's light; where there is none, that of the fallback.
        tick: the tick of the command that this answers; 0 for none.
        setup_step: the step of the setup run that this answers; 0 for none.
    """

    light: Light
    commanded: Light
    tick: int = 0
    fallback: bool = False
    setup_step: int = 0
    reason: str = ""


class Lease:
    """A command holds for ``lease_s`` of rig time from when it was given; then the fallback shines.

    Where photographs are so rare that a lamp would go out between two of them, it holds for :data:`LEAST_BEATS` of the
    beats that are heard. A setup run goes before commands while it is active.

    Args:
        lease_s: rig time.
        fallback: what shines without commands. ``open-loop`` needs neither stem nor flora-controller: lamps in turn, by
            the run's time as the last tick told it, by the rig's clock before the first tick.
        open_loop: the turns.
    """

    def __init__(self, lease_s: float, fallback: Fallback, open_loop: OpenLoopSection = PAPERS_TURNS) -> None:
        self._lease_ns = round(lease_s * NS)
        self._fallback = fallback
        self._open_loop = open_loop
        self._run_zero_ns = 0
        self._due_s: float | None = None
        self._apart_s = math.inf
        self._command: LightCommand | None = None
        self._given_ns: int | None = None
        self._setup: Setup | None = None

    def command(self, command: LightCommand, now_ns: int) -> None:
        """A command was heard; its age counts from its own time, and one from the future counts from now."""
        self._command = command
        self._given_ns = min(command.t_mono_ns, now_ns)

    def beat(self, tick: Tick) -> None:
        """A tick of the run was heard: it tells which time of the run it is, and the second one how often they come."""
        if tick.purpose != "run":
            return
        self._run_zero_ns = tick.t_mono_ns - round(tick.time_s * NS)
        # When it was due, not when it came: one late beat would make the next one seem to follow too soon for good.
        due_s = tick.time_s - tick.late_s
        apart_s = math.inf if self._due_s is None else due_s - self._due_s
        if apart_s < -SAME_BEAT_S:
            self._apart_s = math.inf  # another run
        elif apart_s > SAME_BEAT_S:
            # The shortest, for one that was not heard must not make commands live longer.
            self._apart_s = min(self._apart_s, apart_s / (1 + tick.skipped))
        self._due_s = due_s

    def setup(self, setup: Setup | None) -> None:
        """A setup run asks for lamps; None or inactive: it is over."""
        self._setup = setup if setup is not None and setup.active else None

    @property
    def in_setup(self) -> bool:
        return self._setup is not None

    @property
    def until_ns(self) -> int:
        """Rig time at which the present command's lease ends; 0 where there is none."""
        return 0 if self._given_ns is None else self._given_ns + self._held_ns

    @property
    def _held_ns(self) -> int:
        beats_s = LEAST_BEATS * self._apart_s
        return max(self._lease_ns, round(beats_s * NS)) if math.isfinite(beats_s) else self._lease_ns

    def wanted(self, now_ns: int) -> Wanted:
        """What is to shine now."""
        if self._setup is not None:
            return Wanted(self._setup.lamps, self._setup.lamps, setup_step=self._setup.step)
        command = self._command
        if command is not None and now_ns <= self.until_ns:
            return Wanted(command.light, command.light, tick=command.tick)
        last: Light = command.light if command else "dark"
        light = self._without_command(last, now_ns)
        lease_s = self._held_ns / NS
        reason = f"no command for more than {lease_s:g} s" if command else "no command yet"
        return Wanted(light, last if command else light, command.tick if command else 0, True, 0, reason)

    def _without_command(self, last: Light, now_ns: int) -> Light:
        if self._fallback == "hold":
            return last
        if self._fallback == "open-loop":
            return open_loop_side((now_ns - self._run_zero_ns) / NS, self._open_loop)
        return self._fallback
