"""What else may be at work where no cause of the catalogue is: which of the law's drives is off, and what it follows.

Something that nobody put into the catalogue still acts on growth, on the answer to light, or bends the stem, and it
does so by something: where the tip is, how high, at which time of day, after which hour. Each pair of a drive and such
a course is a rough model of what is left, linear in its size, and is weighed by the same evidence as a named cause;
the best is what a diagnosis says of what it has no name for. A sparse model from a dictionary, as Brunton, Proctor
and Kutz (2016) take for unknown dynamics, with one term.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.courses import (
    CLOSER,
    SIZE,
    TRIED,
    Pattern,
    Push,
    pushed_along,
)
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.diagnose.joint import Found, Joint, evidence_for_last
from flora_lab.diagnose.nameless import Unnamed, taken_for_linear
from flora_lab.diagnose.scene import Answers, Scene
from flora_lab.diagnose.unnamed_rhythms import finer, rhythms
from flora_lab.diagnose.usual_pushes import UsualPushes, told_of_all
from flora_lab.effects.effect import Change, Effect, Parameter, Values

_FITTED: Final = 3
"""So many of those that come to most where all is taken for linear are fitted in full."""
_RHYTHMS_FITTED: Final = 2
"""The same of rhythms."""
_WORTH_A_FIT: Final = 2.0
"""Nats that they must come to there."""
_STEPS: Final = 10
_CERTAIN: Final = 30.0
"""Nats from which on it is there for certain, and is looked at once more for when it began and ended."""


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
        swings_h: periods with which tips swing: what hourly means keep of that is no rhythm.
    """
    best = _best_fit(joint, found, looked_at(joint, found, scenes, answers, usual))
    turning = rhythms(joint, found, scenes, answers, usual, swings_h)
    if turning:
        best = max(best, _best_fit(joint, found, turning[:_RHYTHMS_FITTED]), key=_gain)
    if best.gain < _CERTAIN:
        return best
    closer = [_best_fit(joint, found, looked_closer(joint, found, scenes, answers, best))]
    if best.course.period_h is not None:
        closer.append(_best_fit(joint, found, finer(joint, found, scenes, answers, best)))
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


def looked_closer(
    joint: Joint, found: Found, scenes: Sequence[Scene], answers: Sequence[Answers], look: Unnamed
) -> list[Unnamed]:
    """The same for spells that begin and end at any time, of the drive that is off.

    What healthy plants show of each is not known: it is taken to be what they show of ``look``.
    """
    spells = [pattern for pattern in CLOSER if pattern[0] == look.drive]
    pushed = [pushed_along(*run, spells) for run in zip(scenes, answers, strict=True)]
    return _looks(joint, found, pushed, spells, lambda *_: look.usual, len(TRIED) + len(CLOSER))


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
        out.append(_possible(taken_for_linear(drive, course, told, as_usual(which, told), tried)))
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
        times += len(joint.runs) * float(np.log(max(1.0, abs(size[0]) / max(abs(look.size[0]), 1e-9))))
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
