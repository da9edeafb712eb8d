"""A controller on trial: asked beside the one that shines, and watched for what no plant asks for. Pure.

What gives a controller away is that it has no answer, that it flickers, or that the stem has left the range of those
that it was evolved with.

How often may it switch? The paper's best controller alternates quickly while it leads the tip past the obstacle's edge,
so quick alternation alone is no fault. The quickest that makes sense is a network that lights the lamp on the target's
side of the tip, with no deadband. On 12 virtual plants over 72 hours, with 0.6 mm of noise on every point (about what
this rig measures with), it switched at most 7 times in any hour, with 1.5 mm at most 9 times.
:data:`MOST_SWITCHES_PER_H` is above both, and below the 12 that five-minute ticks allow: a network that changes its
mind at every tick is found out within the hour.

How far outside of its range? The range is what the simulated plants could reach under any light, and others are no
copies of them. Of 40 virtual plants over 96 hours, under the lamps in turn and under both built-in rules, none was for
three stems in a row more than 2.7 cm outside the range of the typical plant of a simulator that was learned from nine
others; nor more than 2.3 cm where evolution had ended 2.5 cm below the height at which the rig's run does.
:data:`RANGE_MARGIN_CM` is above both. A wrong reading, or two, must not switch: hence :data:`MOST_TICKS_OUTSIDE`.
"""

from __future__ import annotations

from typing import Final

import msgspec

from flora_common.runs import Light
from flora_controller.steering import Decision

HOUR_S: Final = 3600.0
MOST_SWITCHES_PER_H: Final = 10
RANGE_MARGIN_CM: Final = 3.0
MOST_TICKS_OUTSIDE: Final = 2


class Watch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a controller decided lately.

    Attributes:
        light: its last decision.
        switched_at_s: when it changed its mind within the last hour, seconds since the run's start.
        outside_ticks: how many stems in a row, up to the last one, were outside its range.
    """

    light: Light | None = None
    switched_at_s: tuple[float, ...] = ()
    outside_ticks: int = 0

    def after(self, decision: Decision, time_s: float, outside: str) -> Watch:
        """With one more decision; one without a lamp changes nothing.

        Args:
            decision: its answer to a stem.
            time_s: since the run's start.
            outside: how the stem is outside its range; empty where it is not.
        """
        if decision.light is None:
            return self
        recent = tuple(at_s for at_s in self.switched_at_s if time_s - HOUR_S < at_s <= time_s)
        if self.light is not None and self.light != decision.light:
            recent = (*recent, time_s)
        return Watch(decision.light, recent, self.outside_ticks + 1 if outside else 0)


def failure(
    decision: Decision, watch: Watch, outside: str, *, most_switches_per_h: int, most_ticks_outside: int
) -> str:
    """Why a controller must not go on, in a clause; empty where it may.

    Args:
        decision: its answer to a stem that was found.
        watch: that decision included.
        outside: how that stem is outside its range, in a clause; empty where it is not.
        most_switches_per_h: more within one hour are a failure.
        most_ticks_outside: more stems in a row outside its range are a failure.
    """
    if decision.light is None:
        return decision.reason or "no answer"
    if len(watch.switched_at_s) > most_switches_per_h:
        return f"it switched {len(watch.switched_at_s)} times within an hour, at most {most_switches_per_h} are allowed"
    if watch.outside_ticks > most_ticks_outside:
        return (
            f"{watch.outside_ticks} stems in a row were outside its range, this one {outside}; at most "
            f"{most_ticks_outside} are allowed"
        )
    return ""


class Shadow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far the trial of a controller has come.

    Attributes:
        sha256: of its file.
        ticks: how many it has answered.
        agreed: in how many of them it wanted the lamp that shone.
        output: its last one.
        watch: of what it would have lit.
    """

    sha256: str
    ticks: int = 0
    agreed: int = 0
    output: float | None = None
    watch: Watch = Watch()

    def after(self, decision: Decision, time_s: float, outside: str, shone: Light) -> Shadow:
        """With one more answer.

        Args:
            decision: what it would have lit.
            time_s: since the run's start.
            outside: how the stem is outside its range; empty where it is not.
            shone: what was lit.
        """
        if decision.light is None:
            return self
        return Shadow(
            self.sha256,
            self.ticks + 1,
            self.agreed + (decision.light == shone),
            min(max(decision.output, 0.0), 1.0),
            self.watch.after(decision, time_s, outside),
        )

    @property
    def agree(self) -> float | None:
        """Share of its answers that were the lamp that shone."""
        return self.agreed / self.ticks if self.ticks else None
