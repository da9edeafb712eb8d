"""What seems to be at work that has no name in the catalogue, and how that is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.courses import SIZE, TRIED, Course
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.simulator.drives import DAY_H


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


def taken_for_linear(drive: str, course: Course, told: InformationForm, usual: float, tried: int) -> Unnamed:
    """What runs tell of a drive along a course, as one of so many; ``usual`` nats are what healthy plants show."""
    sd = SIZE[drive]
    nats = told.nats(sd**2 * np.eye(len(told.pull))) - float(np.log(tried)) - usual
    return Unnamed(drive, course, nats, told.size(sd), usual, tried)


def times_as_probable(nats: float) -> str:
    """Evidence as people read it."""
    return f"{times(nats)} as probable as without"


def times(nats: float) -> str:
    """How many times that is."""
    return f"e^{nats:.0f} times" if nats > 20.0 else f"{np.exp(nats):,.0f} times".replace(",", " ")
