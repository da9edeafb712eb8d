"""Photographs on the disk: the picture, its line in ``frames.jsonl``, its line in ``frames.csv``, in this order.

``frames.jsonl`` is the ledger: what is listed there has been taken. ``frames.csv`` is made good from it after a crash,
a full disk, or a power cut that has left its end unreadable. No photograph of the run is ever written over; one of the
empty setup gives way to a newer one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec

from flora_capture.core import Exposure, exposure_of
from flora_common.errors import BadRunFolder, StoreError
from flora_common.files import append_line, damaged_name, last_lines, sha256_of_bytes, sha256_of_file, write_bytes
from flora_common.messages import Frame
from flora_common.messages.catalogue import Purpose
from flora_common.messages.envelope import Seconds, as_sentence
from flora_common.runs import Light, RunFolder

SHOT_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,58}\.jpg")
TAIL_BYTES: Final = 4096
"""A line of ``frames.csv`` is under 600 bytes."""


class FrameRecord(msgspec.Struct, frozen=True):
    """A line of ``frames.jsonl``.

    Attributes:
        tick: that it was taken in.
        file: inside the run folder.
        sha256, bytes: of that file.
        width_px, height_px: of the photograph.
        purpose: whether it shows the plant or the empty setup.
        light: the lamps that shone.
        flash: whether the flash lamp was confirmed lit.
        time_s: since the run's start.
        t_utc_ns: when, wall clock, nanoseconds since 1970.
        exposure_note: what is wrong with its exposure; empty where nothing is.
        metadata: as the camera gave them.
    """

    tick: int
    file: str
    sha256: str
    bytes: int
    width_px: int
    height_px: int
    purpose: Purpose
    light: Light
    flash: bool
    time_s: float
    t_utc_ns: int
    exposure_note: str = ""
    metadata: dict[str, Any] = {}

    def message(self, run: str) -> Frame:
        """What is announced of it."""
        exposure: Exposure = exposure_of(self.metadata)
        return Frame(
            tick=self.tick,
            time_s=self.time_s,
            path=self.file,
            run=run,
            sha256=self.sha256,
            bytes=self.bytes,
            width_px=self.width_px,
            height_px=self.height_px,
            light=self.light,
            flash_confirmed=self.flash,
            exposure_ok=not self.exposure_note,
            exposure_note=as_sentence(self.exposure_note),
            exposure_us=exposure.exposure_us,
            analogue_gain=exposure.analogue_gain,
            digital_gain=exposure.digital_gain,
            red_gain=exposure.red_gain,
            blue_gain=exposure.blue_gain,
            purpose=self.purpose,
        )


class Store:
    """The photographs of one run.

    Attributes:
        run_name: the run folder's own name.
        last: the photograph with the highest tick, or None.
        taken: photographs of the run itself, without those of the empty setup.
        mended: what was done about a damaged end of ``frames.csv``, in one sentence; empty where nothing was.

    Raises:
        BadRunFolder: the end of ``frames.csv`` is damaged and cannot be mended, or one of the tables cannot be read.
    """

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self._place = run.place
        self.run_name = run.name
        self.last: FrameRecord | None = None
        self.taken = 0
        self.mended = ""
        self._csv_time_s = self._time_of_csv()
        self._not_in_csv: list[FrameRecord] = []
        for record in _read_records(run.frames_log):
            self._note(record)

    def _time_of_csv(self) -> float:
        file = self._run.frames_csv
        try:
            return _last_time_s(file)
        except BadRunFolder as problem:
            try:
                aside, lost = _without_damaged_end(file)
            except (OSError, StoreError) as second:
                raise problem from second
            self.mended = f"{file}: {lost} damaged lines at its end are made anew; as it was it is kept as {aside}"
            return _last_time_s(file)

    def _note(self, record: FrameRecord) -> None:
        if self.last is None or record.tick >= self.last.tick:
            self.last = record
        if record.purpose == "run":
            self.taken += 1
            if _csv_time_s(record) > self._csv_time_s:
                self._not_in_csv.append(record)

    def name_for(self, tick: int, purpose: Purpose, shot: str) -> str:
        """The file that a photograph is to become, inside the run folder.

        Raises:
            StoreError: a name for a picture of the empty setup that is none, or the run is no longer where it was.
        """
        self._run.check_place(self._place)
        if purpose == "background":
            if not SHOT_NAME.fullmatch(shot):
                raise StoreError(f"`{shot}` is not a name for a picture of the empty setup, such as left.jpg")
            return f"background/{shot}"
        name, number = f"frames/{tick:06d}.jpg", 1
        while (self._run.path / name).exists():  # written, but killed before it was listed
            number += 1
            name = f"frames/{tick:06d}-{number}.jpg"
        return name

    def whole(self, record: FrameRecord) -> bool:
        """Whether a listed photograph is on the disk as it was taken."""
        try:
            return sha256_of_file(self._run.path / record.file) == record.sha256
        except OSError:
            return False

    def add(self, jpeg: bytes, record: FrameRecord) -> FrameRecord:
        """Write a photograph and list it; returns the record with size and hash filled in.

        Raises:
            DiskFull: no room; nothing is left half written.
            OSError: the disk refuses.
        """
        record = msgspec.structs.replace(record, sha256=sha256_of_bytes(jpeg), bytes=len(jpeg))
        write_bytes(self._run.path / record.file, jpeg)
        append_line(self._run.frames_log, msgspec.json.encode(record).decode())
        self._note(record)
        return record

    def complete_csv(self) -> None:
        """Add the lines that ``frames.csv`` still lacks.

        Raises:
            DiskFull: no room; they are added later.
        """
        while self._not_in_csv:
            record = self._not_in_csv[0]
            if _csv_time_s(record) > self._csv_time_s:
                self._run.append_frame(record.file, record.time_s, record.light)
                self._csv_time_s = _csv_time_s(record)
            self._not_in_csv.pop(0)


def _csv_time_s(record: FrameRecord) -> float:
    """As ``frames.csv`` has it, in milliseconds: a time that reads the same there is the same."""
    return round(record.time_s, 3)


def _read_records(file: Path) -> Iterator[FrameRecord]:
    decoder = msgspec.json.Decoder(FrameRecord)
    try:
        with file.open("rb") as lines:
            for line in lines:
                try:
                    yield decoder.decode(line)
                except (ValueError, RecursionError):
                    continue  # torn by a power cut; the picture is there and keeps its name
    except FileNotFoundError:
        return
    except OSError as problem:
        raise _unreadable(file, problem) from problem


def _unreadable(file: Path, problem: OSError) -> BadRunFolder:
    return BadRunFolder(f"{file}: cannot be read ({problem.strerror}); check its disk and permissions")


def _last_time_s(file: Path) -> float:
    """Time of the last whole line of ``frames.csv``; below every time where there is none."""
    try:
        lines = last_lines(file, TAIL_BYTES)
    except OSError as problem:
        raise _unreadable(file, problem) from problem
    if not lines or lines[-1].startswith(b"file,"):
        return -1.0
    try:
        return _time_s_of(lines[-1])
    except (IndexError, ValueError) as problem:
        raise BadRunFolder(f"{file}: the last line is damaged ({lines[-1][:60]!r}); mend or remove it") from problem


def _time_s_of(line: bytes) -> float:
    return msgspec.convert(float(line.split(b",")[1]), Seconds)


def _without_damaged_end(file: Path) -> tuple[Path, int]:
    """Cut off the lines at the end that tell no time; the whole file is kept beside it first.

    Returns:
        Where it is kept, and how many lines were cut off.

    Raises:
        StoreError: no room on the disk.
        OSError: it cannot be read or written.
    """
    data, aside = file.read_bytes(), damaged_name(file)
    lines = data.split(b"\n")[:-1]
    whole = len(lines)
    while whole and not _is_whole(lines[whole - 1]):
        whole -= 1
    write_bytes(aside, data)
    write_bytes(file, b"".join(line + b"\n" for line in lines[:whole]))
    return aside, len(lines) - whole


def _is_whole(line: bytes) -> bool:
    try:
        return line.startswith(b"file,") or _time_s_of(line) >= 0.0
    except (IndexError, ValueError):
        return False
