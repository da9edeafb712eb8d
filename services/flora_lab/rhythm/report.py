"""What ``flora-lab rhythm`` prints and writes: a table in words, and every number as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from flora_common import files
from flora_lab.rhythm import figures
from flora_lab.rhythm.judgement import Rhythm, cannot_tell, said
from flora_lab.rhythm.search import DRAWN, INTERVAL, LEVEL

JSON_FILE: Final = "rhythm.json"
PICTURE_FILE: Final = "rhythm.png"
_DIGITS: Final = 6


def write_folder(path: Path, judged: Sequence[Rhythm]) -> None:
    """Write the folder, whole or not at all.

    Raises:
        DiskFull: no room.
    """
    picture = figures.rhythms(judged)
    with files.whole_folder(path) as folder:
        (folder / JSON_FILE).write_text(json.dumps(as_json(judged), indent=1) + "\n", encoding="utf-8")
        (folder / PICTURE_FILE).write_bytes(picture)


def as_json(judged: Sequence[Rhythm]) -> dict[str, Any]:
    """All tracks; numbers carry the unit that ``time_unit`` and ``unit`` of their track name."""
    return {
        "level": LEVEL,
        "interval": INTERVAL,
        "noise_records": DRAWN,
        "tracks": [_one(rhythm) for rhythm in judged],
    }


def text(judged: Sequence[Rhythm]) -> str:
    """A paragraph for each track, and a word on how many were searched."""
    parts = []
    for rhythm in judged:
        parts.append(f"{rhythm.track.name}\n")
        parts += [f"  {line}\n" for line in said(rhythm)]
        parts.append("  cannot be told:\n")
        parts += [f"    {line}\n" for line in cannot_tell(rhythm)]
    if len(judged) > 1:
        chance = LEVEL * len(judged)
        claimed = sum(r.swings for r in judged)
        parts.append(
            f"{claimed} of {len(judged)} tracks {'swings' if claimed == 1 else 'swing'}; "
            f"noise alone would be called so in {chance:.2g} of them\n"
        )
    return "".join(parts)


def _one(rhythm: Rhythm) -> dict[str, Any]:
    track, found, band = rhythm.track, rhythm.found, rhythm.cycles
    step = track.step
    return {
        "name": track.name,
        "file": files.shown(track.file),
        "time_unit": track.time_unit,
        "unit": track.unit,
        "along": rhythm.along,
        "steps": len(track.x),
        "step": _number(step),
        "missing_share": _number(1.0 - float(track.known.mean())),
        "searched_periods": [_number(v) for v in rhythm.searched],
        "swings": rhythm.swings,
        "p": _number(found.p),
        "gain_nats": _number(found.gain_nats),
        "period": _number(rhythm.period),
        "period_interval": [_number(v) for v in rhythm.period_interval],
        "coherence_cycles": _number(found.coherence_cycles),
        "amplitude": _number(band.amplitude),
        "amplitude_interval": [_number(v) for v in band.amplitude_interval],
        "growth_per_cycle": _number(band.growth_per_cycle),
        "growth_per_cycle_interval": [_number(v) for v in band.growth_interval],
        "peaks": [_number(track.start + step * float(v)) for v in band.peaks],
        "cycle_periods": [_number(step * float(v)) for v in band.periods],
        "cycle_scatter": _number(step * band.scatter),
        "other_coordinate_period": None if rhythm.other_period is None else _number(rhythm.other_period),
        "lamps_amplitude": None if rhythm.lamps_amplitude is None else _number(rhythm.lamps_amplitude),
        "found": said(rhythm),
        "cannot_be_told": cannot_tell(rhythm),
    }


def _number(value: float) -> float | None:
    """Rounded to digits that mean something; None for what is not known, which JSON has no number for."""
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
