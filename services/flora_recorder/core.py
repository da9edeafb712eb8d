"""The recorder without a bus: which file is open, when the next one begins, what a full disk does."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common.bus import Arrival
from flora_common.clock import NS, Clock
from flora_common.counted import counted
from flora_common.errors import StoreError
from flora_common.messages import Recording
from flora_common.recording import OPEN_SUFFIX, RecordingWriter, is_being_written, store_error
from flora_common.recording_reader import Recovered, recover

MIB: Final = 1 << 20
_NUMBER: Final = re.compile(r"-(\d+)\.mcap")


def number_of(path: Path) -> int:
    """The running number in a recording's name; 0 for a name without one."""
    found = _NUMBER.search(path.name)
    return int(found.group(1)) if found else 0


class RecorderSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[recorder]``: when what was heard goes to the disk, and when a new file is begun."""

    flush_s: Annotated[float, msgspec.Meta(ge=0.05, le=60.0)] = 60.0
    """Real seconds between flushes: what a power cut can cost."""

    rotate_h: Annotated[float, msgspec.Meta(ge=0.1, le=168.0)] = 24.0
    """Rig hours per file."""

    rotate_mib: Annotated[float, msgspec.Meta(ge=0.01, le=1024.0)] = 16.0
    """Size per file; a file that was left open by a crash is read whole at the next start."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When a new file is begun."""

    rotate_bytes: int
    rotate_ns: int

    @classmethod
    def of(cls, section: RecorderSection) -> Limits:
        return cls(round(section.rotate_mib * MIB), round(section.rotate_h * 3600 * NS))


class Recorder:
    """Writes what it hears into files of one folder.

    Args:
        folder: ``bus/`` of the run folder.
        rig: for messages that do not tell theirs.
        limits: when a new file is begun.
        clock: rig time.
        say: told about the file at its start, at its end and with each flush.
        on_gone: told in a sentence about a file that was deleted or moved while it was written.
        check_place: asked before a file is begun; raises StoreError where the folder is no longer the run's.
        metadata: for each file.
    """

    def __init__(
        self,
        folder: Path,
        *,
        rig: str,
        limits: Limits,
        clock: Clock,
        say: Callable[[Recording], None],
        on_gone: Callable[[str], None],
        check_place: Callable[[], None] = lambda: None,
        metadata: dict[str, str] | None = None,
    ) -> None:
        self._lost = 0
        self._folder = folder
        self._rig = rig
        self._limits = limits
        self._clock = clock
        self._say = say
        self._on_gone = on_gone
        self._check_place = check_place
        self._metadata = {"rig": rig, **(metadata or {})}
        self._writer: RecordingWriter | None = None
        self._opened_ns = 0
        self._last_number = 0
        self._is_stalled = False

    def recover_left_over(self) -> list[Recovered]:
        """Finish what a crash left open; a recording that another process writes is none.

        Raises:
            StoreError: no room, or the folder cannot be written; call again later.
        """
        try:
            for stale in self._folder.glob(".*.mcap.*.part"):
                stale.unlink()  # of a recovery that was killed
            current = self._writer.open_path if self._writer else None
            left_over = sorted(
                path
                for path in self._folder.glob(f"*.mcap{OPEN_SUFFIX}")
                if path != current and not is_being_written(path)
            )
        except OSError as problem:
            raise store_error(self._folder, problem) from problem
        return [recover(path) for path in left_over]

    def hear(self, arrival: Arrival) -> None:
        """Record one arrival; begins a new file where the time or size is reached.

        After an error the disk is left alone until :meth:`flush`: what is heard meanwhile waits in memory, within
        limits, and is counted as lost beyond them.

        Raises:
            StoreError: the disk is full or gone.
        """
        if self._writer is None and not self._is_stalled:
            try:
                with self._stalling():
                    self._open()
            except StoreError:
                self._lost += 1
                raise
        if self._writer is None:
            self._lost += 1
            return
        self._writer.add(arrival, utc_ns=self._clock.utc_ns(), rig=self._rig)
        if self._is_stalled:
            return
        with self._stalling():
            if self._is_due(self._writer):
                self.rotate()
            elif self._writer.wants_flush:
                self._writer.flush()

    @contextlib.contextmanager
    def _stalling(self) -> Iterator[None]:
        try:
            yield
        except StoreError:
            self._is_stalled = True
            raise

    def _is_due(self, writer: RecordingWriter) -> bool:
        age_ns = self._clock.mono_ns() - self._opened_ns
        return writer.bytes >= self._limits.rotate_bytes or age_ns >= self._limits.rotate_ns

    def flush(self) -> None:
        """Put on the disk what waits, and say how the recording is.

        A file that was deleted or moved while it was written is left behind, and a new one is begun, unless the run
        folder itself was moved away.

        Raises:
            StoreError: as :meth:`hear`.
        """
        with self._stalling():
            self._leave_if_gone()
            if self._writer is None:
                self._open()
            elif self._is_due(self._writer):
                self.rotate()
            else:
                self._writer.flush()
                self._tell(self._writer, closed=False)
        self._is_stalled = False

    def rotate(self) -> None:
        """Finish the file and begin the next.

        Raises:
            StoreError: no room. The present file goes on, or is left open for the next start to recover.
        """
        self._leave_if_gone()
        self.close()
        self._open()

    def close(self) -> None:
        """Finish the file.

        Raises:
            StoreError: no room; all that was flushed is in the open file.
        """
        writer = self._writer
        if writer is None:
            return
        writer.flush()  # where this fails the file stays open and all waits
        self._writer = None
        self._lost += writer.lost
        writer.close()
        self._tell(writer, closed=True)

    def _leave_if_gone(self) -> None:
        writer = self._writer
        if writer is None or writer.is_in_place:
            return
        self._writer = None
        self._lost += writer.lost
        writer.leave()
        self._on_gone(
            f"{writer.open_path} was deleted or moved while it was written, with {counted(writer.messages, 'message')};"
            f" the recording goes on in a new file{self._unless_out_of_place()}"
        )

    def _unless_out_of_place(self) -> str:
        try:
            self._check_place()
        except StoreError:
            return " once the run folder is back"
        return ""

    @property
    def lost(self) -> int:
        """Messages that could not be recorded since the start, for want of room."""
        return self._lost + (self._writer.lost if self._writer else 0)

    def _open(self) -> None:
        self._check_place()
        try:
            path = self._free_name()
        except OSError as problem:
            raise store_error(self._folder, problem) from problem
        self._writer = RecordingWriter(path, metadata=self._metadata)
        self._opened_ns = self._clock.mono_ns()
        self._last_number = number_of(self._writer.path)
        self._writer.flush()
        self._tell(self._writer, closed=False)

    def _free_name(self) -> Path:
        """``<utc>-<n>.mcap``: n goes on from the files that are there, so that order and names survive a set clock.

        It goes on from the last one opened too: no name means two recordings, even where the folder was emptied.
        """
        stamp = datetime.fromtimestamp(self._clock.utc_ns() // NS, UTC).strftime("%Y%m%dT%H%M%SZ")
        number = 1 + max([self._last_number, *map(number_of, self._folder.glob("*.mcap*"))])
        return self._folder / f"{stamp}-{number:04d}.mcap"

    def _tell(self, writer: RecordingWriter, *, closed: bool) -> None:
        self._say(
            Recording(
                path=f"{self._folder.name}/{writer.path.name}",
                messages=writer.messages,
                bytes=writer.bytes,
                bad=writer.bad,
                closed=closed,
            )
        )
