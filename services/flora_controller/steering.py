"""What decides which lamp shines: the common form of all controllers, and the built-in ones.

A steering rule is a pure function of what is seen now and of a small memory that it hands back; whoever calls it keeps
the memory, on the disk if need be. None of them reads a clock or a file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, Protocol

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.geometry import clearance_cm, polyline_length
from flora_common.light_plan import ReadPlan
from flora_common.open_loop import HOUR_S, OTHER, OpenLoopSection, Side, open_loop_side
from flora_common.runs import Light
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange

Memory = Mapping[str, float]

Cm = Annotated[float, msgspec.Meta(ge=0.0, le=50.0)]

ROOM_SHARE: Final = {False: 0.6, True: 0.8}
"""Share of the distance with which a stem passed the obstacle that is left to it: where guarding begins, and ends."""


class TipFollowerSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[controller.tip_follower]``."""

    deadband_cm: Cm = 0.5
    """The lamp stays while the tip is this near to the target's x."""


class WaypointSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[controller.waypoint]``."""

    rise_cm: Cm = 0.8
    """The tip turns to the target when it is this far above the obstacle."""
    guard_cm: Cm = 1.2
    """A stem nearer to the obstacle than this is steered away, whatever the target wants."""
    release_cm: Cm = 1.7
    """A stem that was steered away is left alone again when it is this far from the obstacle."""
    deadband_cm: Cm = 0.5
    """The lamp stays while the tip is this near to the target's x."""


@dataclass(frozen=True, slots=True)
class View:
    """What a rule sees.

    Attributes:
        time_s: since the run's start.
        points_cm: shape (10, 2), anchor first, tip last; None where there is no stem.
        last_light: what shines now; None before the first decision.
    """

    time_s: float
    points_cm: FloatArray | None
    last_light: Light | None


@dataclass(frozen=True, slots=True)
class Decision:
    """What a rule answers.

    Attributes:
        light: None is no decision: the blind policy takes over.
        output: a network's own output; 0 for left and 1 for right elsewhere.
        reason: one clause for people.
        memory: to be handed in next time.
        over: why the run is over, in a clause; empty while it is not.
    """

    light: Light | None
    output: float = 0.0
    reason: str = ""
    memory: Memory = field(default_factory=dict)
    over: str = ""


class Steering(Protocol):
    """A rule.

    Attributes:
        name: for people and records.
        sha256: of its file; empty for built-in ones.
        needs_stem: whether it can say nothing without a stem.
        stem_range: the stems that it was evolved with; None where that is not known, or no matter.
    """

    @property
    def name(self) -> str: ...

    @property
    def sha256(self) -> str: ...

    @property
    def needs_stem(self) -> bool: ...

    @property
    def stem_range(self) -> StemRange | None: ...

    def decide(self, view: View, memory: Memory) -> Decision: ...


def _towards(side: Side, reason: str, memory: Memory | None = None) -> Decision:
    return Decision(side, 0.0 if side == "left" else 1.0, reason, memory if memory is not None else {})


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """Both lamps in turn, by time alone (Wahby et al. 2018, "Dataset experiments": every six hours)."""

    section: OpenLoopSection
    name: str = "open-loop"
    sha256: str = ""
    needs_stem: bool = False
    stem_range: StemRange | None = None

    def decide(self, view: View, memory: Memory) -> Decision:
        side = open_loop_side(view.time_s, self.section)
        return _towards(side, f"schedule: every {self.section.hours:g} h in turn")


@dataclass(frozen=True, slots=True)
class Planned:
    """Light by a plan, by time alone; at its end the run is over, and the plan's light goes on."""

    read: ReadPlan
    needs_stem: bool = False
    stem_range: StemRange | None = None

    @property
    def name(self) -> str:
        return self.read.name

    @property
    def sha256(self) -> str:
        return self.read.sha256

    def decide(self, view: View, memory: Memory) -> Decision:
        light, hours = self.read.light_at(view.time_s), self.read.plan.hours
        over = f"the light plan's {hours:g} h have passed" if view.time_s >= hours * HOUR_S else ""
        return Decision(light, float(light == "right"), f"light plan: {light}", over=over)


@dataclass(frozen=True, slots=True)
class Dark:
    """No lamp: for setting up."""

    name: str = "dark"
    sha256: str = ""
    needs_stem: bool = False
    stem_range: StemRange | None = None

    def decide(self, view: View, memory: Memory) -> Decision:
        return Decision("dark", 0.0, "dark by configuration")


