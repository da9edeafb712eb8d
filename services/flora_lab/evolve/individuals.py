"""Robustness: a controller's fitness over several plants that the simulator draws, in place of the typical one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput

Judge = Literal["mean", "worst"]

HELD_OUT: Final = 24
"""Plants that no controller was evolved on, by which the best of all runs is chosen."""


@dataclass(frozen=True, slots=True)
class Individuals:
    """Which plants every controller is tried on, in every scenario, and what counts.

    Attributes:
        count: plants; 0 is the typical plant alone, to which nothing happens by chance.
        seed: which plants are drawn. More plants from the same seed are the same ones and some more.
        judge: a controller's fitness in a scenario is the mean over plants, or that of the worst.
        skipped: plants of the seed that are left out before these.

    Raises:
        BadInput: fewer than no plants, or a seed below 0.
    """

    count: int = 0
    seed: int = 1
    judge: Judge = "mean"
    skipped: int = 0

    def __post_init__(self) -> None:
        if self.count < 0 or self.seed < 0:
            raise BadInput(f"individuals: {self.count} plants from seed {self.seed}; both must be 0 or above")

    def seeds(self) -> list[int] | None:
        """For :class:`flora_lab.simulator.interface.Chance`, one per plant; None for the typical plant."""
        if self.count == 0:
            return None
        drawn = np.random.SeedSequence(self.seed).generate_state(self.skipped + self.count, np.uint64)
        return [
            int(seed) for seed in drawn[self.skipped :] >> np.uint64(1)
        ]  # below 2**63, so that they fit a signed integer

    def held_out(self) -> Individuals:
        """:data:`HELD_OUT` others from the same seed; what counts over them is the mean."""
        return Individuals(HELD_OUT, self.seed, "mean", self.skipped + self.count)

    def judged(self, fitness: FloatArray) -> FloatArray:
        """Fitness by plants, shape (..., plants), as one number for each of the others."""
        return np.asarray(fitness.mean(axis=-1) if self.judge == "mean" else fitness.min(axis=-1))
