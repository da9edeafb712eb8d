"""What something that no term of the law has may follow: where the tip is, how high, the hour, what light there was.

A course is told by the measured run, so that it is known before anything is simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.drives import DAY_H

if TYPE_CHECKING:
    from flora_lab.diagnose.scene import Answers, Scene


_OFF_CM: Final = 3.0
_LEAN_CM: Final = 5.0
_BESIDE_CM: Final = 2.0
_HELD_CM: Final = (0.5, 0.7, 1.0, 1.4, 2.0)
_GIVES_CM: Final = 0.5
_STRETCHED_CM: Final = 2.0
_MIDDLE_HEIGHT_CM: Final = 13.0
_HEIGHT_CM: Final = 8.0
_HISTORY_H: Final = 6.0
_AFTER_SWITCH_H: Final = 2.0
_EVERY_H: Final = 6.0
_SPELL_H: Final = 12.0
_CLOSER_H: Final = 3.0
_LONGEST_SPELL_H: Final = 30.0
_SPELLS_H: Final = tuple(
    (float(hour_h), lasts_h)
    for lasts_h in (6.0, 12.0, 18.0)
    for hour_h in np.arange(_EVERY_H, 72.0 - lasts_h, _EVERY_H)
)
"""When those that are looked at first begin, and how long they last."""
_SHADOW_H: Final = 8.0
_SHADOW_EVERY_H: Final = 3.0
_SIDES: Final = (("left", -1.0), ("right", 1.0))
_IN_H, _FEWEST_TURNS, _MOST_TURNS = 144.0, 8, 41
"""Rhythms turn so often in so many hours: three days tell frequencies twice as far apart."""


@dataclass(frozen=True, slots=True)
class Moments:
    """A measured run at some times.

    Attributes:
        of: name and SHA-256 of the run.
        time_h: since the start, shape (k,).
        x_cm, height_cm: of the tip, shape (k,).
        side: 1 where only the right lamp shines, -1 where only the left one does, 0 else, shape (k,).
        history: the same, averaged over the last hours.
        since_h: since the lamps changed last.
    """

    of: tuple[str, str]
    time_h: Array
    x_cm: Array
    height_cm: Array
    side: Array
    history: Array
    since_h: Array


@dataclass(frozen=True, slots=True)
class Course:
    """What a drive may follow.

    Attributes:
        where: in words, after "lower" or "higher".
        drives: that may follow it; others that do are causes of the catalogue.
        of: the course at some moments, shape (k, columns).
        holds: whether it is of something that stems lean against or hang from, which pushes them back to the middle and
            nowhere else: sizes are positive.
        period_h: of a rhythm; None of anything else. Its columns are cosine and sine, or, where each run has its own
            time, the one that is known of it.
        peaks_h: where each run has its own time, names of runs and when it is highest in them.
    """

    where: str
    drives: tuple[str, ...]
    of: Callable[[Moments], Array]
    holds: bool = False
    period_h: float | None = None
    peaks_h: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Push:
    """One of the law's drives, pushed along a course.

    Attributes:
        drive: see :data:`flora_lab.diagnose.scene.USUAL`.
        course: what it follows.
        sizes: of each column of the course.
    """

    drive: str
    course: Course
    sizes: tuple[float, ...]

    def along(self, columns: Array) -> Array:
        """What it adds to the drive, shape (k,), where the course is ``columns``, shape (k, columns)."""
        return np.asarray(columns @ np.array(self.sizes))


def _column(course: Callable[[Moments], Array]) -> Callable[[Moments], Array]:
    return lambda at: course(at)[:, None]


def rhythm_of(period_h: float, drives: tuple[str, ...]) -> Course:
    """What is highest every so many hours."""

    def turning(at: Moments) -> Array:
        turn = 2.0 * np.pi * at.time_h / period_h
        return np.stack([np.cos(turn), np.sin(turn)], axis=1)

    return Course(f"in a rhythm of {period_h:.3g} h", drives, turning, period_h=period_h)


def with_own_times(rhythm: Course, peak_h: Mapping[tuple[str, str], float]) -> Course:
    """A rhythm that has its own time in each run, as what a plant does by itself has: of one column.

    Args:
        rhythm: one of those of :data:`RHYTHMS`.
        peak_h: by :attr:`Moments.of`, when it is highest in that run.
    """
    assert rhythm.period_h is not None
    period_h = rhythm.period_h

    def turning(at: Moments) -> Array:
        return np.cos(2.0 * np.pi * (at.time_h - peak_h[at.of]) / period_h)

    where = f"{rhythm.where}, in each run at times of its own"
    peaks_h = tuple((name, round(own_h % period_h, 1)) for (name, _), own_h in peak_h.items())
    return replace(rhythm, where=where, of=_column(turning), peaks_h=peaks_h)


def _farther(side: float) -> Callable[[Moments], Array]:
    return _column(lambda at: np.maximum(side * at.x_cm - _BESIDE_CM, 0.0) / _LEAN_CM)


def _held(at_cm: float, sides: tuple[float, ...]) -> Callable[[Moments], Array]:
    """What a wall pushes, at most: as much as it takes, within what it gives and points are off."""
    return _column(
        lambda at: np.sum([-side * np.clip((side * at.x_cm - at_cm) / _GIVES_CM, 0.0, 1.0) for side in sides], axis=0)
    )


def _tied(slack_cm: float) -> Callable[[Moments], Array]:
    """What a string pulls, the more the farther off the middle the tip is; no tip on one goes far."""
    return _column(lambda at: -np.sign(at.x_cm) * np.clip(np.abs(at.x_cm) - slack_cm, 0.0, _STRETCHED_CM))


def _after(hour_h: float) -> Callable[[Moments], Array]:
    return _column(lambda at: (at.time_h > hour_h).astype(np.float64))


def _spell(from_h: float, lasts_h: float) -> Callable[[Moments], Array]:
    return _column(lambda at: ((at.time_h > from_h) & (at.time_h <= from_h + lasts_h)).astype(np.float64))


def _while_lit(side: float, course: Callable[[Moments], Array]) -> Callable[[Moments], Array]:
    return lambda at: np.where((at.side == side)[:, None], course(at), 0.0)


def _shadow(from_h: float) -> Callable[[Moments], Array]:
    return _column(lambda at: ((at.time_h - from_h) % DAY_H < _SHADOW_H).astype(np.float64))


def _in_spell(from_h: float, lasts_h: float) -> Course:
    where = f"from {from_h:.0f} to {from_h + lasts_h:.0f} h after the start"
    return Course(where, ("gain", "growth", "bias"), _spell(from_h, lasts_h))


COURSES: Final = (
    Course(
        "where the tip is far off the middle",
        ("gain", "growth"),
        _column(lambda at: at.x_cm**2 / (at.x_cm**2 + _OFF_CM**2)),
    ),
    Course(
        f"for each {_LEAN_CM:.0f} cm that the tip leans towards the lamp that shines",
        ("gain", "growth"),
        _column(lambda at: at.side * at.x_cm / _LEAN_CM),
    ),
    Course(
        f"for each {_LEAN_CM:.0f} cm that the tip is to the right",
        ("gain", "growth", "bias"),
        _column(lambda at: at.x_cm / _LEAN_CM),
    ),
    *(
        Course(
            f"for each {_LEAN_CM:.0f} cm that the tip is farther {name} than {_BESIDE_CM:.0f} cm",
            ("gain", "growth", "bias"),
            _farther(side),
        )
        for name, side in _SIDES
    ),
    *(
        Course(f"where the tip is farther {name} than {at_cm:g} cm", ("bias",), _held(at_cm, sides), holds=True)
        for at_cm in _HELD_CM
        for name, sides in (*((name, (side,)) for name, side in _SIDES), ("off the middle", (-1.0, 1.0)))
    ),
    *(
        Course(
            f"for each cm that the tip is farther off the middle than {at_cm:g} cm", ("bias",), _tied(at_cm), holds=True
        )
        for at_cm in _HELD_CM
    ),
    Course(
        f"for each {_HEIGHT_CM:.0f} cm that the tip is higher",
        ("gain", "growth", "bias"),
        _column(lambda at: (at.height_cm - _MIDDLE_HEIGHT_CM) / _HEIGHT_CM),
    ),
    rhythm_of(DAY_H, ("gain", "bias")),
    Course("after hours of light from the right", ("gain", "growth"), _column(lambda at: at.history)),
    Course(
        "in the first hours after a switch of the lamps",
        ("growth",),
        _column(lambda at: np.exp(-at.since_h / _AFTER_SWITCH_H)),
    ),
    *(
        Course(f"from {hour_h:.0f} h after the start on", ("gain", "growth", "bias"), _after(hour_h))
        for hour_h in np.arange(_EVERY_H, 72.0, _EVERY_H)
    ),
    *(_in_spell(hour_h, lasts_h) for hour_h, lasts_h in _SPELLS_H),
    *(
        Course(
            f"while the {name} lamp shines, from {hour_h:.0f} to {hour_h + _SPELL_H:.0f} h after the start",
            ("gain",),
            _while_lit(side, _spell(hour_h, _SPELL_H)),
        )
        for name, side in _SIDES
        for hour_h in np.arange(_EVERY_H, 72.0 - _SPELL_H, _EVERY_H)
    ),
    *(
        Course(
            f"while the {name} lamp shines, from {from_h:.0f} to {(from_h + _SHADOW_H) % DAY_H:.0f} h of each day",
            ("gain",),
            _while_lit(side, _shadow(from_h)),
        )
        for name, side in _SIDES
        for from_h in np.arange(0.0, DAY_H, _SHADOW_EVERY_H)
    ),
)

SIZE: Final = {"gain": 0.4, "growth": 0.4, "bias": 0.03}
"""How large a push of each drive is looked for, standard deviation."""
Pattern = tuple[str, Course]
"""A drive, and the course along which it may be pushed."""
TRIED: Final[tuple[Pattern, ...]] = tuple((drive, course) for course in COURSES for drive in course.drives)
"""All pushes."""
LOOKED: Final = float(np.log(len(TRIED)))
"""The price of having looked at so many, in nats."""
RHYTHMS: Final[tuple[Pattern, ...]] = tuple(
    (drive, course)
    for turns in range(_FEWEST_TURNS, _MOST_TURNS + 1)
    for course in [rhythm_of(_IN_H / turns, tuple(SIZE))]
    for drive in course.drives
)
"""Rhythms other than that of the day, evenly in frequency: what is quicker is a swing of the tip, which hourly means do
not show, and what is slower is told from nothing that comes but once."""
KNOWN: Final[tuple[Pattern, ...]] = (*TRIED, *RHYTHMS)
"""All of which it is known how much of it healthy plants show."""
FINER_PER_H: Final = np.arange(-3, 4) / (4.0 * _IN_H)
"""How far from the frequency of a rhythm that is there for certain it is looked for once more, 1/h."""
RHYTHMS_TRIED: Final = 20 * len(RHYTHMS)
"""What has no name is a rhythm in one case of ten, and runs keep time together in every other one: each counts as one
of so many."""
CLOSER: Final[tuple[Pattern, ...]] = tuple(
    (drive, course)
    for lasts_h in np.arange(_CLOSER_H, _LONGEST_SPELL_H + _CLOSER_H, _CLOSER_H)
    for hour_h in np.arange(0.0, 72.0 - lasts_h, _CLOSER_H)
    if (hour_h, lasts_h) not in _SPELLS_H
    for course in [_in_spell(hour_h, lasts_h)]
    for drive in course.drives
)
"""All other spells, at which it is looked where there is something for certain: that has begun and ended when it has,
and what follows a plant's ways by chance describes it better than a spell of another length."""


