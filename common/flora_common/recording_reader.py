"""Reading recordings back, whole or not: as far as they are whole, and finishing those that a crash left open."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from flora_common.errors import BadInput
from flora_common.files import CHUNK_BYTES as READ_BYTES
from flora_common.files import atomic_writer, fsync_folder
from flora_common.recording import CHUNK_BYTES, OPEN_SUFFIX, PROFILE, UNREADABLE, store_error

DAMAGED_SUFFIX: Final = ".damaged"

MAX_RECORD_BYTES: Final = 64 << 20
"""A longer MCAP record, or chunk unpacked, is not one of ours: it is refused before memory is taken for it."""

_FOOTER_BYTES: Final = 1 + 8 + 8 + 8 + 4
"""Of the record at the end of a file, whose last four are the check sum of the index before it, and of itself."""

_TORN: Final = (McapError, ValueError, KeyError, OverflowError, struct.error, zstandard.ZstdError, EOFError)
"""What the library raises on files that are cut or damaged. CRC failures and bad text are ValueErrors."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message of a recording.

    Attributes:
        topic: ``<rig>/<kind>``; kind is :data:`UNREADABLE` for what did not fit the catalogue.
        log_time_ns: UTC at sending.
        payload: the bytes as they were on the bus.
        sequence: its sequence number, modulo 2**32.
    """

    topic: str
    log_time_ns: int
    payload: bytes
    sequence: int

    @property
    def is_readable(self) -> bool:
        """False for what did not fit the catalogue when it was recorded."""
        return not self.topic.endswith(UNREADABLE)


class _Strict:
    """A file whose reads are whole or fail: the library itself takes short reads, and memory for any length told."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        file.seek(0)

    def read(self, length: int) -> bytes:
        if length > self._size - self._file.tell():
            raise EOFError("the file ends before that")
        return self._file.read(length)


class RecordingReader:
    """Reads a recording from its start as far as it is whole; iterate for :class:`Recorded`.

    Attributes:
        problem: after the last message: what is wrong with the rest, or empty where the file is whole.
        metadata: what the recording says of itself.
        whole_bytes: length of the part of the file that could be read.

    Raises:
        BadInput: no such file, or not an MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem = ""
        self.metadata: dict[str, str] = {}
        self.whole_bytes = 0
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        try:
            if path.exists() and not path.is_file():  # a pipe would be waited for without end
                raise BadInput(f"{path}: not a regular file, hence not a recording")
            with path.open("rb") as file:
                magic = file.read(8)
        except OSError as problem:
            raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
        if magic[:5] != b"\x89MCAP":
            raise BadInput(f"{path}: not an MCAP file")

    def __iter__(self) -> Iterator[Recorded]:
        for message in self.messages():
            topic = self.channels[message.channel_id].topic
            yield Recorded(topic, message.log_time, message.data, message.sequence)

    def messages(self) -> Iterator[Message]:
        """The library's message records; ``schemas`` and ``channels`` hold what they refer to."""
        self.problem = ""
        with self.path.open("rb") as file:
            try:
                yield from self._messages(file)
            except _TORN as problem:
                text = str(problem) or type(problem).__name__
                self.problem = f"not readable after byte {self.whole_bytes} ({text})"

    def _messages(self, file: IO[bytes]) -> Iterator[Message]:
        reader = StreamReader(
            _Strict(file),  # type: ignore[arg-type]  # of a stream it uses nothing but read
            emit_chunks=True,
            validate_crcs=True,
            record_size_limit=MAX_RECORD_BYTES,
        )
        self.whole_bytes = 0
        for record in reader.records:
            for item in _unpacked(record) if isinstance(record, Chunk) else [record]:
                if isinstance(item, Schema):
                    self.schemas[item.id] = item
                elif isinstance(item, Channel):
                    self.channels[item.id] = item
                elif isinstance(item, Metadata):
                    self.metadata.update(item.metadata)
                elif isinstance(item, Message):
                    if record is item:
                        raise ValueError("a message outside of a chunk, where no check sum covers it")
                    if item.channel_id not in self.channels:
                        raise ValueError(f"a message of channel {item.channel_id}, which is not declared")
                    yield item
            self.whole_bytes = file.tell()
            if isinstance(record, Footer) and not _is_index_whole(file, record):
                self.problem = (
                    "damaged index: every message is there, but players that go by it may not find them; named "
                    f"{self.path.name.removesuffix(OPEN_SUFFIX)}{OPEN_SUFFIX} in a run's bus/ it is recovered at the "
                    "next start of flora-recorder"
                )


