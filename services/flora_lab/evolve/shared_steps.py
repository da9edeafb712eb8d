"""How many steps of plants a population takes in one piece, told from what its episodes came to."""

from __future__ import annotations

import numpy as np

from flora_common.arrays import Array
from flora_lab.evolve.episode import Outcomes


def shared_steps(outcomes: Outcomes) -> int:
    """Steps of plants when each plant that episodes have in common is simulated once.

    Two episodes have a plant in common as long as the same lamps shone: counted are the different beginnings of all
    histories of light, for each plant.
    """
    total = 0
    for plant in range(outcomes.steps.shape[2]):
        is_right = outcomes.is_right[:, :, plant].reshape(-1, outcomes.is_right.shape[-1])
        total += _beginnings(is_right, outcomes.steps[:, :, plant].ravel())
    return total


def _beginnings(is_right: Array, steps: Array) -> int:
    """How many different beginnings the first ``steps`` of each row have; shapes (n, most steps) and (n,).

    In alphabetical order each row adds what goes beyond its beginning in common with the row before.
    """
    lamps = is_right & (np.arange(is_right.shape[1]) < steps[:, None])
    length = steps.astype(">u4").view(np.uint8).reshape(-1, 4)
    keys = np.ascontiguousarray(np.hstack([np.packbits(lamps, axis=1), length]))
    order = np.argsort(keys.view(np.dtype((np.void, keys.shape[1]))).ravel(), kind="stable")
    lamps, steps = lamps[order], steps[order]
    differs = lamps[1:] != lamps[:-1]
    first = np.where(differs.any(axis=1), differs.argmax(axis=1), is_right.shape[1])
    return int(steps.sum() - np.minimum(first, np.minimum(steps[1:], steps[:-1])).sum())
