"""A measured run beside what the extended law makes of its first stem: the features that are compared.

Compared are hourly means, which keep what matters over hours and are rid of most of what a camera adds.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.geometry import polyline_length
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose.courses import Course, moments_of
from flora_lab.diagnose.first_stem import first_stem
from flora_lab.diagnose.restarts import lost_from, restarts_of, short_gaps
from flora_lab.effects.effect import Change
from flora_lab.simulator.law import Stems
from flora_lab.simulator.measured import STEP_S, MeasuredRun
from flora_lab.simulator.shape import rods_through
from flora_lab.simulator.terms import (
    ACTIVITY,
    ADAPTATION_H,
    MEMORY,
    NEUTRAL,
    PEAK_H,
    RIGHT_TO_LEFT,
    SAG,
    SETTLING_H,
    SOFTNESS_CM,
    Driven,
    ExtendedLaw,
    Seen,
)
from flora_lab.simulator.tropism import LIGHT_HALF

FEATURES: Final = ((9, 0), (9, 1), (6, 0), (3, 0), (1, 0))
"""Point and axis of what is compared. Heights of the points between follow from the tip's."""
WINDOW_H: Final = 1.0
TOLD_STEPS: Final = 3
"""Simulated stems are told after every so many steps of five minutes: the mean over an hour is that of all, at a third
of the price. Over longer steps a lamp's answer is no straight line, and each is told."""
KNOT_H: Final = {"bias": 0.5, "gradient": 1.0, "growth": 1.0, "gain": 1.0}
USUAL: Final = {"bias": 0.0, "gradient": 0.0, "growth": 1.0, "gain": 1.0}
"""What drives are where nothing drives."""
_PUSH: Final = {"bias": 0.02, "gradient": 0.02, "growth": 0.2, "gain": 0.2}
_APART_H: Final = 4.0
"""Plants that are pushed at some time are simulated apart from the one that is not from so long before it at most."""
START_SD: Final = np.array([0.02, 0.04])
"""How well tilt and bow of a stem are measured from which a run begins, rad."""
_OF_ANY_TIME: Final = np.sqrt(12.0)
"""A length over the standard deviation of a place that is anywhere in it."""
TEMPERATURE: Final = "temperature_c"
_OF_A_KIND: Final = [ADAPTATION_H, PEAK_H, ACTIVITY, SOFTNESS_CM, SETTLING_H]
"""Terms that say of what kind another one is: they do not add up."""


@dataclass(frozen=True, slots=True)
class Lanes:
    """Plants to simulate side by side.

    Attributes:
        traits: shape (lanes, 9), what :attr:`Change.traits` adds included.
        start: tilt and bow of the first stem against what was measured, rad, shape (lanes, 2).
        changes: one per lane.
    """

    traits: Array
    start: Array
    changes: Sequence[Change]


@dataclass(frozen=True, slots=True)
class Answers:
    """How the features answer a push at each knot of each drive, about one plant.

    Attributes:
        to: drive (see :data:`KNOT_H`) to shape (m, knots), per unit of the drive.
        at_h: drive to the middles of its knots, shape (knots,).
        length_cm: of the stem in the middle of each bias knot.
        to_gaps: to what gaps leave unknown, each in units of how well it is known, shape (m, k): tilt and bow of stems
            from which the run begins anew, and when lamps changed.
    """

    to: dict[str, Array]
    at_h: dict[str, Array]
    length_cm: Array
    to_gaps: Array