def _is_index_whole(file: IO[bytes], footer: Footer) -> bool:
    """Whether what follows the messages, by which players find them, has the check sum that the footer tells.

    Args:
        file: the recording, behind the footer, where it is afterwards.
        footer: one without a check sum tells nothing.
    """
    end = file.tell()
    start = footer.summary_start or end - _FOOTER_BYTES
    if footer.summary_crc == 0 or start > end:
        return footer.summary_crc == 0
    file.seek(start)
    left, found = end - 4 - start, 0
    while left > 0 and (piece := file.read(min(left, READ_BYTES))):
        found = zlib.crc32(piece, found)
        left -= len(piece)
    file.seek(end)
    return found == footer.summary_crc


def _unpacked(chunk: Chunk) -> list[Any]:
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, zstandard.frame_content_size(chunk.data))
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes, at most {MAX_RECORD_BYTES} are read")
    return list(breakup_chunk(chunk, validate_crc=True))


@dataclass(slots=True)
class Recovered:
    """What became of a recording that was left open.

    Attributes:
        path: where it is now; None where there was nothing in it and it was removed.
        messages: how many are in it.
        problem: what the end of the open file looked like; empty for one that only lacked its final name.
    """

    path: Path | None
    messages: int
    problem: str


def recover(open_path: Path) -> Recovered:
    """Turn a left-over ``.open`` file into a proper recording of all that is whole in it.

    Safe to be killed in, and to be done twice. A file in which nothing can be read, though there is something in it,
    is kept as ``….damaged``.

    Raises:
        DiskFull: no room; the open file stays.
        StoreError: the folder cannot be written.
    """
    final = open_path.with_name(open_path.name.removesuffix(OPEN_SUFFIX))
    try:
        if open_path.stat().st_size == 0:
            open_path.unlink()
            return Recovered(None, 0, "empty")
        try:
            reader = RecordingReader(open_path)
        except BadInput as problem:
            return Recovered(_set_aside(open_path), 0, str(problem))
        count = _rewrite(reader, final)
        if count == 0:
            final.unlink()
            if reader.whole_bytes == open_path.stat().st_size:
                open_path.unlink()
                return Recovered(None, 0, reader.problem)
            return Recovered(_set_aside(open_path), 0, reader.problem)
        open_path.unlink()
        fsync_folder(final.parent)
    except OSError as problem:
        raise store_error(final, problem) from problem
    return Recovered(final, count, reader.problem)


def _set_aside(open_path: Path) -> Path:
    aside = open_path.with_name(open_path.name.removesuffix(OPEN_SUFFIX) + DAMAGED_SUFFIX)
    open_path.rename(aside)
    fsync_folder(aside.parent)
    return aside


@dataclass(slots=True)
class _Renumbered:
    schemas: dict[int, int] = field(default_factory=dict)
    channels: dict[int, int] = field(default_factory=dict)


def _rewrite(reader: RecordingReader, final: Path) -> int:
    count = 0
    numbers = _Renumbered()
    with atomic_writer(final) as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile=PROFILE)
        for message in reader.messages():
            writer.add_message(
                _renumbered_channel(message.channel_id, reader, writer, numbers),
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
            count += 1
        writer.add_metadata("flora", {**reader.metadata, "recovered": reader.problem or "whole"})
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _renumbered_channel(old: int, reader: RecordingReader, writer: Writer, numbers: _Renumbered) -> int:
    if old not in numbers.channels:
        channel = reader.channels[old]
        schema = reader.schemas.get(channel.schema_id)
        if channel.schema_id not in numbers.schemas:
            numbers.schemas[channel.schema_id] = (
                writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            )
        numbers.channels[old] = writer.register_channel(
            channel.topic, channel.message_encoding, numbers.schemas[channel.schema_id], channel.metadata
        )
    return numbers.channels[old]
