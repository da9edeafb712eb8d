"""Shoots in three dimensions whose youngest leaves stand apart, at nodes some millimetres from each other.

What leafy shoots lack: leaves there crowd at the very end, so that the lowest fork of a bud is where it ends. Here the
stem goes on between small, steep leaves for a centimetre or three, growing more slender.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from guide.shoots import MOST_NODES, Leafage, Shoot
from guide.vectors import Stem


class Budding(Shoot):
    """A shoot that ends in such a bud.

    Args:
        rng: of everything.
    """

    slenderest: ClassVar = 0.2

    def _habit(self, length: float) -> str:
        """Leafy, whatever its length."""
        return "leafy"

    def _leaves(self, stem: Stem, leaf: Leafage, habit: str) -> None:
        """From the youngest, which stands close to the end, downwards: each node farther from the next, its leaves
        larger, until they are full-grown."""
        rng, length = self._rng, stem.to_end_cm[0]
        apart, farther = float(np.exp(rng.uniform(np.log(0.15), np.log(0.6)))), float(rng.uniform(1.0, 1.7))
        long, longer = float(np.exp(rng.uniform(np.log(0.15), np.log(0.8)))), float(rng.uniform(1.15, 1.9))
        opened = float(rng.uniform(3.0, 9.0))
        count, onwards = self._around()
        azimuth, below = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0.0, 0.3))
        lowest = max(0.6, float(rng.uniform(0.1, 0.6) if rng.random() < 0.3 else 0.93) * length)
        for number in range(MOST_NODES):
            if below > lowest:
                break
            size = min(1.0, long * longer**number / leaf.size_cm)
            self._node(stem, below, azimuth, leaf, count, size, min(1.0, number / opened))
            azimuth += onwards + rng.normal() * 0.15
            below += min(4.0, apart * farther**number) * float(rng.uniform(0.7, 1.3))

    def _closed(self, stem: Stem, leaf: Leafage) -> None:
        """Nothing closes over its apex."""
