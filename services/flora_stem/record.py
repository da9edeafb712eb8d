"""What must be known after a kill: the last answer, the last tip, and how far ``track.csv`` has come."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.files import last_lines, write_bytes
from flora_common.geometry import polyline_length, to_px
from flora_common.messages import Stem
from flora_common.runs import CameraSection
from flora_common.shapes import STEM_POINTS
from flora_common.vision.path.length import LengthState
from flora_common.vision.path.memory import Memory
from flora_common.vision.path.reduced import reduced
from flora_common.vision.path.settings import PathSettings

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
        path: what the path method remembers.
    """

    run: str
    tick: int = 0
    stem: Stem | None = None
    tip_px: tuple[float, float] | None = None
    path: Memory | None = None


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


def last_track_row(path: Path) -> tuple[float, FloatArray] | None:
    """(time_s, ten points in cm) of the last whole line of ``track.csv`` that can be read; None where there is none.

    A track that cannot be read tells nothing either; who adds a line to it is told why.
    """
    try:
        lines = last_lines(path, TAIL_BYTES)
    except OSError:
        return None
    for line in reversed(lines):
        parts = line.split(b",")
        try:
            time_s = float(parts[0])
            points = np.array([float(part) for part in parts[2 : 2 + 2 * STEM_POINTS]]).reshape(STEM_POINTS, 2)
        except (ValueError, IndexError):
            continue
        if math.isfinite(time_s) and np.isfinite(points).all():
            return time_s, points
    return None


def continued(
    record: StemRecord, last: tuple[float, FloatArray], camera: CameraSection, settings: PathSettings
) -> StemRecord:
    """The record with the stem of the track's last line for what it remembers."""
    time_s, points_cm = last
    seen = reduced(camera, settings)
    line_px = to_px(points_cm, seen.camera)
    line = [(float(x), float(y)) for x, y in line_px]
    tip_x_px, tip_y_px = seen.full_px(line_px[-1])
    length_cm = float(polyline_length(points_cm))
    # ten points cut the corners of a bent stem by some per cent
    length = LengthState(time_s, length_cm, length_var=(0.02 * length_cm + 0.05) ** 2)
    memory = Memory(line, length, reduction=seen.reduction)
    return msgspec.structs.replace(record, tip_px=(float(tip_x_px), float(tip_y_px)), path=memory)
