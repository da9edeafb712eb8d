"""One stem in, one lamp command and one state out. Pure: no clock, no file, no socket.

The same tick asked twice gives the same answer and counts once. Without a usable stem the last light is held for some
ticks, then the lamps alternate by time; a command given that way always says so.

A controller that has another one behind it must answer every stem and must not flicker, and the stem must stay in the
range of those that it was evolved with. One that fails is given up, and the one behind it decides in the same tick. One
in shadow is asked the same, and lights nothing.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.counted import counted
from flora_common.geometry import clearance_cm
from flora_common.messages import ControllerState, LightCommand, Stem
from flora_common.messages.catalogue import MOST_SHADOW_TICKS
from flora_common.messages.envelope import LONGEST_SENTENCE, as_sentence
from flora_common.open_loop import OpenLoopSection, open_loop_side
from flora_common.runs import Light
from flora_common.shapes import FARTHEST_CM, STEM_POINTS, Obstacle, Target
from flora_controller.acceptance import TaskRule, Trust
from flora_controller.lineup import Failure, Lineup, identity_of
from flora_controller.record import Record
from flora_controller.shadow import (
    MOST_SWITCHES_PER_H,
    MOST_TICKS_OUTSIDE,
    RANGE_MARGIN_CM,
    Shadow,
    Watch,
    failure,
)
from flora_controller.steering import (
    Decision,
    Steering,
    TipFollowerSection,
    View,
    WaypointSection,
)

BuiltIn = Literal["open-loop", "tip-follower", "waypoint", "dark"]


class ControllerSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[controller]``: what steers, whom it believes, and what happens where it is blind."""

    use: Annotated[str, msgspec.Meta(min_length=1, max_length=4096)] = "open-loop"
    """``open-loop``, ``tip-follower``, ``waypoint``, ``dark``, or the path of a ``.controller.json`` or
    ``.lights.toml`` file."""

    blind_hold_ticks: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 12
    """Ticks without a stem for which the last light is held; then the open-loop schedule runs."""

    stop_height_cm: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] = 21.0
    """Height of the tip at which the run counts as over."""

    trust: Trust = "if-signed"
    """Signature of a controller file that ``use`` names: a trusted one, a trusted one or none, not looked at; offers
    always need one. Light plans are never signed."""

    keys_dir: Annotated[str, msgspec.Meta(min_length=1, max_length=4096)] = "/etc/flora/keys"
    """Folder of the public keys, ``*.pub``, of those whose signature counts."""

    task: TaskRule = "same"
    """What a file's task must have in common with the run: target and obstacle (``same``), the target, or nothing."""

    shadow_ticks: Annotated[int, msgspec.Meta(ge=0, le=MOST_SHADOW_TICKS)] = 0
    """Ticks with a stem that every offer spends in shadow, whatever it asks for itself."""

    most_switches_per_h: Annotated[int, msgspec.Meta(ge=1, le=1000)] = MOST_SWITCHES_PER_H
    """Switches within an hour beyond which an offered controller is given up."""

    range_margin_cm: Annotated[float, msgspec.Meta(ge=0.0, le=500.0)] = RANGE_MARGIN_CM
    """How far a stem may go beyond those that a controller was evolved with before it is outside their range."""

    most_ticks_outside: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = MOST_TICKS_OUTSIDE
    """Stems in a row outside that range beyond which an offered controller is given up; one is never enough."""

    open_loop: OpenLoopSection = OpenLoopSection()
    tip_follower: TipFollowerSection = TipFollowerSection()
    waypoint: WaypointSection = WaypointSection()


