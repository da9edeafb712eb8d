"""What ``flora-lab paper`` shows while it works: a heading for each step, over the step's own progress."""

from __future__ import annotations

import sys

from flora_lab.bars import Teller
from flora_lab.paper.steps import Step


class Screen:
    """A :class:`flora_lab.paper.steps.Watcher` that prints to stderr, as the steps' commands do.

    Args:
        count: steps in all.
        is_silent: print nothing.
    """

    def __init__(self, count: int, *, is_silent: bool) -> None:
        self._count = count
        self._is_silent = is_silent
        self._teller = Teller()

    def kept(self, number: int, step: Step, took_s: float) -> None:
        """See :class:`flora_lab.paper.steps.Watcher`."""
        self.heading(number, f"{step.title}: done before, in {duration(took_s)}")

    def begins(self, number: int, step: Step, *, is_begun: bool) -> None:
        """See :class:`flora_lab.paper.steps.Watcher`."""
        self.heading(number, f"{step.title}{', going on' if is_begun else ''}")

    def ends(self, number: int, step: Step, took_s: float) -> None:
        """See :class:`flora_lab.paper.steps.Watcher`."""
        self.say(f"      {duration(took_s)}")

    def heading(self, number: int, text: str) -> None:
        """A step's line."""
        self._teller.tell(text, number - 1, self._count)
        self.say(f"{number:>2}/{self._count} {text}")

    def say(self, text: str) -> None:
        """A line or more."""
        if not self._is_silent:
            print(text, file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """A time that people read."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{seconds / 3600.0:.1f} h"
