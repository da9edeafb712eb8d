"""When a plant departs from its simulator, and when it is as expected again: hour by hour, each told once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from flora_lab.diagnose import record
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.scene import Scene
from flora_lab.serve import evidence, expecting, pushes
from flora_lab.serve.expecting import Hour, Recognised, Usual
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.terms import ExtendedLaw
from flora_lab.threads import one_blas_thread

BACK_H: Final = 12
"""Hours in which a plant that departed has to be as expected before it counts as back."""
_BACK_WITHIN: Final = 11
"""Of which its tip has to be within what is expected."""


class Watched(msgspec.Struct, frozen=True):
    """What is known of a run that lasts. Small: kept after each look.

    Attributes:
        hours: all that were looked at.
        plant: its constants; None before the first look.
        bets_since: number of hours before the first one that the bets that go on count.
        departed_at: hour at which it departed; None while it is as expected.
        left_out: hours, from and until, in which it had departed: nothing is expected from them.
    """

    hours: tuple[Hour, ...] = ()
    plant: Recognised | None = None
    bets_since: int = 0
    departed_at: int | None = None
    left_out: tuple[tuple[int, int], ...] = ()


def followed(
    run: MeasuredRun, law: ExtendedLaw, usual_c: float | None, known: Knowledge, before: Watched, false_alarms: float
) -> Watched:
    """What is known after all whole hours of a run.

    Args:
        run: all of it up to now.
        law, usual_c: see :class:`flora_lab.diagnose.scene.Scene`.
        known: what the simulator knows.
        before: what was known of the hours before.
        false_alarms: the rate per run at which a plant that is as the simulator says is told to depart.
    """
    follower = _Follower(run, law, usual_c, known, false_alarms)
    watched = before
    with one_blas_thread():
        while len(watched.hours) < follower.whole_hours:
            watched = follower.departed(watched) if watched.departed_at is not None else follower.as_expected(watched)
    return watched


class _Follower:
    """See :func:`followed`."""

    def __init__(
        self, run: MeasuredRun, law: ExtendedLaw, usual_c: float | None, known: Knowledge, false_alarms: float
    ) -> None:
        self._run, self._law, self._usual_c = run, law, usual_c
        most = evidence.largest_usual(known.residuals.misfit, 0.5 * false_alarms)
        self._usual = Usual(known.base.of_single_runs(), most, pushes.usual_sizes(known.errors))
        self._false_alarms = false_alarms
        scene = Scene(run, law, usual_c)
        self._rows_an_hour = scene.per_window
        self.whole_hours = scene.windows

    def _without(self, *hours: tuple[int, int]) -> Scene:
        """The run, as if nothing had been measured in some hours."""
        hidden = np.zeros(len(self._run), dtype=np.bool_)
        for first, end in hours:
            if first < end:
                # A row more at the end: an hour's mean lies somewhat late.
                hidden[first * self._rows_an_hour + 1 : end * self._rows_an_hour + 2] = True
        return Scene(record.without(self._run, hidden), self._law, self._usual_c)

    def as_expected(self, watched: Watched) -> Watched:
        """Some hours more of a plant that has not departed; up to the one in which it does."""
        since = len(watched.hours)
        plant = watched.plant or expecting.unknown(self._usual.base)
        scene = self._without(*watched.left_out)
        if expecting.is_to_be_recognised(plant, since):
            plant = expecting.recognised(scene, self._usual.base, plant, since)
        watched = msgspec.structs.replace(watched, plant=plant)
        until = min(self.whole_hours, since + expecting.AGAIN_H)
        for hour in expecting.hours_of(scene, self._usual, plant, range(since, until)):
            watched = judged(watched, hour, self._false_alarms)
            if watched.departed_at is not None:
                break
        return watched

    def departed(self, watched: Watched) -> Watched:
        """One hour more of a plant that has departed, beside what was to be expected before it did."""
        assert watched.departed_at is not None
        now, since = len(watched.hours), watched.departed_at - 1
        plant = watched.plant or expecting.unknown(self._usual.base)
        scene = self._without(*watched.left_out, (since, now))
        hours = expecting.hours_of(scene, self._usual, plant, range(now, now + 1))
        watched = msgspec.structs.replace(watched, hours=(*watched.hours, *hours))
        begin = now + 1 - BACK_H
        if begin < since + 1 or not is_near(watched.hours[-BACK_H:]):
            return watched
        scene = self._without(*watched.left_out, (since, begin))
        afresh = expecting.hours_of(scene, self._usual, plant, range(begin, now + 1))
        if not is_back(afresh, self._usual.mean_square):
            return watched
        left_out = (*watched.left_out, (since, begin))
        return msgspec.structs.replace(watched, bets_since=now + 1, departed_at=None, left_out=left_out)


def judged(watched: Watched, hour: Hour, false_alarms: float) -> Watched:
    """What is known after one hour more of a plant that has not departed."""
    hours = (*watched.hours, hour)
    worth = evidence.log_worth([h.bets for h in hours[watched.bets_since :]])
    has_departed = bool(worth[-1] >= evidence.threshold(0.5 * false_alarms))
    return msgspec.structs.replace(watched, hours=hours, departed_at=hour.hour if has_departed else None)


def is_near(hours: Sequence[Hour]) -> bool:
    """Whether the tip is within what is expected in nearly all hours, and was measured in them."""
    within = [distance_mm(hour) <= hour.expected_mm for hour in hours if hour.error_mm is not None]
    return len(within) >= _BACK_WITHIN and sum(within) >= _BACK_WITHIN


def is_back(hours: Sequence[Hour], usual: float) -> bool:
    """Whether a plant that departed is as expected in its last hours.

    Args:
        hours: :data:`BACK_H` of them, beside what was expected before it departed and of the hours among themselves.
        usual: mean square of innovations, at most.
    """
    if not is_near(hours):
        return False
    squares = sum(hour.squares for hour in hours) / sum(hour.count for hour in hours)
    # No bet may still be winning: a push that is small at each hour shows only over many.
    return squares <= usual and float(evidence.log_worth([h.bets for h in hours])[-1]) <= 0.0


def distance_mm(hour: Hour) -> float:
    """Of measured and expected tip; 0 where none was measured."""
    return float(np.hypot(*hour.error_mm)) if hour.error_mm is not None else 0.0


def sentence(watched: Watched, false_alarms: float) -> str:
    """How the plant is, for people."""
    hour = next((h for h in reversed(watched.hours) if h.error_mm is not None), None)
    if hour is None:
        return "No stem has been measured yet."
    assert hour.error_mm is not None
    right_mm, up_mm = hour.error_mm
    whom = "this plant, which it watched for a day" if hour.is_watched else "a typical plant"
    where = (
        f"after {hour.hour} h its tip is {abs(right_mm):.0f} mm to the {'right' if right_mm > 0 else 'left'} of and "
        f"{abs(up_mm):.0f} mm {'above' if up_mm > 0 else 'below'} where the simulator expects {whom} "
        f"({round(100 * expecting.BELIEVED)} % are within {hour.expected_mm:.0f} mm)"
    )
    if watched.departed_at is None:
        return f"The plant is as its simulator expects: {where}."
    how = "" if distance_mm(hour) > hour.expected_mm else "; it is how it moves, not where it is, that is not expected"
    return (
        f"The plant departs from its simulator since hour {watched.departed_at} (by chance in at most "
        f"{100 * false_alarms:.2g} % of runs): {where}{how}."
    )
