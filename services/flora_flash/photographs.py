"""How far the beat of a run had come, by its photographs: from their names and the ends of their tables alone.

Tables are not read whole: a run of 20,000 photographs must not keep the beat from its start.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, TypeVar

import msgspec

from flora_common.errors import BadRunFolder
from flora_common.files import last_lines
from flora_common.messages.catalogue import Purpose
from flora_common.messages.envelope import Count, Seconds
from flora_common.runs import RunFolder
from flora_flash.core import Photographed

TAIL_BYTES: Final = 1 << 16
"""Of a table's end: dozens of lines of ``frames.jsonl``, whose longest hold some kilobytes of metadata."""
NAME: Final = re.compile(r"(\d{1,12})(-\d+)?\.jpg")
"""A photograph of the run, as flora-capture names it: its tick, and a number where the first try was left behind."""

T = TypeVar("T")


class _LedgerLine(msgspec.Struct):
    """What is used here of a line of ``frames.jsonl``."""

    tick: Count
    time_s: Seconds
    purpose: Purpose = "run"


_LEDGER_LINE: Final = msgspec.json.Decoder(_LedgerLine)


def last_photographed(run: RunFolder) -> Photographed | None:
    """The highest number and the latest run time that names, ``frames.jsonl`` or ``frames.csv`` tell; None for none.

    Lines that are not whole are left out: a power cut may tear the last one.

    Raises:
        BadRunFolder: something of it is there and cannot be read.
    """
    ledger = _readable(run.frames_log, _LEDGER_LINE.decode)
    numbers = list(_numbers(run.frames))
    ticks = [*numbers, *(line.tick for line in ledger)]
    times_s = [line.time_s for line in ledger if line.purpose == "run"] + _readable(run.frames_csv, _time_s_of_row)
    if not ticks and not times_s:
        return None
    return Photographed(tick=max(ticks, default=0), time_s=max(times_s, default=None), of_run=bool(numbers or times_s))


def _numbers(folder: Path) -> Iterator[int]:
    try:
        names = os.listdir(folder)  # noqa: PTH208 - no Path for each of 20,000 names
    except FileNotFoundError:
        return
    except OSError as problem:
        raise BadRunFolder(f"{folder}: cannot be read ({problem.strerror})") from problem
    for name in names:
        if match := NAME.fullmatch(name):
            yield int(match[1])


def _time_s_of_row(line: bytes) -> float:
    return msgspec.convert(float(line.split(b",")[1]), Seconds)


def _readable(file: Path, read: Callable[[bytes], T]) -> list[T]:
    """What ``read`` makes of each of the last lines; those that it refuses, such as the header, are left out."""
    try:
        lines = last_lines(file, TAIL_BYTES)
    except OSError as problem:
        raise BadRunFolder(f"{file}: cannot be read ({problem.strerror})") from problem
    found = []
    for line in lines:
        try:
            found.append(read(line))
        except (ValueError, IndexError, RecursionError):
            continue
    return found
