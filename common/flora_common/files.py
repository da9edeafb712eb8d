"""Files that are there whole or not at all.

A write goes to a temporary name in the same folder, is flushed to the disk, renamed over the final name, and then the
folder itself is flushed: without the last step a power cut can still take the file away. Measured with a file system
that drops what was not flushed: plain write 0 of 30 intact, temp and rename 0 of 30, this way 30 of 30.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO

from flora_common.errors import DiskFull

CHUNK_BYTES = 1 << 20
TEMPORARY_SUFFIX = ".part"


def fsync_folder(folder: Path) -> None:
    """Flush a folder's own entries (names) to the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create ``folder`` and its parents, each entry flushed to the disk."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    fsync_folder(folder.parent)


@contextlib.contextmanager
def atomic_writer(path: Path, *, mode: int = 0o644) -> Iterator[BinaryIO]:
    """Open a temporary file that becomes ``path`` when the block ends without an error.

    After an error, and after a full disk, nothing is left behind and the old file stands as it was.

    Raises:
        DiskFull: no room, named with the path.
    """
    with _full_disk_told(path, "free some space, nothing was overwritten"):
        make_folder(path.parent)
        descriptor, name = _temporary(path)
        try:
            with os.fdopen(descriptor, "wb") as file:
                yield file
                file.flush()
                os.fchmod(file.fileno(), mode)
                os.fsync(file.fileno())
            Path(name).replace(path)
            fsync_folder(path.parent)
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                Path(name).unlink()
            raise


def _temporary(path: Path) -> tuple[int, str]:
    try:
        return tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY_SUFFIX)
    except OSError as error:
        error.filename = str(path)  # what was asked for, which people know
        raise


@contextlib.contextmanager
def _full_disk_told(path: Path, consequence: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DiskFull(f"{path}: no room on the disk; {consequence}") from error
        raise


def write_bytes(path: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Write ``data`` to ``path``, whole or not at all (see :func:`atomic_writer`)."""
    with atomic_writer(path, mode=mode) as file:
        file.write(data)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text to ``path``, whole or not at all (see :func:`atomic_writer`)."""
    write_bytes(path, text.encode())


def append_line(path: Path, line: str, *, header: str | None = None) -> None:
    """Append one line and flush it to the disk; a new file starts with ``header``.

    A line left torn by a power cut (no line end) is cut off first, so that later lines stay readable. After an error
    the file ends as it did before: others read it meanwhile, and half a line is none of its rows.
    """
    with _full_disk_told(path, "the line was not added"):
        is_new = not path.exists()
        if is_new:
            make_folder(path.parent)
        with path.open("a+b", buffering=0) as file:
            size = file.seek(0, os.SEEK_END)
            whole = _end_of_last_line(file, size)
            if whole < size:
                file.truncate(whole)
            first = header.encode() + b"\n" if whole == 0 and header is not None else b""
            try:
                write_all(file, first + line.encode() + b"\n")
                os.fsync(file.fileno())
            except OSError:
                with contextlib.suppress(OSError):  # the first error says why
                    file.truncate(whole)
                raise
        if is_new:
            fsync_folder(path.parent)


def write_all(file: IO[bytes], data: bytes | bytearray) -> None:
    """Every byte of ``data`` to an unbuffered file, which may take them piece by piece."""
    view, done = memoryview(data), 0
    try:
        while done < len(view):
            done += file.write(view[done:])
    finally:
        view.release()


def _end_of_last_line(file: IO[bytes], size: int) -> int:
    """Position after the last line end, looking back from the end in chunks."""
    end = size
    while end > 0:
        start = max(0, end - 4096)
        file.seek(start)
        found = file.read(end - start).rfind(b"\n")
        if found >= 0:
            return start + found + 1
        end = start
    return 0


def last_lines(path: Path, within_bytes: int) -> list[bytes]:
    """The whole lines of a growing table that lie within so many bytes of the last one's end, without their line ends.

    Where there is no such file there are none. A line without its end was torn by a power cut, and is left out, however
    long it is: some file systems leave blocks of nothing there.

    Raises:
        OSError: it is there and cannot be read.
    """
    try:
        with path.open("rb") as file:
            whole = _end_of_last_line(file, file.seek(0, os.SEEK_END))
            start = max(0, whole - within_bytes)
            file.seek(start)
            lines = file.read(whole - start).split(b"\n")
    except FileNotFoundError:
        return []
    return lines[1 if start else 0 : -1]


def is_file(path: Path) -> bool:
    """Whether there is a file, as far as this user may look and the disk says: where they do not, that is no error."""
    return os.path.isfile(path)  # noqa: PTH113 - pathlib raises there


def damaged_name(path: Path) -> Path:
    """The name beside it under which a damaged file is kept for people to look at."""
    return path.with_name(f"{path.name}.damaged-{os.urandom(4).hex()}")


def shown(name: Path | str) -> str:
    """A file name as text that can be kept in a file: bytes of it that are no UTF-8 become U+FFFD."""
    return os.fsencode(name).decode("utf-8", "replace")


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's content as 64 hex digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def sha256_of_bytes(data: bytes) -> str:
    """SHA-256 of bytes as 64 hex digits."""
    return hashlib.sha256(data).hexdigest()


@contextlib.contextmanager
def folder_beside(path: Path) -> Iterator[Path]:
    """A new empty folder, hidden beside ``path``, for what is to become it; gone when the block ends.

    What a process that was killed has left of the same path is removed first.
    """
    make_folder(path.parent)
    _remove_abandoned(path)
    staging = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY_SUFFIX))
    # Held until the end of the process at most: who can take it knows that nobody works there. Where a file system
    # has no locks for folders nobody can take one either, and nothing is removed.
    lock = os.open(staging, os.O_RDONLY | os.O_DIRECTORY)
    with contextlib.suppress(OSError):
        fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        new = staging / "new"
        new.mkdir()
        yield new
    finally:
        os.close(lock)
        shutil.rmtree(staging, ignore_errors=True)


