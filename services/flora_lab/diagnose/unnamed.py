"""What else may be at work where no cause of the catalogue is: which of the law's drives is off, and what it follows.

Something that nobody put into the catalogue still acts on growth, on the answer to light, or bends the stem, and it
does so by something: where the tip is, how high, at which time of day, after which hour. Each pair of a drive and such
a course is a rough model of what is left, linear in its size, and is weighed by the same evidence as a named cause;
the best is what a diagnosis says of what it has no name for. A sparse model from a dictionary, as Brunton, Proctor
and Kutz (2016) take for unknown dynamics, with one term.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.scene import Answers, Scene

Array = npt.NDArray[Any]

_SIZE: Final = {"gain": 0.4, "growth": 0.4, "bias": 0.03}
"""How large each drive is looked for, standard deviation."""
_OFF_CM: Final = 3.0
_LEAN_CM: Final = 5.0
_BESIDE_CM: Final = 2.0
_MIDDLE_HEIGHT_CM: Final = 13.0
_HEIGHT_CM: Final = 8.0
_DAY_H: Final = 24.0
_HISTORY_H: Final = 6.0
_AFTER_SWITCH_H: Final = 2.0
_EVERY_H: Final = 6.0
_SHADOW_H: Final = 8.0
_SHADOW_EVERY_H: Final = 3.0


@dataclass(frozen=True, slots=True)
class Moments:
    """A measured run at some times.

    Attributes:
        time_h: since the start, shape (k,).
        x_cm, height_cm: of the tip, shape (k,).
        side: 1 where only the right lamp shines, -1 where only the left one does, 0 else, shape (k,).
        history: the same, averaged over the last hours.
        since_h: since the lamps changed last.
    """

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
    """

    where: str
    drives: tuple[str, ...]
    of: Callable[[Moments], Array]


@dataclass(frozen=True, slots=True)
class Unnamed:
    """A drive that follows a course.

    Attributes:
        drive: of the law, see :data:`flora_lab.diagnose.scene.USUAL`.
        course: what it follows.
        gain: evidence beyond that without it, nats; that so many were tried is taken off.
        size: of each column of the course, shape (columns,).
    """

    drive: str
    course: Course
    gain: float
    size: Array

    @property
    def evidence(self) -> str:
        """How much speaks for it, in a clause."""
        return f"with it the runs are {times_as_probable(self.gain)}"

    @property
    def words(self) -> str:
        """What it means, in a clause."""
        if len(self.size) == 2:
            peak_h = float(np.arctan2(self.size[1], self.size[0]) % (2.0 * np.pi)) * _DAY_H / (2.0 * np.pi)
            size, where = float(np.hypot(*self.size)), f"{self.course.where}, most {peak_h:.0f} h after the start"
        else:
            size, where = float(self.size[0]), self.course.where
        if self.drive == "bias":
            return f"something bends stems to the {'right' if size > 0.0 else 'left'} {where}"
        subject = "the answer to light is" if self.drive == "gain" else "growth is"
        much = f"some {100.0 * abs(size):.0f} %" if abs(size) < 1.0 else "much"
        return f"{subject} {much} {'higher' if size > 0.0 else 'lower'} {where}"


def times_as_probable(nats: float) -> str:
    """Evidence as people read it."""
    return f"{times(nats)} as probable as without"


def times(nats: float) -> str:
    """How many times that is."""
    return f"e^{nats:.0f} times" if nats > 20.0 else f"{np.exp(nats):,.0f} times".replace(",", " ")


def _column(course: Callable[[Moments], Array]) -> Callable[[Moments], Array]:
    return lambda at: course(at)[:, None]


def _day(at: Moments) -> Array:
    turn = 2.0 * np.pi * at.time_h / _DAY_H
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _farther(side: float) -> Callable[[Moments], Array]:
    return _column(lambda at: np.maximum(side * at.x_cm - _BESIDE_CM, 0.0) / _LEAN_CM)


def _after(hour_h: float) -> Callable[[Moments], Array]:
    return _column(lambda at: (at.time_h > hour_h).astype(np.float64))


def _shadow(side: float, from_h: float) -> Callable[[Moments], Array]:
    def course(at: Moments) -> Array:
        return np.asarray((at.side == side) & ((at.time_h - from_h) % _DAY_H < _SHADOW_H), dtype=np.float64)

    return _column(course)


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
        for name, side in (("left", -1.0), ("right", 1.0))
    ),
    Course(
        f"for each {_HEIGHT_CM:.0f} cm that the tip is higher",
        ("gain", "growth", "bias"),
        _column(lambda at: (at.height_cm - _MIDDLE_HEIGHT_CM) / _HEIGHT_CM),
    ),
    Course("in a rhythm of 24 h", ("gain", "bias"), _day),
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
    *(
        Course(
            f"while the {name} lamp shines, from {from_h:.0f} to {(from_h + _SHADOW_H) % _DAY_H:.0f} h of each day",
            ("gain",),
            _shadow(side, from_h),
        )
        for name, side in (("left", -1.0), ("right", 1.0))
        for from_h in np.arange(0.0, _DAY_H, _SHADOW_EVERY_H)
    ),
)


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
    return Moments(time_h, x_cm, height_cm, side[at], history[at], since_h[at])


def unnamed(joint: Joint, found: Found, scenes: Sequence[Scene], answers: Sequence[Answers]) -> list[Unnamed]:
    """What might be at work beside what explains the runs so far, best first.

    Args:
        joint: the runs.
        found: the explanation so far, fitted.
        scenes, answers: of each run, about the plants of that fit.
    """
    at = [
        {drive: moments_of(scene, own.at_h[drive]) for drive in _SIZE}
        for scene, own in zip(scenes, answers, strict=True)
    ]
    tried = [(drive, course) for course in COURSES for drive in course.drives]
    out = []
    for drive, course in tried:
        pushed = [own.to[drive] @ course.of(here[drive]) for own, here in zip(answers, at, strict=True)]
        nats, size = joint.beside(found, pushed, _SIZE[drive])
        out.append(Unnamed(drive, course, nats - float(np.log(len(tried))), size))
    return sorted(out, key=lambda one: -one.gain)
