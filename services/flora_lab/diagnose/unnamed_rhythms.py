"""Rhythms that have no name: of growth, of the answer to light or of a push, in step in all runs or each at its time.

What a plant does by itself keeps the plant's own time: by a clock that plants do not share nothing is left of it in the
mean. So each rhythm is looked at with one time for all runs, and with a time of each run's own, which has its price.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.courses import (
    FINER_PER_H,
    RHYTHMS,
    RHYTHMS_TRIED,
    SIZE,
    TRIED,
    Course,
    Pattern,
    pushed_along,
    rhythm_of,
    with_own_times,
)
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.nameless import Unnamed, taken_for_linear
from flora_lab.diagnose.scene import WINDOW_H, Answers, Scene
from flora_lab.diagnose.usual_pushes import UsualPushes, told_apart, told_of_all

_OF_A_RUN: Final = 0.5
"""A rhythm has this share of the longest run for its period, at most."""
_ABOUT_PER_H: Final = 0.1
"""So far from where a swing shows in hourly means, 1/h, its phase and size may drift."""


def rhythms(
    joint: Joint,
    found: Found,
    scenes: Sequence[Scene],
    answers: Sequence[Answers],
    usual: UsualPushes,
    swings_h: Sequence[float] = (),
) -> list[Unnamed]:
    """The best rhythm of each drive, in which all runs keep time together or each its own, best first.

    All is taken for linear about the explanation so far. Neighbouring periods tell nearly the same, so that one of them
    is enough. What comes but once in a run is no rhythm.
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


def finer(
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
        usual = as_usual(which, together, has_own_times=False)
        looks = [taken_for_linear(drive, course, together, usual, RHYTHMS_TRIED)]
        if len(scenes) > 1:
            looks.append(_apart(drive, course, runs, apart, as_usual(which, apart, has_own_times=True)))
        for look in looks:
            kind = drive, look.has_own_times
            best[kind] = max(best.get(kind, look), look, key=lambda one: one.gain)
    return sorted(best.values(), key=lambda one: -one.gain)


def _apart(drive: str, rhythm: Course, runs: Sequence[tuple[str, str]], told: InformationForm, usual: float) -> Unnamed:
    """A rhythm as large in each run as it seems to be there, told as one of the same size in all, each at its time."""
    sd, period_h = SIZE[drive], rhythm.period_h
    assert period_h is not None
    turn = np.arctan2(*told.size(sd).reshape(-1, 2).T[::-1])
    together = told.along(np.stack([np.cos(turn), np.sin(turn)], axis=1).ravel())
    course = with_own_times(rhythm, dict(zip(runs, (turn * period_h / (2.0 * np.pi)).tolist(), strict=True)))
    look = taken_for_linear(drive, course, together, usual, RHYTHMS_TRIED)
    times = _price_of_times(told, turn, float(look.size[0]))
    return replace(look, gain=look.gain - times, times=times)


def _price_of_times(told: InformationForm, turn: Array, size: float) -> float:
    """Nats that it costs to have taken the likeliest time of each run, which may be any: Laplace's approximation."""
    price = 0.0
    for run, angle in enumerate(turn.tolist()):
        later = size * np.array([-np.sin(angle), np.cos(angle)])
        known = float(later @ told.information[2 * run : 2 * run + 2, 2 * run : 2 * run + 2] @ later)
        price += 0.5 * float(np.log(max(1.0, 2.0 * np.pi * known)))
    return price
