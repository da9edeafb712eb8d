"""An evaluation that was done: what was asked, and every trial that came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flora_lab.evaluate.gap import Row, rows
from flora_lab.evaluate.plan import Plan
from flora_lab.evaluate.trial import TWIN, Trial
from flora_lab.evolve.task import REALITY
from flora_lab.simulator.store import SimulatorFile


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Everything that came out.

    Attributes:
        plan: what was asked.
        simulators: those asked for, by name.
        on_twin: whether the virtual rig was asked for.
        trials: in order.
        failed: runs of the virtual rig that did not come to their end, and what they said.
    """

    plan: Plan
    simulators: Mapping[str, SimulatorFile]
    on_twin: bool
    trials: Sequence[Trial]
    failed: Mapping[str, str]

    @property
    def places(self) -> list[str]:
        return [*self.simulators, *([TWIN] if self.on_twin else [])]

    @property
    def rows(self) -> list[Row]:
        return rows(self.plan, self.places, self.trials)

    @property
    def has_real_plants(self) -> bool:
        """Whether the paper tells what real plants came to in these scenarios."""
        return self.on_twin and self.plan.task.scenarios == REALITY.scenarios