@dataclass(frozen=True, slots=True)
class TipFollower:
    """The lamp on the target's side of the tip (closed loop of Hofstadler et al. 2017, as the paper uses it)."""

    target: Target
    section: TipFollowerSection
    name: str = "tip-follower"
    sha256: str = ""
    needs_stem: bool = True
    stem_range: StemRange | None = None

    def decide(self, view: View, memory: Memory) -> Decision:
        if view.points_cm is None:
            return Decision(None, reason="no stem")
        return _follow(view, self.target, self.section.deadband_cm)


@dataclass(frozen=True, slots=True)
class Waypoint:
    """Round the obstacle, then to the target.

    Where the straight way from anchor to target is clear, the tip follows the target at once. Else the lamp on the far
    side of the obstacle shines until the tip is above it, which leaves a stem that leans away from the obstacle and
    stiffens there; only then the tip is turned to the target (what the evolved controller of the paper's reality
    experiment did). All the time a stem that comes too near to the obstacle is steered away.
    """

    target: Target
    obstacle: Obstacle
    section: WaypointSection
    name: str = "waypoint"
    sha256: str = ""
    needs_stem: bool = True
    stem_range: StemRange | None = None

    def decide(self, view: View, memory: Memory) -> Decision:
        if view.points_cm is None:
            return Decision(None, reason="no stem")
        away = passing_side(self.target, self.obstacle, margin_cm=self.section.guard_cm)
        blocked = way_is_blocked(self.target, self.obstacle, margin_cm=self.section.guard_cm)
        tip_y = float(view.points_cm[-1, 1])
        near_cm = clearance_cm(view.points_cm, self.obstacle)
        room_cm = memory.get("room_cm", math.inf if not blocked else -1.0)
        if room_cm < 0.0:
            if tip_y < self.obstacle.top_cm + self.section.rise_cm:
                return _towards(away, f"away from the obstacle, past it on the {away}", memory)
            room_cm = near_cm
        # A stem that could not but pass near by is not held off for ever: it may use a part of the room that it has.
        guarding = memory.get("guarding", 0.0) > 0.0
        wanted_cm = self.section.release_cm if guarding else self.section.guard_cm
        guarding = near_cm < min(wanted_cm, ROOM_SHARE[guarding] * room_cm)
        kept: Memory = {"guarding": float(guarding)} | ({"room_cm": room_cm} if blocked else {})
        if guarding:
            return _towards(away, f"{near_cm:.1f} cm from the obstacle, away from it", kept)
        chosen = _follow(view, self.target, self.section.deadband_cm)
        return Decision(chosen.light, chosen.output, chosen.reason, kept)


def _follow(view: View, target: Target, deadband_cm: float) -> Decision:
    assert view.points_cm is not None
    off_cm = float(view.points_cm[-1, 0]) - target.x_cm
    if abs(off_cm) <= deadband_cm and view.last_light in ("left", "right"):
        return _towards(view.last_light, f"tip {abs(off_cm):.1f} cm beside the target, lamp stays")
    side: Side = "left" if off_cm > 0 else "right"
    return _towards(side, f"tip {abs(off_cm):.1f} cm {OTHER[side]} of the target")


def way_is_blocked(target: Target, obstacle: Obstacle, *, margin_cm: float) -> bool:
    """Whether the straight line from anchor to target comes nearer to the obstacle than ``margin_cm``."""
    return clearance_cm([(0.0, 0.0), (target.x_cm, target.y_cm)], obstacle) < margin_cm


def passing_side(target: Target, obstacle: Obstacle, *, margin_cm: float) -> Side:
    """The side of the obstacle on which the stem is to pass: the shorter way round, where the straight one is blocked.

    Where it is clear, it is the side on which the straight line runs.
    """
    if not way_is_blocked(target, obstacle, margin_cm=margin_cm):
        share = np.clip(obstacle.y_cm / target.y_cm, 0.0, 1.0) if target.y_cm > 0 else 1.0
        return "right" if share * target.x_cm >= obstacle.x_cm else "left"
    by_left = _detour_cm(target, obstacle, obstacle.left_cm - margin_cm)
    by_right = _detour_cm(target, obstacle, obstacle.right_cm + margin_cm)
    return "left" if by_left < by_right else "right"


def _detour_cm(target: Target, obstacle: Obstacle, x_cm: float) -> float:
    way = np.array([(0.0, 0.0), (x_cm, obstacle.bottom_cm), (x_cm, obstacle.top_cm), (target.x_cm, target.y_cm)])
    return float(polyline_length(way))