class ControllerCore:
    """Asks a rule, keeps count, and judges the plant.

    Args:
        lineup: the rule, what is behind it, what is in its shadow.
        section: blind policy and stop rule.
        target, obstacle: the task, where there is one.
        record: where the last start was left.

    Attributes:
        failures: who failed in the last tick that was answered, the first one first.
    """

    def __init__(
        self,
        lineup: Lineup,
        section: ControllerSection,
        *,
        target: Target | None,
        obstacle: Obstacle | None,
        record: Record,
    ) -> None:
        self._section = section
        self._target = target
        self._obstacle = obstacle
        self.record = record
        self.failures: list[Failure] = []
        self.use(lineup)

    @property
    def steering(self) -> Steering:
        """The rule whose decisions shine."""
        return self._lineup.steering

    @property
    def shadow_ticks(self) -> int:
        """How many ticks the one in shadow has answered."""
        return 0 if self.record.shadow is None else self.record.shadow.ticks

    def use(self, lineup: Lineup) -> None:
        """Steer by these from now on. What the plant did so far stays; what the other rule did is dropped."""
        self._lineup = lineup
        identity, shadow, trial = identity_of(lineup.steering), lineup.shadow, self.record.shadow
        if self.record.controller != identity:
            self.record = msgspec.structs.replace(
                self.record,
                controller=identity,
                memory={},
                watch=Watch(),
                decisions=0,
                switches=0,
                best_fitness=None,
            )
        if shadow is None:
            trial = None
        elif trial is None or trial.sha256 != shadow.sha256:
            trial = Shadow(shadow.sha256)
        self.record = msgspec.structs.replace(self.record, shadow=trial)

    def on_stem(self, stem: Stem, *, note: str = "") -> tuple[LightCommand, ControllerState] | None:
        """Answer a stem.

        Args:
            stem: of the present tick, found or not.
            note: what else people are to be told, such as why a controller file was refused.

        Returns:
            Command and state; for a tick that was answered before, the very same again; None for an older one.
        """
        self.failures = []
        last = self.record
        if stem.tick < last.tick or stem.tick == 0:
            return None
        if stem.tick == last.tick and last.command is not None and last.said is not None:
            return last.command, last.said
        if last.command is not None and stem.time_s < last.command.time_s:
            # Numbers go on and times do not: a run that was begun under the name of the last, with another plant.
            self.record = Record(run=last.run)
            self.use(self._lineup)
        points = usable_points(stem)
        self._judge(stem, points)
        decision, blind = self._decide(stem, points)
        light = decision.light or "dark"
        shadowed = self._ask_shadow(stem, points, light)
        command = LightCommand(
            tick=stem.tick,
            light=light,
            time_s=stem.time_s,
            output=min(max(decision.output, 0.0), 1.0),
            blind=blind,
            reason=as_sentence(decision.reason),
        )
        record = msgspec.structs.replace(
            self.record,
            tick=stem.tick,
            light=light,
            switches=self.record.switches + (last.light is not None and last.light != light),
            command=command,
        )
        over = record.run_over or (decision.over and f"run over: {decision.over}")
        said = self._state(record, stem, points, note, shadowed, over)
        self.record = msgspec.structs.replace(record, said=said)
        return command, said

    def _decide(self, stem: Stem, points: FloatArray | None) -> tuple[Decision, bool]:
        decision = self._ask(stem, points)
        while points is not None and self._lineup.before:
            outside = self._outside(self.steering, points)
            watch = self.record.watch.after(decision, stem.time_s, outside)
            why = self._failure(decision, watch, outside)
            if not why:
                self.record = msgspec.structs.replace(self.record, watch=watch)
                break
            self._return(why)
            decision = self._ask(stem, points)
        record = self.record
        blind_ticks = record.blind_ticks + 1 if points is None or decision.light is None else 0
        self.record = msgspec.structs.replace(record, blind_ticks=blind_ticks)
        if decision.light is None:
            return self._blindly(stem.time_s, decision.reason, record.light, blind_ticks), True
        self.record = msgspec.structs.replace(self.record, memory=dict(decision.memory), decisions=record.decisions + 1)
        return decision, False

    def _ask(self, stem: Stem, points: FloatArray | None) -> Decision:
        if points is None and self.steering.needs_stem:
            return Decision(None, reason=f"{stem.outcome}: {stem.reason}" if stem.reason else stem.outcome)
        return self.steering.decide(View(stem.time_s, points, self.record.light), self.record.memory)

    def _return(self, why: str) -> None:
        """Give up the one that steers for the one behind it."""
        lineup = self._lineup
        self.failures.append(Failure(lineup.steering.name, lineup.steering.sha256, why, in_shadow=False))
        self.use(Lineup(lineup.before[0], lineup.before[1:], lineup.shadow, lineup.shadow_ticks))

    def _ask_shadow(self, stem: Stem, points: FloatArray | None, shone: Light) -> Decision | None:
        """What the one in shadow would have lit; None where it was not asked, or has failed."""
        lineup, trial = self._lineup, self.record.shadow
        if lineup.shadow is None or trial is None or points is None:
            return None
        decision = lineup.shadow.decide(View(stem.time_s, points, self.record.light), {})
        outside = self._outside(lineup.shadow, points)
        trial = trial.after(decision, stem.time_s, outside, shone)
        why = self._failure(decision, trial.watch, outside)
        if why:
            self.failures.append(Failure(lineup.shadow.name, trial.sha256, why, in_shadow=True))
            self.use(Lineup(lineup.steering, lineup.before))
            return None
        self.record = msgspec.structs.replace(self.record, shadow=trial)
        return decision

    def _outside(self, steering: Steering, points: FloatArray) -> str:
        """How a stem is outside of what this rule was evolved with, in a clause; empty where it is not.

        From the stop height on the run is over, and growing on is no failure.
        """
        if steering.stem_range is None or points[-1, 1] >= self._section.stop_height_cm:
            return ""
        far_cm, way = steering.stem_range.beyond(points)
        if far_cm <= self._section.range_margin_cm:
            return ""
        return f"{far_cm:.1f} cm {way} than any that it was evolved with"

    def _failure(self, decision: Decision, watch: Watch, outside: str) -> str:
        section = self._section
        return failure(
            decision,
            watch,
            outside,
            most_switches_per_h=section.most_switches_per_h,
            most_ticks_outside=section.most_ticks_outside,
        )

    def _blindly(self, time_s: float, why: str, light: Light | None, blind_ticks: int) -> Decision:
        since = f"blind for {counted(blind_ticks, 'tick')} ({why})"[: LONGEST_SENTENCE - 80]
        if light is not None and blind_ticks <= self._section.blind_hold_ticks:
            output = 1.0 if light == "right" else 0.0
            return Decision(light, output, f"{since}: the last light is held")
        side = open_loop_side(time_s, self._section.open_loop)
        hours = self._section.open_loop.hours
        return Decision(side, float(side == "right"), f"{since}: open-loop schedule, every {hours:g} h in turn")

    def _judge(self, stem: Stem, points: FloatArray | None) -> None:
        """Fitness, target, collision and the paper's stop rules, from a stem that was found."""
        if points is None:
            return
        record = self.record
        x, y = float(points[-1, 0]), float(points[-1, 1])
        over = record.run_over
        if self._target is not None:
            now = self._target.fitness(x, y)
            best = now if record.best_fitness is None else max(now, record.best_fitness)
            reached = record.target_reached or self._target.contains(x, y)
            record = msgspec.structs.replace(record, best_fitness=best, target_reached=reached)
        if self._obstacle is not None:
            near = clearance_cm(points, self._obstacle)
            least = near if record.clearance_cm is None else min(near, record.clearance_cm)
            record = msgspec.structs.replace(record, clearance_cm=least)
            if near == 0.0 and record.collided_at_s is None:
                record = msgspec.structs.replace(record, collided_at_s=stem.time_s)
                over = over or f"run over: the stem touched the obstacle at {stem.time_s / 3600:.1f} h"
        if y >= self._section.stop_height_cm:
            reached_cm = self._section.stop_height_cm
            over = over or f"run over: the tip reached {reached_cm:g} cm at {stem.time_s / 3600:.1f} h"
        self.record = msgspec.structs.replace(record, run_over=over)

    def _state(
        self,
        record: Record,
        stem: Stem,
        points: FloatArray | None,
        note: str,
        shadowed: Decision | None,
        over: str,
    ) -> ControllerState:
        tip = None if points is None else (float(points[-1, 0]), float(points[-1, 1]))
        shadow, trial = self._lineup.shadow, record.shadow
        return ControllerState(
            tick=stem.tick,
            controller=as_sentence(self.steering.name),
            sha256=self.steering.sha256,
            time_s=stem.time_s,
            fitness=None if tip is None or self._target is None else self._target.fitness(*tip),
            best_fitness=record.best_fitness,
            tip_cm=tip,
            target_reached=record.target_reached,
            collided=record.collided_at_s is not None,
            collided_at_s=record.collided_at_s,
            clearance_cm=record.clearance_cm,
            blind_ticks=record.blind_ticks,
            decisions=record.decisions,
            switches=record.switches,
            run_over=bool(over),
            reason=as_sentence("; ".join(part for part in (*map(str, self.failures), note, over) if part)),
            shadow="" if shadow is None else as_sentence(shadow.name),
            shadow_sha256="" if shadow is None else shadow.sha256,
            shadow_output=None if trial is None or shadowed is None else trial.output,
            shadow_light=None if shadowed is None else shadowed.light,
            shadow_ticks=0 if trial is None else trial.ticks,
            shadow_ticks_left=0 if trial is None else max(0, self._lineup.shadow_ticks - trial.ticks),
            shadow_agree=None if trial is None else trial.agree,
        )


def usable_points(stem: Stem) -> FloatArray | None:
    """Ten points of a stem that was found, in a sensible place; None for every other outcome."""
    if stem.outcome != "ok" or len(stem.points_cm) != STEM_POINTS:
        return None
    points = np.array(stem.points_cm, dtype=np.float64)
    # farther points are not judged; written so that NaN fails it too
    return points if (np.abs(points) <= FARTHEST_CM).all() else None
