"""All runs of an evolution, side by side, from wherever they stand to their end."""

from __future__ import annotations

from collections import deque
from typing import Protocol

from flora_lab.evolve import one_run
from flora_lab.evolve.crew import Crew, Slice, SliceDone, told
from flora_lab.evolve.kept_runs import KeptRuns
from flora_lab.evolve.one_run import RunState
from flora_lab.evolve.plan import Plan


class Watcher(Protocol):
    """Is told how an evolution goes on."""

    def run(self, now: SliceDone) -> None:
        """A run has come as far as this."""


def evolve(plan: Plan, kept: KeptRuns, crew: Crew, watcher: Watcher) -> list[RunState]:
    """Bring all runs to their end; each is kept after every slice.

    Args:
        plan: what the evolution is.
        kept: where runs are kept, and found that were begun before.
        crew: who does the work; how many they are changes nothing.
        watcher: is told.

    Returns:
        The runs, in order.

    Raises:
        BadInput: what is kept is damaged, or the simulator leaves the numbers.
        DiskFull: no room to keep a run.
    """
    over: dict[int, RunState] = {}
    waiting: deque[Slice] = deque()
    for number in range(1, plan.runs + 1):
        state = kept.load(number) or one_run.first_state(plan, number)
        if state.history:
            watcher.run(told(state))
        if one_run.is_over(plan, state):
            over[number] = state
        else:
            waiting.append(Slice(number, one_run.encode(state)))
    while len(over) < plan.runs:
        while waiting and crew.room:
            crew.send(waiting.popleft())
        for done in crew.receive():
            kept.save(done.number, done.state)
            watcher.run(done)
            if done.generations >= plan.generations:
                over[done.number] = one_run.decode(done.state)
            else:
                waiting.append(Slice(done.number, done.state))
    return [over[number] for number in sorted(over)]
