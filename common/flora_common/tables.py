"""Tables that people and other programs write: CSV in the ways in which it is met, and the numbers in it.

Fields may be parted by commas, semicolons or tabs; where it is no comma, decimals may have one. Column names count in
whatever case; lines that begin with ``#`` may stand before them. Blank lines are passed over, and so are columns
without a name: a spreadsheet's empty ones, a data frame's numbers of its rows.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from flora_common.counted import counted
from flora_common.errors import BadRunFolder
from flora_common.suggest import clipped, did_you_mean

MOST_TIME_S: Final = 1e12
LONGEST_S: Final = 366 * 86_400.0
MOST_NUMBER: Final = 1e30
"""Squares of what is larger are no numbers any more."""

_SEPARATORS: Final = (",", ";", "\t")
_DECIMAL_COMMA: Final = re.compile(r"\s*[-+]?\d*,\d+(?:[eE][-+]?\d+)?\s*")
_NUMBER: Final = re.compile(
    r"\s*[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|inf(?:inity)?|nan)\s*", re.ASCII | re.IGNORECASE
)
"""Python itself takes `1_5` for 15, and the digits of every script: neither is what a table's writer means."""
_HOLDS: Final = {
    "time_s": " (seconds, or date and time such as 2026-05-02T08:00:00)",
    "light": " (the lamp that shone: left, right, dark or both)",
}
_MISSING: Final = frozenset({"", "nan", "na", "n/a", "null"})
_Line = tuple[int, list[str]]


def read_header(path: Path) -> list[str]:
    """Column names of a table; none of an empty one.

    Raises:
        BadRunFolder: unreadable, not CSV.
    """
    lines = _lines(path)
    return lines[0][1] if lines else []


def read_csv(path: Path, required: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and values by column of each row.

    Args:
        path: of the table.
        required: columns that must be there; what they are called in the rows, whatever case the table has.

    Raises:
        BadRunFolder: unreadable, not CSV, a required column is missing, a row of another length.
    """
    lines = _lines(path)
    if not lines:
        raise BadRunFolder(f"{path}: is empty; expected the header {','.join(required[:3])},…")
    header = _named(path, lines[0], required)
    for number, row in lines[1:]:
        if not any(field.strip() for field in row):
            continue
        if len(row) < len(header) or any(field.strip() for field in row[len(header) :]):
            raise BadRunFolder(
                f"{path} line {number}: {counted(len(row), 'value')} under {counted(len(header), 'column')}"
            )
        yield number, {name: field for name, field in zip(header, row, strict=False) if name}


def is_missing(text: str) -> bool:
    """Whether a field says that nothing was measured: it is empty, or as programs write that (NaN, NA)."""
    return text.strip().casefold() in _MISSING


def is_measured(text: str) -> bool:
    """Whether a field holds a number, be it one that nobody can have measured (inf); NaN is the word for none."""
    return _NUMBER.fullmatch(text) is not None and not is_missing(text)


def finite_number(text: str, name: str, where: str, most: float = MOST_NUMBER, unit: str = "") -> float:
    """A finite number from ``-most`` to ``most``, or :class:`BadRunFolder` with column and line.

    Args:
        text: of the field.
        name: of the column.
        where: file and line.
        most: what nobody can have measured lies beyond it.
        unit: that the column is in, for the message.
    """
    name = clipped(name)
    if not text.strip():
        raise BadRunFolder(f"{where}: {name} is empty, where a number is needed")
    if _NUMBER.fullmatch(text) is None:
        raise BadRunFolder(f"{where}: {name} is `{text[:40]}`, not a number")
    value = float(text)
    if not math.isfinite(value):
        raise BadRunFolder(f"{where}: {name} is `{text[:40]}`, not a finite number")
    if abs(value) > most:
        units = f"; {name} is in {unit}" if unit else ""
        raise BadRunFolder(f"{where}: {name} is {value:g}, beyond {most:g}{units}")
    return value


def later_time(text: str, before: Sequence[float], where: str) -> float:
    """The time of a row in s, or :class:`BadRunFolder` with the line.

    Args:
        text: of the field: seconds, or date and time as ISO 8601 writes them, of UTC where they name no zone.
        before: times of the rows before it; it must be after the last, and within :data:`LONGEST_S` of the first.
        where: file and line.
    """
    dated_s = _dated_s(text)
    time_s = finite_number(text, "time_s", where, MOST_TIME_S, "seconds") if dated_s is None else dated_s
    if before and time_s <= before[-1]:
        raise BadRunFolder(f"{where}: time_s {_shown(time_s)} is not after {_shown(before[-1])} in the line before")
    if before and time_s - before[0] > LONGEST_S:
        raise BadRunFolder(f"{where}: time_s {time_s:g} is more than a year after the first, {before[0]:g}")
    return time_s


def _shown(time_s: float) -> str:
    return f"{time_s:.10g}"


def _dated_s(text: str) -> float | None:
    if ":" not in text and "-" not in text[1:]:
        return None
    try:
        told = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return (told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp()


def _lines(path: Path) -> list[_Line]:
    """Number and fields of each line from the header on."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as problem:
        raise BadRunFolder(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        told = f"{path}: not UTF-8 text (byte {problem.start}), hence not a CSV file; save it as CSV in UTF-8"
        raise BadRunFolder(told) from problem
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    lines = lines[first:]
    if not lines:
        return []
    try:
        separator = max(_SEPARATORS, key=lambda sign: len(next(csv.reader(lines[:1], delimiter=sign))))
        rows = _fields(lines, separator)
    except csv.Error as problem:
        raise BadRunFolder(f"{path}: not a CSV file ({problem})") from problem
    rows = [(first + number, row) for number, row in rows if row]
    number, header = rows[0]
    header = [name.strip() for name in header]
    while header and not header[-1]:
        header.pop()
    if separator != ",":
        rows = [(number, [_with_point(field) for field in row]) for number, row in rows]
    return [(number, header), *rows[1:]]


def _fields(lines: Sequence[str], separator: str) -> list[_Line]:
    table = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=True)
    return [(table.line_num, row) for row in table]


def _with_point(field: str) -> str:
    return field.replace(",", ".") if _DECIMAL_COMMA.fullmatch(field) else field


def _named(path: Path, header_line: _Line, required: Sequence[str]) -> list[str]:
    """The header, its required columns called as they are here."""
    number, header = header_line
    known = {name.casefold(): name for name in required}
    header = [known.get(name.casefold(), name) for name in header]
    if len(header) > 1 and all(is_measured(name) for name in header[2:] or header):
        raise BadRunFolder(
            f"{path} line {number}: holds numbers where the columns must be named: {','.join(required[:3])},…"
        )
    for name in required:
        if name not in header:
            raise BadRunFolder(f"{path}: no column `{name}`{did_you_mean(name, header)}{_HOLDS.get(name, '')}")
    names = [name for name in header if name]
    if len(set(names)) != len(names):
        raise BadRunFolder(f"{path}: a column name appears twice in the header")
    return header