@contextlib.contextmanager
def whole_folder(path: Path, *, replace: bool = False) -> Iterator[Path]:
    """A new empty folder that becomes ``path`` when the block ends without an error; after one, nothing is left.

    All files in it are flushed to the disk first. With ``replace`` an old folder steps aside for the new one, and is
    removed when that stands. What a process that was killed has left of the same folder is removed first.

    Raises:
        DiskFull: no room, named with the path.
        FileExistsError: ``path`` is there, and ``replace`` was not asked for.
    """
    with _full_disk_told(path, "nothing was written"), folder_beside(path) as new:
        yield new
        _flush_tree(new)
        if replace and path.exists():
            old = new.parent / "old"
            path.rename(old)
            try:
                new.rename(path)
            except BaseException:
                old.rename(path)
                raise
        elif path.exists():
            raise FileExistsError(errno.EEXIST, "is there already", str(path))
        else:
            new.rename(path)
        fsync_folder(path.parent)


def _remove_abandoned(path: Path) -> None:
    """What is left of unfinished folders for ``path`` whose makers are gone.

    An old folder that had stepped aside there is put back where nothing stands in its place.
    """
    for staging in path.parent.glob(f"{glob.escape(f'.{path.name}.')}*{TEMPORARY_SUFFIX}"):
        try:
            lock = os.open(staging, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:  # a file, or gone by now
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not any(staging.iterdir()):  # somebody is about to take the lock
                continue
            if (staging / "old").is_dir() and not path.exists():
                (staging / "old").rename(path)
            shutil.rmtree(staging, ignore_errors=True)
        except OSError:
            continue
        finally:
            os.close(lock)


def _flush_tree(folder: Path) -> None:
    for parent, _, names in os.walk(folder, topdown=False):
        for name in names:
            with (Path(parent) / name).open("rb") as file:
                os.fsync(file.fileno())
        fsync_folder(Path(parent))
