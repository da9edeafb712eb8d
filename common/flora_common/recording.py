"""Bus recordings: MCAP files of msgpack messages, written so that a power cut costs the last minute and no more.

A recording is called ``<name>.mcap.open`` until it is finished, and ``<name>.mcap`` from then on, so whoever collects
recordings takes only whole ones. Everything goes to the disk in whole MCAP chunks: what :meth:`RecordingWriter.flush`
has written is readable even when nothing after it is. Format: https://mcap.dev/spec; one channel per topic, message
encoding ``msgpack``, and a JSON Schema each, which PlotJuggler asks for.

What does not fit the catalogue is recorded too, on a channel of its own (:data:`UNREADABLE`): a map of the frames as
they came and the reason.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from typing import IO, Any, Final

import msgspec
from mcap.writer import CompressionType, Writer

from flora_common.bus import Arrival
from flora_common.errors import BadInput, DiskFull, StoreError
from flora_common.files import fsync_folder, make_folder, write_all
from flora_common.messages.envelope import TopicSpec, as_sentence, spec_of
from flora_common.messages.reference import catalogue_hash, schema_of

OPEN_SUFFIX: Final = ".open"
UNREADABLE: Final = "~unreadable"
"""Last part of the topic of messages that do not fit the catalogue; no real topic can be called so."""

PROFILE: Final = "flora"
CHUNK_BYTES: Final = 256 * 1024
MAX_PENDING_BYTES: Final = 4 << 20
"""What waits in memory while the disk is full; beyond it, messages are counted as lost."""


MAX_FRAMES: Final = 16
MAX_FRAME_BYTES: Final = 64 * 1024
"""What is recorded of an unreadable message; no message of ours is nearly as large."""


class Unreadable(msgspec.Struct, frozen=True):
    """A message that does not fit the catalogue, as recorded: at most 16 frames of at most 64 KiB."""

    topic: str
    reason: str
    frames: list[bytes]
    t_utc_ns: int


class _Tail:
    """The stream that the MCAP library writes to: bytes wait here until they are put on the disk as a whole."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._pending = bytearray()
        self.committed = 0

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self.committed + len(self._pending)

    def flush(self) -> None:
        """The library's own flush; the disk is reached by :meth:`commit` only."""

    @property
    def pending(self) -> int:
        return len(self._pending)

    def commit(self) -> None:
        """Append what waits and flush it to the disk; after an error the file is as long as it was, and all waits on.

        Raises:
            OSError: as the disk says.
        """
        if not self._pending:
            return
        try:
            write_all(self._file, self._pending)
            os.fsync(self._file.fileno())
        except OSError:
            self._file.seek(self.committed)
            self._file.truncate()
            raise
        self.committed += len(self._pending)
        self._pending.clear()


def is_being_written(open_path: Path) -> bool:
    """Whether a living process writes this recording, such as that of somebody who records by hand.

    Where the file cannot be opened, or its file system has no locks, nobody is taken to write it.
    """
    try:
        with open_path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


