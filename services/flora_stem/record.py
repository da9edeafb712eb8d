"""What must be known after a kill: the last answer, the last tip, and how far ``track.csv`` has come."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import msgspec

from flora_common.files import write_bytes
from flora_common.messages import Stem
from flora_common.runs import CameraSection

RECORD_FILE: Final = "stem.json"
TAIL_BYTES: Final = 8192
"""A line of ``track.csv`` is under 250 bytes."""


class StemRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """State of a run.

    Attributes:
        run: which run it belongs to; another run starts anew.
        tick: the last tick that was answered.
        stem: the answer.
        tip_px: the tip before the next frame, in px of the full picture.
    """

    run: str
    tick: int = 0
    stem: Stem | None = None
    tip_px: tuple[float, float] | None = None


def read_record(path: Path, *, run: str) -> StemRecord:
    """The stored record of this run; a new one where there is none, or none that can be used."""
    try:
        record = msgspec.json.decode(path.read_bytes(), type=StemRecord)
    except (OSError, ValueError, RecursionError):
        return StemRecord(run=run)
    return record if record.run == run else StemRecord(run=run)


def write_record(path: Path, record: StemRecord) -> None:
    """Write the record, flushed to the disk.

    Raises:
        StoreError: no room on the disk.
        OSError: it cannot be written.
    """
    write_bytes(path, msgspec.json.encode(record))


def last_track_row(path: Path) -> tuple[float, tuple[float, float]] | None:
    """(time_s, tip in cm) of the last whole line of ``track.csv`` that can be read; None where there is none.

    A line without its end was torn by a power cut and is cut off when the next one is added.
    """
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - TAIL_BYTES))
            lines = file.read().split(b"\n")[:-1]
    except OSError:
        return None
    for line in reversed(lines):
        parts = line.split(b",")
        try:
            time_s, x_cm, y_cm = float(parts[0]), float(parts[20]), float(parts[21])
        except (ValueError, IndexError):
            continue
        if math.isfinite(time_s) and math.isfinite(x_cm) and math.isfinite(y_cm):
            return time_s, (x_cm, y_cm)
    return None


def tip_in_px(tip_cm: tuple[float, float], camera: CameraSection) -> tuple[float, float]:
    """A place in cm as px of the full picture, y down."""
    anchor_x, anchor_y = camera.anchor_px
    return anchor_x + tip_cm[0] * camera.px_per_cm, anchor_y - tip_cm[1] * camera.px_per_cm
