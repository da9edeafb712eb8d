"""Noise that forgets, for runs and tracks that tests draw."""

from __future__ import annotations

import numpy as np

from flora_common.arrays import Array


def first_order(rng: np.random.Generator, steps: int, keep: float) -> Array:
    """A course of variance 1 that keeps a share of itself from step to step, shape (steps,)."""
    out = np.empty(steps)
    now = rng.standard_normal()
    for k in range(steps):
        out[k] = now
        now = keep * now + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    return out
