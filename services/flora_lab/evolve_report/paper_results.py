"""What Wahby et al. 2018 tell of their evolved controllers in simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from flora_lab.evolve.task import LEFT, MIDDLE

BEST_PERCENT: Final[Mapping[str, float]] = {LEFT.name: 82.5, MIDDLE.name: 97.3}
"""Fitness of the controllers that its section "Evolving controllers in simulation" describes, by task, over all
scenarios: "one of the best" of 20 runs of 1000 generations, so it is to be held against best runs rather than medians.
"""