class RecordingWriter:
    """Writes one recording.

    Args:
        path: its final name; it is written as ``path`` + ``.open``.
        metadata: what the recording should know of itself, such as the rig and the run.

    Attributes:
        messages: recorded, unreadable ones included.
        bad: unreadable ones among them.
        lost: not recorded, because the disk was full for too long.

    Raises:
        BadInput: the file exists already.
        StoreError: it cannot be created.
    """

    def __init__(self, path: Path, *, metadata: dict[str, str] | None = None) -> None:
        self.path = path
        self.open_path = path.with_name(path.name + OPEN_SUFFIX)
        self.messages = 0
        self.bad = 0
        self.lost = 0
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        try:
            for taken in (self.path, self.open_path):
                if taken.exists():
                    raise BadInput(f"{taken}: exists already; choose another name")
            make_folder(path.parent)
            self._file = self.open_path.open("xb", buffering=0)
            # Until its end, or that of the process: who looks for what a crash has left open leaves it alone.
            with contextlib.suppress(OSError):  # waited for: who looks whether it is held holds it for a moment
                fcntl.flock(self._file, fcntl.LOCK_EX)
            fsync_folder(path.parent)
        except OSError as problem:
            raise store_error(self.open_path, problem) from problem
        self._tail = _Tail(self._file)
        self._writer = Writer(self._tail, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self._writer.start(profile=PROFILE)
        self._writer.add_metadata("flora", {"catalogue": catalogue_hash(), **(metadata or {})})

    @property
    def bytes(self) -> int:
        """Length of the file, counting what still waits to be written."""
        return self._tail.tell()

    def add(self, arrival: Arrival, *, utc_ns: int, rig: str = "") -> None:
        """Record an arrival; repeated ones are left out.

        Args:
            arrival: from the bus.
            utc_ns: time for those that do not tell theirs.
            rig: for the topic of unreadable ones.
        """
        if arrival.verdict == "repeated":
            return
        if self._tail.pending > MAX_PENDING_BYTES:
            self.lost += 1
            return
        self.messages += 1
        message = arrival.message
        if message is None:
            self.bad += 1
            name = arrival.parts[0].decode("utf-8", "backslashreplace")[:200]
            payload = msgspec.msgpack.encode(
                Unreadable(name, as_sentence(arrival.reason), _bounded(arrival.parts), utc_ns)
            )
            self._writer.add_message(self._channel_of_unreadable(rig), utc_ns, payload, utc_ns)
            return
        spec = spec_of(type(message))
        self._writer.add_message(
            self._channel(f"{arrival.rig}/{spec.kind}", spec),
            message.t_utc_ns,
            arrival.parts[1],
            message.t_utc_ns,
            sequence=message.seq % 2**32,
        )

    def _channel(self, topic: str, spec: TopicSpec) -> int:
        if topic not in self._channels:
            schema = self._schema(f"flora.{spec.kind}", schema_of(spec))
            self._channels[topic] = self._writer.register_channel(
                topic, "msgpack", schema, {"owner": spec.owner, "version": str(spec.version)}
            )
        return self._channels[topic]

    def _channel_of_unreadable(self, rig: str) -> int:
        topic = f"{rig}/{UNREADABLE}" if rig else UNREADABLE
        if topic not in self._channels:
            schema = self._schema("flora.unreadable", msgspec.json.schema(Unreadable))
            self._channels[topic] = self._writer.register_channel(topic, "msgpack", schema)
        return self._channels[topic]

    def _schema(self, name: str, schema: dict[str, Any]) -> int:
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(name, "jsonschema", msgspec.json.encode(schema))
        return self._schemas[name]

    def flush(self) -> None:
        """Close the chunk and put it on the disk.

        Raises:
            DiskFull, StoreError: it could not be written; everything waits in memory and the next flush tries again.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._commit()

    def _commit(self) -> None:
        try:
            self._tail.commit()
        except OSError as problem:
            raise store_error(self.open_path, problem) from problem

    @property
    def wants_flush(self) -> bool:
        """More than a chunk waits in memory."""
        return self._tail.pending > CHUNK_BYTES

    @property
    def is_in_place(self) -> bool:
        """Whether the file is still the one of its name; it may have been deleted or moved, its folder with it."""
        try:
            there = self.open_path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True  # a disk that does not answer is told by the next flush
        return os.path.samestat(there, os.fstat(self._file.fileno()))

    def leave(self) -> None:
        """Finish a file that is no longer in place, as far as possible; where it was only moved, it is whole there."""
        with contextlib.suppress(StoreError):
            self.flush()
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._commit()
        self._file.close()

    def close(self) -> Path:
        """Finish the file and give it its final name.

        Raises:
            DiskFull, StoreError: there is no room for the end of the file. It keeps its ``.open`` name with all that
                was flushed before, for :func:`recover` to finish; where that is nothing, nothing is left.
        """
        try:
            self.flush()
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._commit()
        except StoreError:
            if self._tail.committed == 0 and self.is_in_place:
                self.open_path.unlink()
            raise
        finally:
            self._file.close()
        try:
            self.open_path.rename(self.path)
            fsync_folder(self.path.parent)
        except OSError as problem:
            raise store_error(self.path, problem) from problem
        return self.path


def _bounded(parts: list[bytes]) -> list[bytes]:
    return [part[:MAX_FRAME_BYTES] for part in parts[:MAX_FRAMES]]


def store_error(path: Path, problem: OSError) -> StoreError:
    if problem.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFull(f"{path}: no room on the disk; free some space")
    return StoreError(f"{path}: cannot be written ({problem.strerror})")
