"""What else may be at work where no cause of the catalogue is: which of the law's drives is off, and what it follows.

Something that nobody put into the catalogue still acts on growth, on the answer to light, or bends the stem, and it
does so by something: where the tip is, how high, at which time of day, after which hour. Each pair of a drive and such
a course is a rough model of what is left, linear in its size, and is weighed by the same evidence as a named cause;
the best is what a diagnosis says of what it has no name for. A sparse model from a dictionary, as Brunton, Proctor
and Kutz (2016) take for unknown dynamics, with one term.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.courses import (
    CLOSER,
    FINER_PER_H,
    RHYTHMS,
    RHYTHMS_TRIED,
    SIZE,
    TRIED,
    Course,
    Pattern,
    Push,
    pushed_along,
    rhythm_of,
    with_own_times,
)
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.diagnose.joint import Found, Joint, evidence_for_last
from flora_lab.diagnose.scene import WINDOW_H, Answers, Scene
from flora_lab.diagnose.usual_pushes import UsualPushes, told_apart, told_of_all
from flora_lab.effects.effect import Change, Effect, Parameter, Values
from flora_lab.simulator.drives import DAY_H

_FITTED: Final = 3
"""So many of those that come to most where all is taken for linear are fitted in full."""
_RHYTHMS_FITTED: Final = 2
"""The same of rhythms."""
_OF_A_RUN: Final = 0.5
"""A rhythm has this share of the longest run for its period, at most."""
_ABOUT_PER_H: Final = 0.1
"""So far from where a swing shows in hourly means, 1/h, its phase and size may drift."""
_WORTH_A_FIT: Final = 2.0
"""Nats that they must come to there."""
_STEPS: Final = 10
_CERTAIN: Final = 30.0
"""Nats from which on it is there for certain, and is looked at once more for when it began and ended."""


@dataclass(frozen=True, slots=True)
class Unnamed:
    """A drive that follows a course.

    Attributes:
        drive: of the law, see :data:`flora_lab.diagnose.scene.USUAL`.
        course: what it follows.
        gain: evidence beyond that without it, nats; that so many were tried, and what is usual, is taken off.
        size: of each column of the course, shape (columns,).
        usual: nats that were taken off since healthy plants show as much.
        tried: of how many it counts as one.
        times: nats that were taken off since each run has times of its own, which nobody knew beforehand.
    """

    drive: str
    course: Course
    gain: float
    size: Array
    usual: float = 0.0
    tried: int = len(TRIED)
    times: float = 0.0

    @property
    def evidence(self) -> str:
        """How much speaks for it, in a clause."""
        return f"with it the runs are {times_as_probable(self.gain)}"

    @property
    def words(self) -> str:
        """What it means, in a clause."""
        size, where, period_h = float(np.linalg.norm(self.size)), self.course.where, self.course.period_h
        if period_h is not None and len(self.size) == 2:
            peak_h = float(np.arctan2(self.size[1], self.size[0]) % (2.0 * np.pi)) * period_h / (2.0 * np.pi)
            where += f", most {peak_h:.{0 if period_h == DAY_H else 1}f} h after the start"
        elif period_h is None:
            size = float(self.size[0])
        if self.course.holds:
            return f"something holds stems back {where}"
        if self.drive == "bias":
            to_right = "to the right" if size > 0.0 else "to the left"
            return f"something bends stems {'to and fro' if self.has_own_times else to_right} {where}"
        subject = "the answer to light is" if self.drive == "gain" else "growth is"
        much = f"some {100.0 * abs(size):.0f} %" if abs(size) < 1.0 else "much"
        more = "higher and lower by turns" if self.has_own_times else "higher" if size > 0.0 else "lower"
        return f"{subject} {much} {more} {where}"

    @property
    def has_own_times(self) -> bool:
        """Whether it is a rhythm that is at another place in each run."""
        return self.course.period_h is not None and len(self.size) == 1


def times_as_probable(nats: float) -> str:
    """Evidence as people read it."""
    return f"{times(nats)} as probable as without"


def times(nats: float) -> str:
    """How many times that is."""
    return f"e^{nats:.0f} times" if nats > 20.0 else f"{np.exp(nats):,.0f} times".replace(",", " ")


def unnamed(
    joint: Joint,
    found: Found,
    scenes: Sequence[Scene],
    answers: Sequence[Answers],
    usual: UsualPushes,
    swings_h: Sequence[float] = (),
) -> Unnamed:
    """What might be at work beside what explains the runs so far, the best.

    Args:
        joint: the runs.
        found: the explanation so far, fitted.
        scenes, answers: of each run, about the plants of that fit.
        usual: what healthy plants show.
    """
    best = _best_fit(joint, found, looked_at(joint, found, scenes, answers, usual))
    turning = rhythms(joint, found, scenes, answers, usual, swings_h)
    if turning:
        best = max(best, _best_fit(joint, found, turning[:_RHYTHMS_FITTED]), key=_gain)
    if best.gain < _CERTAIN:
        return best
    closer = [_best_fit(joint, found, looked_closer(joint, found, scenes, answers))]
    if best.course.period_h is not None:
        closer.append(_best_fit(joint, found, _finer(joint, found, scenes, answers, best)))
    return max([best, *closer], key=_gain)


def _gain(look: Unnamed) -> float:
    return look.gain


def _best_fit(joint: Joint, found: Found, looks: Sequence[Unnamed]) -> Unnamed:
    fits = [fitted(joint, found, look) for look in looks[:_FITTED] if look.gain > _WORTH_A_FIT]
    # What was fitted is not believed beyond that: growth that stops for ten hours is far from linear in anything.
    return max(fits or looks[:1], key=_gain)


def looked_at(
    joint: Joint, found: Found, scenes: Sequence[Scene], answers: Sequence[Answers], usual: UsualPushes
) -> list[Unnamed]:
    """All of it where everything is taken for linear about the explanation so far, best first."""

    def as_usual(which: int, told: InformationForm) -> float:
        return usual.nats(which, told, len(scenes))

    return _looks(joint, found, [pushed_along(*run) for run in zip(scenes, answers, strict=True)], TRIED, as_usual)


def looked_closer(joint: Joint, found: Found, scenes: Sequence[Scene], answers: Sequence[Answers]) -> list[Unnamed]:
    """The same for spells that begin and end at any time."""
    pushed = [pushed_along(*run, CLOSER) for run in zip(scenes, answers, strict=True)]
    return _looks(joint, found, pushed, CLOSER, lambda *_: 0.0, len(TRIED) + len(CLOSER))


def rhythms(
    joint: Joint,
    found: Found,
    scenes: Sequence[Scene],
    answers: Sequence[Answers],
    usual: UsualPushes,
    swings_h: Sequence[float] = (),
) -> list[Unnamed]:
    """The best rhythm of each drive, in which all runs keep time together or each its own, best first.

    All is linear, as in :func:`looked_at`. Neighbouring periods tell nearly the same, so that one of them is enough.
    What comes but once or twice in a run is no rhythm.
    """
    longest_h = _OF_A_RUN * max(float(scene.time_h[-1]) for scene in scenes)
    tried = [
        which
        for which, (_, course) in enumerate(RHYTHMS)
        if course.period_h is not None
        and course.period_h <= longest_h
        and not any(_is_of(swing_h, course.period_h) for swing_h in swings_h)
    ]

    def as_usual(which: int, told: InformationForm, *, has_own_times: bool) -> float:
        ask = usual.nats_apart if has_own_times else usual.nats
        return ask(len(TRIED) + tried[which], told, len(scenes))

    return _rhythms(joint, found, scenes, answers, [RHYTHMS[which] for which in tried], as_usual)


def _is_of(swing_h: float, period_h: float) -> bool:
    """Whether a rhythm is what means over an hour show of a swing: a slower one."""
    shown_per_h = abs(1.0 / WINDOW_H - 1.0 / swing_h)
    return 1.0 / period_h > shown_per_h - _ABOUT_PER_H


def _finer(
    joint: Joint, found: Found, scenes: Sequence[Scene], answers: Sequence[Answers], look: Unnamed
) -> list[Unnamed]:
    """The best of the periods about that of a rhythm: three days tell it more exactly than those are apart."""
    assert look.course.period_h is not None
    periods_h = 1.0 / (1.0 / look.course.period_h + FINER_PER_H)
    tried = [(look.drive, rhythm_of(float(period_h), (look.drive,))) for period_h in periods_h]
    looks = _rhythms(joint, found, scenes, answers, tried, lambda *_, **__: look.usual)
    return [one for one in looks if one.has_own_times == look.has_own_times]


def _rhythms(
    joint: Joint,
    found: Found,
    scenes: Sequence[Scene],
    answers: Sequence[Answers],
    tried: Sequence[Pattern],
    as_usual: Callable[..., float],
) -> list[Unnamed]:
    if not tried:
        return []
    pushed = [pushed_along(*run, tried) for run in zip(scenes, answers, strict=True)]
    runs = [(scene.run.name, scene.run.sha256) for scene in scenes]
    best: dict[tuple[str, bool], Unnamed] = {}
    both = zip(tried, told_of_all(joint, found, pushed), told_apart(joint, found, pushed), strict=True)
    for which, ((drive, course), together, apart) in enumerate(both):
        looks = [_together(drive, course, together, as_usual(which, together, has_own_times=False))]
        if len(scenes) > 1:
            looks.append(_apart(drive, course, runs, apart, as_usual(which, apart, has_own_times=True)))
        for look in looks:
            kind = drive, look.has_own_times
            best[kind] = max(best.get(kind, look), look, key=_gain)
    return sorted(best.values(), key=lambda one: -one.gain)


def _together(drive: str, course: Course, told: InformationForm, usual: float) -> Unnamed:
    sd = SIZE[drive]
    nats = told.nats(sd**2 * np.eye(len(told.pull))) - float(np.log(RHYTHMS_TRIED)) - usual
    return Unnamed(drive, course, nats, told.size(sd), usual, RHYTHMS_TRIED)


def _apart(drive: str, rhythm: Course, runs: Sequence[tuple[str, str]], told: InformationForm, usual: float) -> Unnamed:
    """A rhythm as large in each run as it seems to be there, told as one of the same size in all, each at its time."""
    sd, period_h = SIZE[drive], rhythm.period_h
    assert period_h is not None
    turn = np.arctan2(*told.size(sd).reshape(-1, 2).T[::-1])
    together = told.along(np.stack([np.cos(turn), np.sin(turn)], axis=1).ravel())
    size = together.size(sd)
    times = _price_of_times(told, turn, float(size[0]))
    nats = together.nats(sd**2 * np.eye(1)) - times - float(np.log(RHYTHMS_TRIED)) - usual
    course = with_own_times(rhythm, dict(zip(runs, (turn * period_h / (2.0 * np.pi)).tolist(), strict=True)))
    return Unnamed(drive, course, nats, size, usual, RHYTHMS_TRIED, times)


def _price_of_times(told: InformationForm, turn: Array, size: float) -> float:
    """Nats that it costs to have taken the likeliest time of each run, which may be any: Laplace's approximation."""
    price = 0.0
    for run, angle in enumerate(turn.tolist()):
        later = size * np.array([-np.sin(angle), np.cos(angle)])
        known = float(later @ told.information[2 * run : 2 * run + 2, 2 * run : 2 * run + 2] @ later)
        price += 0.5 * float(np.log(max(1.0, 2.0 * np.pi * known)))
    return price


