"""Drawn tips: red noise of several kinds, and swings whose phase drifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from noise_courses import first_order

from flora_common.arrays import Array
from flora_lab.rhythm.tip_track import TipTrack


def forgetting(rng: np.random.Generator, steps: int, memory: float) -> Array:
    """A course of variance 1, about, that forgets within so many steps, shape (steps,)."""
    return first_order(rng, steps, np.exp(-1.0 / memory))


def noise(rng: np.random.Generator, steps: int, kind: int) -> Array:
    """Noise of one of six kinds, none of which is exactly one of those that are fitted but the first."""
    match kind % 6:
        case 0:
            return forgetting(rng, steps, 5.0)
        case 1:
            return forgetting(rng, steps, 30.0) + 0.1 * rng.standard_normal(steps)
        case 2:
            return np.cumsum(rng.standard_normal(steps))
        case 3:
            return np.cumsum(forgetting(rng, steps, 10.0)) + 0.5 * rng.standard_normal(steps)
        case 4:
            return forgetting(rng, steps, 80.0) + 0.2 * forgetting(rng, steps, 6.0)
        case _:
            return rng.standard_normal(steps)


def swing(rng: np.random.Generator, steps: int, period: float, amplitude: float, drift: float) -> Array:
    """A swing of steady size; ``drift`` is how many cycles its phase wanders within one, as a standard deviation."""
    phase = np.arange(steps) / period + rng.uniform()
    phase += np.cumsum(rng.standard_normal(steps)) * drift / np.sqrt(period)
    return amplitude * np.sin(2.0 * np.pi * phase)


def tip(x: Array, y: Array | None = None, *, right_share: Array | None = None) -> TipTrack:
    """A tip that nothing is known of but its place, in px by frames."""
    return TipTrack(
        name="drawn",
        file=Path("drawn.csv"),
        x=x,
        y=np.zeros(len(x)) if y is None else y,
        known=np.ones(len(x), dtype=bool),
        step=1.0,
        start=0.0,
        time_unit="frames",
        unit="px",
        is_scale_doubtful=False,
        right_share=right_share,
    )


def write_table(path: Path, header: str, rows: Array) -> Path:
    """A CSV of numbers."""
    path.write_text("\n".join([header, *(",".join(f"{v:.6g}" for v in row) for row in rows)]) + "\n")
    return path
