"""One file from the spool to the target, in small steps.

:func:`transfer` is a generator that gives control back after every piece of work, so that the loop which feeds the
watchdog never waits long. It knows no ledger and no bus: it can as well be run to its end in a child process.

Order of events: what is at the target under the name is read first; then a temporary name is written in the same
folder, flushed, read back and compared; only then it gets its name, and is read once more under it. So nobody ever
sees half a file, or one with other content than the spool's, and nothing that was there before is overwritten.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from flora_common.errors import NasDamaged, StoreError
from flora_uploader.ledger_model import mtime_ns
from flora_uploader.policy import Kind
from flora_uploader.target import Target

CHUNK_BYTES: Final = 1 << 20

SYNC_BYTES: Final = 4 << 20
"""Copied between two flushes. Behind a page cache one flush waits for all that was written since the last: so much
crosses a link of 1 Mbit/s within the watchdog's minute, and most photographs are smaller and flushed once."""


LONGEST_TOLD_BYTES: Final = 120
"""Of a file's name in that of its temporary one. File systems take 255 bytes, encrypted folders of a NAS 143."""


class SourceGone(StoreError):
    """The file is no longer in the spool."""


class SourceUnreadable(StoreError):
    """The spool's disk does not give the file out."""


class SourceChanged(StoreError):
    """The file was written to while it was read."""


class SourceDamaged(StoreError):
    """The file is not what the camera wrote."""


class SpoolIsTarget(StoreError):
    """Source and destination are one file."""


@dataclass(frozen=True, slots=True)
class Order:
    """What to send.

    Attributes:
        source: file in the spool.
        destination: path at the target.
        kind: ``once`` or ``table``.
        expected: SHA-256 that it must have; empty where nobody announced one.
        temporary_id: distinguishes the temporary names of this uploader from those of others.
    """

    source: Path
    destination: str
    kind: Kind
    expected: str
    temporary_id: str


@dataclass(frozen=True, slots=True)
class Verified:
    """What was read at the target, and the state of the spool's file that it equals.

    Attributes:
        sha256: of the content at the target.
        size: bytes of it.
        mtime_ns: of the spool's file when it was read.
        copied: False where the target had it already.
        moved_aside: new name of another file that had the name, or empty.
    """

    sha256: str
    size: int
    mtime_ns: int
    copied: bool
    moved_aside: str = ""


Steps = Generator[None, None, Verified]


def temporary_path(destination: str, temporary_id: str) -> str:
    """``.<name>.<id>.part`` in the same folder; of a long name its hash stands there, so that it is a name, too."""
    path = PurePosixPath(destination)
    name = os.fsencode(path.name)
    told = path.name if len(name) <= LONGEST_TOLD_BYTES else hashlib.sha256(name).hexdigest()[:32]
    return str(path.with_name(f".{told}{_temporary_end(temporary_id)}"))


def is_temporary_name(name: str, temporary_id: str) -> bool:
    """Whether a name at the target is a left-over of the uploader with this id."""
    return name.startswith(".") and name.endswith(_temporary_end(temporary_id))


def _temporary_end(temporary_id: str) -> str:
    return f".{temporary_id}.part"


def take_away(target: Target, temporary: str, problem: StoreError) -> None:
    """Remove a temporary file that a problem left behind; where that fails, too, the problem is told so."""
    try:
        target.remove(temporary)
    except StoreError as second:
        problem.add_note(f"and its temporary file could not be removed: {second}")


def transfer(order: Order, target: Target) -> Steps:
    """Bring one file to the target, which is connected, and prove that it is there.

    Raises:
        StoreError: see :mod:`flora_uploader.target` for the target's, the classes above for the spool's.
        NasDamaged: what was read back is not what was sent; it never had the final name, or has been found there.
    """
    with _Source(order) as source:
        if target.is_same_file(order.destination, source.status):
            raise SpoolIsTarget(f"{order.source}: the target holds this very file, not a copy; choose another target")
        there = yield from _hash_there(target, order.destination)
        is_continued = False
        if there is not None:
            here = yield from source.read(prefix=there.size if order.kind == "table" else 0)
            if here.sha256 == there.sha256:
                return Verified(here.sha256, here.size, mtime_ns(source.status), copied=False)
            is_continued = here.prefix_sha256 == there.sha256
        temporary = temporary_path(order.destination, order.temporary_id)
        target.make_folder(str(PurePosixPath(order.destination).parent))
        try:
            here = yield from _copy(source, target, temporary)
            back = yield from _hash_there(target, temporary)
            if back is None or back.sha256 != here.sha256:
                raise NasDamaged(f"{target.name}/{order.destination}: what was read back is not what was sent")
            aside = ""
            if there is not None and not is_continued:
                aside, is_kept = yield from _aside(target, order.destination, there.sha256)
                if not is_kept:
                    target.rename(order.destination, aside)
            target.rename(temporary, order.destination)
        except GeneratorExit:
            with contextlib.suppress(StoreError):  # removed at the next start
                target.remove(temporary)
            raise
        except StoreError as problem:
            take_away(target, temporary, problem)
            raise
        yield
        final = yield from _hash_there(target, order.destination)
        if final is None or final.sha256 != here.sha256:
            raise NasDamaged(f"{target.name}/{order.destination}: what was read back is not what was sent")
        return Verified(final.sha256, final.size, mtime_ns(source.status), copied=True, moved_aside=aside)


