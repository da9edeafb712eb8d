"""Which lamp shines when: six-hour turns, random turns, long turns, and a closed loop after the tip."""

from __future__ import annotations

import numpy as np

from .kernel import CLOSED_LOOP
from .scene import HOUR_S, LIGHT_CODES, ROW_S

SPARE_H = 4.0
"""Schedules go on after the run, so that a clock that is ahead still finds a lamp."""
OPEN_LOOPS = ("six_hour", "random_dwell", "long_dwell")


def draw_schedule(rng: np.random.Generator, kind: str, hours: float) -> np.ndarray:
    """Code of the lamp of each row: 0 left, 1 right, -1 for the closed loop.

    Args:
        rng: where chance comes from; the first lamp is drawn too.
        kind: one of :data:`OPEN_LOOPS`, ``closed_loop``, turns of equal hours, such as ``24h``, or a list that leaves
            nothing to chance, such as ``left 6h, dark 6h, right``, the last one for ever.
        hours: of the run.
    """
    rows = round((hours + SPARE_H) * HOUR_S / ROW_S)
    if kind == "closed_loop":
        return np.full(rows, CLOSED_LOOP, dtype=np.int64)
    side = int(rng.integers(2))
    if kind.startswith(LIGHT_CODES):
        return _listed(kind, rows)
    codes = np.empty(rows, dtype=np.int64)
    at = 0
    while at < rows:
        if kind == "six_hour":
            dwell_h = 6.0
        elif kind.endswith("h"):
            dwell_h = float(kind.removesuffix("h"))
        elif kind == "random_dwell":
            dwell_h = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
        else:
            dwell_h = float(rng.uniform(24.0, 36.0))
        upto = at + max(1, round(dwell_h * HOUR_S / ROW_S))
        codes[at:upto] = side
        at, side = upto, 1 - side
    return codes


def _listed(text: str, rows: int) -> np.ndarray:
    codes, at = np.empty(rows, dtype=np.int64), 0
    for entry in text.split(","):
        light, _, length = entry.strip().partition(" ")
        upto = at + round(float(length.removesuffix("h")) * HOUR_S / ROW_S) if length else rows
        codes[at:upto] = LIGHT_CODES.index(light)
        at = upto
    codes[at:] = codes[at - 1]
    return codes