def _looks(
    joint: Joint,
    found: Found,
    pushed: Sequence[Sequence[Array]],
    patterns: Sequence[Pattern],
    as_usual: Callable[[int, InformationForm], float],
    tried: int = len(TRIED),
) -> list[Unnamed]:
    out = []
    for which, told in enumerate(told_of_all(joint, found, pushed)):
        drive, course = patterns[which]
        sd, usual = SIZE[drive], as_usual(which, told)
        nats = told.nats(sd**2 * np.eye(len(told.pull))) - float(np.log(tried)) - usual
        out.append(_possible(Unnamed(drive, course, nats, told.size(sd), usual, tried)))
    return sorted(out, key=lambda one: -one.gain)


def fitted(joint: Joint, before: Found, look: Unnamed) -> Unnamed:
    """The same about its own size: what halves an answer, or stops growth, is far from linear about no such thing."""
    cause = Cause(_effect(look))
    reach = np.array([p.reach for p in cause.parameters])
    start = np.concatenate([before.coordinates, np.clip(look.size, reach[:, 0], reach[:, 1])])
    hypothesis = Hypothesis((*before.hypothesis.causes, cause))
    fit = joint.fit(Found(hypothesis, start, before.traits.copy(), before.start.copy()), _STEPS)
    size = hypothesis.shares(fit.coordinates)[-1]
    times = look.times
    if look.has_own_times:  # the larger a rhythm is, the better its times are known, and the more they cost
        times += len(joint.runs) * max(0.0, float(np.log(abs(size[0]) / max(abs(look.size[0]), 1e-9))))
    gain = evidence_for_last(before, fit) - look.usual - times
    return _possible(replace(look, gain=gain, size=size, times=times))


def _possible(told: Unnamed) -> Unnamed:
    """Without evidence where it would push stems away that it can only hold."""
    return replace(told, gain=-np.inf) if told.course.holds and not (told.size > 0.0).all() else told


def _effect(look: Unnamed) -> Effect:
    """As a cause with one number for each column of the course."""
    sd = SIZE[look.drive]
    parameters = tuple(
        Parameter(f"size_{column}", 0.0, -2.0 * sd, 2.0 * sd, "linear", "of what has no name", "none")
        for column in range(len(look.size))
    )

    def act(change: Change, values: Values) -> None:
        sizes = tuple(values[p.name] for p in parameters)
        change.pushes = (*change.pushes, Push(look.drive, look.course, sizes))

    return Effect(
        name=f"{look.drive} {look.course.where}",
        title=look.course.where,
        where="plant",
        parameters=parameters,
        forms=(act,),
        sentence=lambda _: look.words,
        prior=1.0 / look.tried,
    )
