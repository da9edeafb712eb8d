"""What healthy runs plainly show of what has no name: nothing is wrong with other runs that show it as well.

:mod:`flora_lab.diagnose.usual_errors` knows in which effects of the catalogue the law is wrong. It may be wrong in
others: plants whose answer to light grows with their lean in every run, say. Each push of a drive along a course
(:mod:`flora_lab.diagnose.courses`) is therefore weighed in the reference, too, on the mean and with a scatter between
plants, and where it is plainly there, only what goes beyond it is news.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.courses import KNOWN, LOOKED, SIZE, pushed_along
from flora_lab.diagnose.information_form import InformationForm, together
from flora_lab.diagnose.joint import Base, Found, Joint, Ready
from flora_lab.diagnose.scene import Answers

COLUMNS: Final = 2
"""Of a course, at most."""
_AT_ONCE: Final = 16
"""Pushes of which what runs tell apart is told together: it grows with the square of these."""
_SCATTER: Final = (0.0, 0.1, 0.2, 0.4, 0.8)
"""Shares of the size that is looked for, by which plants may differ, that are tried."""


@dataclass(frozen=True, slots=True)
class UsualPushes:
    """By how much healthy plants are pushed, in the order of :data:`flora_lab.diagnose.courses.KNOWN`.

    Attributes:
        mean: shape (pushes, 2); a course of one column has the first. Nothing where nothing is plain.
        doubt: covariance of the mean, shape (pushes, 2, 2).
        scatter: standard deviation between plants, shape (pushes,).
    """

    mean: Array
    doubt: Array
    scatter: Array

    def nats(self, which: int, told: InformationForm, runs: int) -> float:
        """How much of the evidence for a push in some runs is what healthy ones show as well; not negative.

        Args:
            which: push.
            told: of it by the runs.
            runs: how many.
        """
        columns = len(told.pull)
        covariance = self.doubt[which, :columns, :columns] + self.scatter[which] ** 2 / runs * np.eye(columns)
        return max(0.0, told.nats(covariance, self.mean[which, :columns]))

    def nats_apart(self, which: int, told: InformationForm, runs: int) -> float:
        """The same where each run has sizes of its own, of :data:`COLUMNS` columns, one run after the other."""
        scatter = self.scatter[which] ** 2 * np.eye(len(told.pull))
        covariance = np.kron(np.ones((runs, runs)), self.doubt[which]) + scatter
        return max(0.0, told.nats(covariance, np.tile(self.mean[which], runs)))


def no_pushes() -> UsualPushes:
    """Of plants that the law describes."""
    count = len(KNOWN)
    return UsualPushes(np.zeros((count, COLUMNS)), np.zeros((count, COLUMNS, COLUMNS)), np.zeros(count))


def usual_pushes(runs: Sequence[Ready], fits: Sequence[Found], answers: Sequence[Answers], base: Base) -> UsualPushes:
    """What reference runs show.

    Args:
        runs: with all else that happens by chance, and what the law is usually wrong in.
        fits: of each run by itself.
        answers: of each run, about that fit.
        base: that they were fitted with, for single runs.
    """
    usual = no_pushes()
    told: list[list[InformationForm]] = [[] for _ in KNOWN]
    for run, fit, own in zip(runs, fits, answers, strict=True):
        for which, one in enumerate(told_of_all(Joint([run], base), fit, [pushed_along(run.scene, own, KNOWN)])):
            told[which].append(one)
    for which, (drive, _) in enumerate(KNOWN):
        mean, doubt, scatter = _plain(told[which], SIZE[drive])
        columns = len(mean)
        usual.mean[which, :columns], usual.scatter[which] = mean, scatter
        usual.doubt[which, :columns, :columns] = doubt
    return usual


def told_of_all(joint: Joint, found: Found, pushed: Sequence[Sequence[Array]]) -> list[InformationForm]:
    """What runs tell of each push, all others being none.

    Args:
        joint: the runs.
        found: their explanation so far, fitted.
        pushed: by run, see :func:`flora_lab.diagnose.courses.pushed_along`.
    """
    ends = np.cumsum([0, *(along.shape[1] for along in pushed[0])])
    told = joint.beside(found, [np.concatenate(own, axis=1) for own in pushed])
    return [told.of(slice(begin, end)) for begin, end in itertools.pairwise(ends)]


def told_apart(joint: Joint, found: Found, pushed: Sequence[Sequence[Array]]) -> list[InformationForm]:
    """The same where each run has sizes of its own: of each push those of one run after those of another."""
    out: list[InformationForm] = []
    for first in range(0, len(pushed[0]), _AT_ONCE):
        out += _some_apart(joint, found, [own[first : first + _AT_ONCE] for own in pushed])
    return out


def _some_apart(joint: Joint, found: Found, pushed: Sequence[Sequence[Array]]) -> list[InformationForm]:
    runs = len(pushed)
    widths = [along.shape[1] for along in pushed[0]]
    ends = np.cumsum([0, *(runs * width for width in widths)])
    begins = list(zip(ends[:-1], widths, strict=True))
    places = [np.concatenate([at + run * width + np.arange(width) for at, width in begins]) for run in range(runs)]
    told = joint.beside(found, [np.concatenate(own, axis=1) for own in pushed], places)
    return [told.of(slice(begin, end)) for begin, end in itertools.pairwise(ends)]


def _plain(told: Sequence[InformationForm], sd: float) -> tuple[Array, Array, float]:
    """Mean, covariance of it, and scatter of one push; nothing unless it is likelier than that none of all is there."""
    one = np.eye(len(told[0].pull))
    most = LOOKED
    best: tuple[Array, Array, float] = np.zeros(len(one)), 0.0 * one, 0.0
    for scatter in sd * np.array(_SCATTER):
        apart = sum(own.nats(scatter**2 * one) for own in told)
        mean = together([own.scattered(scatter) for own in told])
        if apart > most:
            most, best = apart, (np.zeros(len(one)), 0.0 * one, float(scatter))
        if (both := apart + mean.nats(sd**2 * one)) > most:
            most, best = both, (mean.size(sd), np.linalg.inv(mean.information + one / sd**2), float(scatter))
    return best
