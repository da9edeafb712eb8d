"""What ``flora-lab evolve`` shows while it works: how far each run is, best and median, the time left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress_bar import ProgressBar
from rich.table import Table

from flora_lab.bars import Bars
from flora_lab.evolve.crew import SliceDone
from flora_lab.evolve.plan import Plan

_PER_SECOND: Final = 4
_SPEED_OVER_S: Final = 120.0
"""The time left follows from the pace of so many seconds: networks grow, and generations become slower."""


class Screen:
    """A :class:`flora_lab.evolve.evolution.Watcher` on a terminal.

    Args:
        plan: what the evolution is.
        console: to draw on.
        is_silent: draw nothing.
    """

    def __init__(self, plan: Plan, console: Console, *, is_silent: bool) -> None:
        self._plan = plan
        self._runs: dict[int, SliceDone] = {}
        self.is_silent = is_silent or not console.is_terminal
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        self._bar = Bars(*columns, console=console, speed_estimate_period=_SPEED_OVER_S)
        self._task = self._bar.add_task("generations", total=plan.runs * plan.generations)

    def run(self, now: SliceDone) -> None:
        """See :class:`flora_lab.evolve.evolution.Watcher`."""
        self._runs[now.number] = now
        self._bar.update(self._task, completed=sum(run.generations for run in self._runs.values()))

    def stage(self, name: str) -> None:
        """What is done now."""
        self._bar.update(self._task, description=name)

    def __rich__(self) -> RenderableType:
        return Group(self._table(), self._bar)

    def _table(self) -> Table:
        table = Table(box=None, pad_edge=False)
        for name in ("run", "generation", "", "best %", "median %", "species", "hidden nodes"):
            table.add_column(name, justify="left" if name == "" else "right")
        for number in sorted(self._runs):
            run = self._runs[number]
            table.add_row(
                str(number),
                str(run.generations),
                ProgressBar(self._plan.generations, run.generations, width=20),
                f"{100 * run.best_fitness:.1f}",
                f"{100 * run.median_fitness:.1f}",
                str(run.species),
                str(run.nodes),
            )
        return table


@contextlib.contextmanager
def shown(plan: Plan, *, is_silent: bool) -> Iterator[Screen]:
    """A screen on stderr if that is a terminal; it goes when the block ends."""
    console = Console(stderr=True)
    screen = Screen(plan, console, is_silent=is_silent)
    if screen.is_silent:
        yield screen
        return
    with Live(screen, console=console, refresh_per_second=_PER_SECOND, transient=True):
        yield screen