def pushed_along(scene: Scene, answers: Answers, tried: Sequence[Pattern] = TRIED) -> list[Array]:
    """What a unit of each push does to a run's features, arrays of shape (m, columns of the course).

    Args:
        scene: the run.
        answers: of it, about some plant.
        tried: the pushes.
    """
    at = {drive: moments_of(scene, answers.at_h[drive]) for drive in SIZE}
    return [answers.to[drive] @ course.of(at[drive]) for drive, course in tried]


def moments_of(scene: Scene, time_h: Array) -> Moments:
    """A measured run at some times, shape (k,)."""
    points = scene.run.points_cm[: scene.steps + 1, -1]
    seen = np.isfinite(points[:, 0])
    rows_h = np.arange(len(points)) * scene.step_h
    x_cm, height_cm = (np.interp(time_h, rows_h[seen], points[seen, axis]) for axis in range(2))
    side = np.sign(scene.light[:, 1] - scene.light[:, 0])
    changed = np.any(np.diff(scene.light, axis=0, prepend=scene.light[:1]) != 0.0, axis=1)
    steps = np.arange(scene.steps)
    since_h = (steps - np.maximum.accumulate(np.where(changed, steps, 0))) * scene.step_h
    keep, history = np.exp(-scene.step_h / _HISTORY_H), np.empty(scene.steps)
    now = 0.0
    for step in range(scene.steps):
        now = keep * now + (1.0 - keep) * side[step]
        history[step] = now
    at = np.minimum((time_h / scene.step_h).astype(np.int64), scene.steps - 1)
    return Moments((scene.run.name, scene.run.sha256), time_h, x_cm, height_cm, side[at], history[at], since_h[at])