@dataclass(frozen=True, slots=True)
class _Hashed:
    sha256: str
    size: int
    prefix_sha256: str = ""


def hash_at_target(target: Target, path: str) -> Generator[None, None, str | None]:
    """SHA-256 of a file at the target, read in steps; None where there is none."""
    there = yield from _hash_there(target, path)
    return None if there is None else there.sha256


def _hash_there(target: Target, path: str) -> Generator[None, None, _Hashed | None]:
    if target.size(path) is None:
        return None
    reader = target.open(path)
    digest = hashlib.sha256()
    size = 0
    buffer = memoryview(bytearray(CHUNK_BYTES))
    try:
        while count := reader.readinto(buffer):
            digest.update(buffer[:count])
            size += count
            yield
    finally:
        reader.close()
    return _Hashed(digest.hexdigest(), size)


def _copy(source: _Source, target: Target, temporary: str) -> Generator[None, None, _Hashed]:
    writer = target.create(temporary)
    digest = hashlib.sha256()
    size = 0
    flushed = 0
    try:
        for chunk in source.chunks():
            digest.update(chunk)
            size += len(chunk)
            writer.write(chunk)
            yield
            if size - flushed >= SYNC_BYTES:
                writer.sync()
                flushed = size
                yield
        source.check(digest.hexdigest(), size)
        writer.sync()
    finally:
        writer.close()
    yield
    return _Hashed(digest.hexdigest(), size)


def _aside(target: Target, destination: str, sha256: str) -> Generator[None, None, tuple[str, bool]]:
    """``<name>.conflict-<first 8 digits of its hash>``, numbered where another file has that name; and whether the very
    same is kept there already. Two rigs that send files of one name to one place would fill it else."""
    name = f"{destination}.conflict-{sha256[:8]}"
    number = 1
    candidate = name
    while (kept := (yield from _hash_there(target, candidate))) is not None:
        if kept.sha256 == sha256:
            return candidate, True
        number += 1
        candidate = f"{name}-{number}"
    return candidate, False


class _Source:
    """The spool's file, held open: what is compared and what is copied is one and the same."""

    def __init__(self, order: Order) -> None:
        self._order = order
        self._path = order.source

    def __enter__(self) -> _Source:
        try:
            self._descriptor = os.open(self._path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
        except (FileNotFoundError, NotADirectoryError) as problem:
            raise SourceGone(f"{self._path}: vanished from the spool before it was stored") from problem
        except OSError as problem:
            raise self._unreadable(problem) from problem
        try:
            self.status = self._status_now()
        except StoreError:
            os.close(self._descriptor)
            raise
        if not stat.S_ISREG(self.status.st_mode):
            os.close(self._descriptor)
            raise SourceUnreadable(f"{self._path}: not a plain file; move it out of the run folder")
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)

    def chunks(self) -> Generator[memoryview, None, None]:
        """The content as it was when opened: lines added since then are left for the next time."""
        left = self.status.st_size
        position = 0
        buffer = memoryview(bytearray(min(CHUNK_BYTES, max(1, left))))
        while left > 0:
            try:
                count = os.preadv(self._descriptor, [buffer[: min(left, len(buffer))]], position)
            except OSError as problem:
                raise self._unreadable(problem) from problem
            if count == 0:
                raise SourceChanged(f"{self._path}: became shorter while it was read; tried again soon")
            yield buffer[:count]
            left -= count
            position += count

    def read(self, prefix: int) -> Generator[None, None, _Hashed]:
        """Hash the whole, and the first ``prefix`` bytes (where there are so many, and any)."""
        digest = hashlib.sha256()
        first = ""
        size = 0
        for chunk in self.chunks():
            if size < prefix <= size + len(chunk):
                start = digest.copy()
                start.update(chunk[: prefix - size])
                first = start.hexdigest()
            digest.update(chunk)
            size += len(chunk)
            yield
        self.check(digest.hexdigest(), size)
        return _Hashed(digest.hexdigest(), size, first)

    def check(self, sha256: str, size: int) -> None:
        """After all of it was read: it stood still, and it is what was announced."""
        order = self._order
        now = self._status_now()
        same = (now.st_size, now.st_mtime_ns) == (self.status.st_size, self.status.st_mtime_ns)
        if size != self.status.st_size or (order.kind == "once" and not same):
            raise SourceChanged(f"{self._path}: was written to while it was read; tried again soon")
        if order.expected and sha256 != order.expected:
            raise SourceDamaged(f"{self._path}: is not what the camera wrote (hash differs); it is not sent")

    def _status_now(self) -> os.stat_result:
        try:
            return os.fstat(self._descriptor)
        except OSError as problem:
            raise self._unreadable(problem) from problem

    def _unreadable(self, problem: OSError) -> SourceUnreadable:
        return SourceUnreadable(f"{self._path}: the spool cannot be read ({problem.strerror}); check its disk")