class Scene:
    """One run, ready to be compared.

    Args:
        run: what was measured.
        law: with the places of the lamps, and the terms that the simulator was extended with.
        usual_c: the mean temperature of the runs that the simulator was learned from; None where it is not known.
    """

    def __init__(self, run: MeasuredRun, law: ExtendedLaw, usual_c: float | None = None) -> None:
        self.run = run
        self.law = law
        self.step_h = run.step_s / 3600.0
        self.per_window = max(1, round(WINDOW_H / self.step_h))
        # The mean of the rows that are told lies half of what is between them later: so do the windows.
        self._every = TOLD_STEPS if self.per_window % TOLD_STEPS == 0 and run.step_s <= STEP_S else 1
        late = (self._every - 1) // 2
        self.windows = (len(run) - 1 - late) // self.per_window
        if self.windows == 0:  # a run shorter than an hour is one window
            self._every, late, self.windows, self.per_window = 1, 0, 1, len(run) - 1
        self.steps = self.windows * self.per_window
        self._told_h = (np.arange(self.steps // self._every) + 1) * self._every * self.step_h
        self.light = run.light[: self.steps]
        self._recorded = run.light  # the plant may have seen what the record tells of after the last step
        self.time_h = (np.arange(self.windows) + 0.5) * self.per_window * self.step_h
        warm = run.covariates.get(TEMPERATURE)
        self.warmth_c = np.zeros(self.steps)
        if warm is not None and usual_c is not None:
            self.warmth_c = np.nan_to_num(warm[: self.steps] - usual_c)
        self.first_cm = first_stem(run.points_cm, run.step_s)
        self.restarts = restarts_of(run, self.steps, self._every)
        self._short_gaps = short_gaps(run, self.steps)
        self._stems = [(0, *rods_through(self.first_cm[None]))]
        self._stems += [(again.step, *rods_through(again.stem_cm[None])) for again in self.restarts]
        tip_x_cm, tip_y_cm = self.first_cm[-1]
        self.first = np.array([np.log(self._stems[0][1].sum()), np.arctan2(tip_x_cm, tip_y_cm)])
        rows = run.points_cm[1 + late : self.steps + 1 + late]
        self.is_seen = run.is_measured
        for again in self.restarts:
            self.is_seen[again.blind_from : again.step + 2] = False
        self.is_seen[lost_from(run, self.restarts) :] = False
        seen = self.is_seen[1 + late : self.steps + 1 + late].astype(np.float64)
        told = np.stack([np.nan_to_num(rows[:, point, axis]) for point, axis in FEATURES], axis=1)
        weight = seen.reshape(self.windows, self.per_window)
        count = weight.sum(axis=1)
        share = weight / np.maximum(count, 1.0)[:, None]
        # A row that is told stands for the measured ones about it.
        self._weight = share.reshape(self.windows, -1, self._every).sum(axis=2)
        means = np.einsum("wp,wpf->wf", share, told.reshape(self.windows, self.per_window, -1))
        self.is_told = np.repeat(count >= 0.25 * self.per_window, len(FEATURES))
        self.features = means.ravel()[self.is_told]
        self.window = np.repeat(np.arange(self.windows), len(FEATURES))[self.is_told]
        self.rows = count[self.window]  # measured ones, of which the feature is the mean
        self.feature = np.tile(np.arange(len(FEATURES)), self.windows)[self.is_told]
        self._courses: dict[Course, Array] = {}

    def under(self, change: Change) -> Scene:
        """The same run for a law that is changed so; what the change does to the record is left out."""
        other = copy.copy(self)
        other.law = ExtendedLaw(self.law.lamps, self.terms_with(change))
        return other

    def lamps_known_until_h(self, change: Change) -> float:
        """Hours from the start up to which the record tells what shone, if it runs before the lamps or behind them."""
        return float((len(self._recorded) * self.step_h + change.late_h) / max(1e-9, 1.0 - change.late_per_h))

    def up_to(self, end_h: float) -> Scene:
        """The same run, of which nothing is compared that was seen after some time."""
        other = copy.copy(self)
        is_kept = (self.window + 1) * self.per_window * self.step_h <= end_h
        other.is_told = self.is_told.copy()
        other.is_told[self.is_told] = is_kept
        other.features, other.window, other.rows, other.feature = (
            each[is_kept] for each in (self.features, self.window, self.rows, self.feature)
        )
        other.is_seen = self.is_seen & (np.arange(len(self.is_seen)) * self.step_h <= end_h)
        return other

    def shone(self, change: Change, recorded: Array | None = None) -> Array:
        """Levels of the lamps in each step as they were, shape (steps, 2); by another record than the run's, if any."""
        record = self._recorded if recorded is None else recorded
        return late_light(record, self.step_h, change.late_h, change.late_per_h)[: self.steps]

    @property
    def has_temperature(self) -> bool:
        """Whether the run tells how warm it was, and it was not always the same."""
        return bool(np.ptp(self.warmth_c) > 0.5)

    @property
    def sideways(self) -> float:
        """How much of the power of a swing across the tip is sideways: mean square of the cosine of its lean."""
        ahead = self.run.points_cm[:, -1] - self.run.points_cm[:, -3]
        ahead = ahead[np.isfinite(ahead).all(axis=1)]
        return float(np.mean(ahead[:, 1] ** 2 / np.maximum((ahead**2).sum(axis=1), 1e-12)))

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.features)

    def points(
        self,
        lanes: Lanes,
        drives: dict[str, Array] | None = None,
        every: int | None = None,
        bends: Array | None = None,
        lights: Sequence[Array] | None = None,
        since: Array | None = None,
    ) -> Array:
        """Stems as the camera shows them, shape (rows told, lanes, 10, 2).

        Args:
            lanes: which plants, under which changes.
            drives: by the names of :data:`USUAL`, shape (steps, lanes); as there where missing.
            every: steps from one row that is told to the next; as features need it where None.
            bends: tilt and bow of the stems from which it begins anew, rad, shape (restarts, lanes, 2).
            lights: what shone by the record, one of the shape of the run's per lane; that of the run where None.
            since: the step before which each is one with the first, ascending from 0, shape (lanes,): a plant is
                simulated once for all.
        """
        count = len(lanes.traits)
        given = self._pushed(lanes.changes, drives or {})
        every = every or self._every
        turn, scale, terms, light = self._changed(lanes.changes, every, lights)
        out = np.empty((self.steps // every, count, STEM_POINTS, 2))
        if bends is None:
            bends = np.zeros((len(self.restarts), count, 2))
        begins = np.zeros(count, dtype=np.int64) if since is None else since // every * every
        stands = {own[0]: (own, bend) for own, bend in zip(self._stems, [lanes.start, *bends], strict=True)}
        memory = np.zeros((1, *MEMORY))
        for start, stop in itertools.pairwise(sorted({*stands, *begins.tolist(), self.steps})):
            here = int(np.searchsorted(begins, start, side="right"))
            if start in stands:
                own, bend = stands[start]
                memory = np.concatenate([memory, np.repeat(memory[:1], here - len(memory), axis=0)])
                stems = self._standing(own, lanes.changes[:here], bend[:here], memory)
            elif here > len(stems.count):
                stems = stems.with_more_of_the_first(here - len(stems.count))
            now, told = slice(start, stop), slice(start // every, stop // every)
            shown = np.empty((told.stop - told.start, here, STEM_POINTS, 2))
            acting = {name: np.ascontiguousarray(given[name][now, :here]) for name in USUAL}
            self.law.advance_with(
                stems,
                lanes.traits[:here],
                terms[:here],
                Driven(light=light[now, :here], warmth_c=self.warmth_c[now], **acting),
                Seen(np.ascontiguousarray(turn[told, :here]), scale[:here]),
                self.step_h,
                every,
                shown,
            )
            out[told, :here], out[told, here:] = shown, shown[:, :1]
            memory = stems.memory
        return out

    def _pushed(self, changes: Sequence[Change], drives: Mapping[str, Array]) -> dict[str, Array]:
        """All drives, of shape (steps, lanes), with what is no term of the law; growth and pull end at nothing."""
        shape = (self.steps, len(changes))
        given = {name: drives.get(name, np.full(shape, usual)) for name, usual in USUAL.items()}
        pushed = {push.drive for change in changes for push in change.pushes}
        given |= {name: given[name].copy() for name in pushed}
        for lane, change in enumerate(changes):
            for push in change.pushes:
                given[push.drive][:, lane] += push.along(self.course(push.course))
        return given | {name: np.maximum(given[name], 0.0) for name in pushed if USUAL[name] > 0.0}

    def course(self, course: Course) -> Array:
        """What may be followed, in the middle of each step, shape (steps, columns)."""
        if course not in self._courses:
            middles_h = (np.arange(self.steps) + 0.5) * self.step_h
            self._courses[course] = course.of(moments_of(self, middles_h))
        return self._courses[course]

    def of_points(self, points: Array) -> Array:
        """The features of stems (rows told, lanes, 10, 2), shape (lanes, m)."""
        told = np.stack([points[:, :, point, axis] for point, axis in FEATURES], axis=2)
        told = told.reshape(self.windows, self.per_window // self._every, -1)
        means = np.einsum("wp,wpx->wx", self._weight, told).reshape(self.windows, points.shape[1], len(FEATURES))
        return np.asarray(means.transpose(1, 0, 2).reshape(points.shape[1], -1)[:, self.is_told])

    def terms_with(self, change: Change) -> Array:
        """The simulator's own terms with what is changed besides, shape (26,)."""
        own, more = self.law.terms, change.terms
        both = own + (more - NEUTRAL)
        both[RIGHT_TO_LEFT] = own[RIGHT_TO_LEFT] * more[RIGHT_TO_LEFT]
        both[_OF_A_KIND] = np.where(more == NEUTRAL, own, more)[_OF_A_KIND]
        if own[SAG] != 0.0 and more[SAG] == 0.0:  # how soft its stems are it knows
            both[SOFTNESS_CM] = own[SOFTNESS_CM]
        return np.asarray(both)

    def simulated(self, lanes: Lanes) -> Array:
        """Features, shape (lanes, m)."""
        return self.of_points(self.points(lanes))

    def tips(self, traits: Array, start: Array, change: Change) -> tuple[Array, Array]:
        """Measured minus simulated tip, sideways, after each step, and the simulated one, each of shape (steps,).

        The first is NaN where nothing was measured, and where a run is about to begin anew.
        """
        told = self.points(Lanes(traits[None] + change.traits, start[None], [change]), every=1)[:, 0, -1, 0]
        tip_cm = np.where(self.is_seen, self.run.points_cm[:, -1, 0], np.nan)
        return tip_cm[1 : self.steps + 1] - told, told

    def answers(self, traits: Array, change: Change) -> Answers:
        """How this run would answer what happens by chance, for a plant with these traits, shape (9,)."""
        per_knot = {name: max(1, round(knot_h / self.step_h)) for name, knot_h in KNOT_H.items()}
        knots = {name: -(-self.steps // steps) for name, steps in per_knot.items()}
        begins = np.concatenate([[0], *(np.arange(knots[name]) * per_knot[name] for name in KNOT_H)])
        order = np.argsort(begins, kind="stable")
        drives = {}
        column = 1
        for name in KNOT_H:
            push = np.full((self.steps, len(begins)), USUAL[name])
            push[np.arange(self.steps), column + np.arange(self.steps) // per_knot[name]] += _PUSH[name]
            drives[name] = push[:, order]
            column += knots[name]
        alike = np.repeat(traits[None], len(begins), axis=0)
        apart = max(1, round(_APART_H / self.step_h))
        lanes = Lanes(alike, np.zeros((len(begins), 2)), [change] * len(begins))
        told = self.points(lanes, drives, since=begins[order] // apart * apart)
        still, features = told[:, 0], np.empty((len(begins), self.size))
        features[order] = self.of_points(told)
        base, *pushed = np.split(features, np.cumsum([1, *knots.values()])[:-1])
        to = {name: (own - base).T / _PUSH[name] for name, own in zip(KNOT_H, pushed, strict=True)}
        at_h = {name: (np.arange(knots[name]) + 0.5) * per_knot[name] * self.step_h for name in KNOT_H}
        lengths = polyline_length(still)
        length_cm = np.interp(at_h["bias"], self._told_h, lengths)
        return Answers(to, at_h, length_cm, self._to_gaps(traits, change, base[0]))

    def _to_gaps(self, traits: Array, change: Change, base: Array) -> Array:
        """See :class:`Answers`; ``base`` are the features if all is as it is taken to be."""
        own, short = 2 * len(self.restarts), len(self._short_gaps)
        count = own + 2 * short
        if not count:
            return np.zeros((self.size, 0))
        bends = np.zeros((count, len(self.restarts), 2))
        bends.reshape(count, own)[np.arange(own), np.arange(own)] = np.tile(START_SD, len(self.restarts))
        lights = np.repeat(self._recorded[None], count, axis=0)
        for k, gap in enumerate(self._short_gaps):
            lights[own + k, gap.start : gap.stop] = gap.before
            lights[own + short + k, gap.start : gap.stop] = gap.after
        lanes = Lanes(np.repeat(traits[None], count, axis=0), np.zeros((count, 2)), [change] * count)
        told = self.of_points(self.points(lanes, bends=bends.transpose(1, 0, 2), lights=list(lights)))
        bent = told[:own] - base
        late = (told[own : own + short] - told[own + short :]) / _OF_ANY_TIME
        return np.asarray(np.concatenate([bent, late]).T)

    def _standing(
        self, stem: tuple[int, Array, Array, Array], changes: Sequence[Change], bend: Array, memory: Array
    ) -> Stems:
        """A stem of the record as it really stood: without what the camera does to it."""
        step, length, angle, count = stem
        lanes = len(changes)
        scale = np.array([change.scale for change in changes])
        arc = np.cumsum(length[0]) / length[0].sum() - 0.5
        turned = np.stack([change.turned_rad(np.array(step * self.step_h)) for change in changes])
        stood = np.repeat(angle, lanes, axis=0) + bend[:, :1] + bend[:, 1:] * arc[None] - turned[:, None]
        return Stems(np.repeat(length, lanes, axis=0) / scale[:, None], stood, np.repeat(count, lanes), memory)

    def _changed(
        self, changes: Sequence[Change], every: int, shone: Sequence[Array] | None
    ) -> tuple[Array, Array, Array, Array]:
        """Turn (steps, lanes), scale (lanes,), terms (lanes, 26) and light (steps, lanes, 2) of changes."""
        time_h = (np.arange(self.steps // every) + 1) * every * self.step_h
        turn = np.stack([c.turned_rad(time_h) for c in changes], axis=1)
        scale = np.array([c.scale for c in changes])
        terms = np.stack([self.terms_with(c) for c in changes])
        if shone is not None:
            own = [self.shone(c, one) for one, c in zip(shone, changes, strict=True)]
            return turn, scale, terms, np.stack(own, axis=1)
        lights = {when: self.shone(c) for when, c in {(c.late_h, c.late_per_h): c for c in changes}.items()}
        light = np.stack([lights[c.late_h, c.late_per_h] for c in changes], axis=1)
        return turn, scale, terms, light


def late_light(light: Array, step_h: float, late_h: float, per_h: float) -> Array:
    """What shone on the plant, if the record runs before it: levels (steps, 2).

    What shone before the first step and after the last is taken to be what shone in these. A step in which a lamp
    changes is told by the mean of the logarithm, which is what a plant sees: half a step of light is not half of it.
    """
    if late_h == 0.0 and per_h == 0.0:
        return light
    seen = np.log1p(light / LIGHT_HALF)
    steps = len(light)
    edges = np.arange(steps + 1) * step_h
    then = edges - late_h - per_h * edges
    dose = np.concatenate([np.zeros((1, 2)), np.cumsum(seen, axis=0) * step_h])
    beyond = np.minimum(then, 0.0)[:, None] * seen[0] + np.maximum(then - edges[-1], 0.0)[:, None] * seen[-1]
    told = np.stack([np.interp(then, edges, dose[:, lamp]) for lamp in range(2)], axis=1) + beyond
    means = np.diff(told, axis=0) / np.maximum(np.diff(then), 1e-9)[:, None]
    return np.asarray(LIGHT_HALF * np.expm1(np.clip(means, 0.0, None)))
