"""Where files go: a folder, local or mounted. Everything that touches it is behind the :class:`Target` protocol.

Paths are relative to the target's root, with ``/``. Between ``connect`` and ``disconnect`` a :class:`FolderTarget`
holds the root folder open and works relative to it: a mount that is taken away in between cannot turn into an empty
directory of the same name that fills the local disk.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Final, Protocol

from flora_common.errors import DiskFull, NasRefused, NasUnreachable, StoreError

REFUSED: Final = frozenset({errno.EROFS, errno.EACCES, errno.EPERM})
FULL: Final = frozenset({errno.ENOSPC, errno.EDQUOT})
GONE: Final = frozenset(
    {
        errno.ENOENT, errno.ENOTDIR, errno.ESTALE, errno.EIO, errno.ENODEV, errno.ENXIO, errno.ETIMEDOUT,
        errno.ENOTCONN, errno.ECONNRESET, errno.ECONNABORTED, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ENETUNREACH,
    }
)  # fmt: skip


class Writer(Protocol):
    """A new file at the target."""

    def write(self, data: memoryview) -> None: ...

    def sync(self) -> None:
        """Return only when the content is on the disk there, as far as the protocol can say so."""
        ...

    def close(self) -> None: ...


class Reader(Protocol):
    """A file at the target, read from its disk and not from a cache on the way, as far as that can be had."""

    def readinto(self, buffer: memoryview) -> int: ...

    def close(self) -> None: ...


class Target(Protocol):
    """What the uploader needs of a place. Every method raises StoreError subclasses, never OSError."""

    @property
    def name(self) -> str:
        """For people, in messages."""
        ...

    def connect(self) -> None:
        """Make sure that it is there, and that it is the right one.

        Raises:
            NasUnreachable: gone, or without its marker file.
        """
        ...

    def disconnect(self) -> None: ...

    def size(self, path: str) -> int | None:
        """Bytes of a file; None where there is none."""
        ...

    def is_same_file(self, path: str, source: os.stat_result) -> bool:
        """Whether this is the very file of the spool, by another way."""
        ...

    def make_folder(self, path: str) -> None:
        """With its parents, flushed."""
        ...

    def create(self, path: str) -> Writer:
        """A new or emptied file."""
        ...

    def open(self, path: str) -> Reader: ...

    def rename(self, old: str, new: str) -> None:
        """Within one folder, in one step, over whatever is there; the folder's entries are flushed."""
        ...

    def remove(self, path: str) -> None:
        """Nothing happens where it is not there."""
        ...

    def names(self, folder: str) -> list[str]:
        """Entries of a folder; none where it is not there."""
        ...


def store_error(problem: OSError, root: str, path: str = "") -> StoreError:
    """The error of the tree for what the operating system said: about the whole target, or about one file."""
    why = problem.strerror or str(problem)
    if problem.errno in FULL:
        return DiskFull(f"{root}: the target is full ({why}); free some space there, uploading then goes on by itself")
    if problem.errno in REFUSED:
        return NasRefused(f"{root}: the target refuses to be written ({why}); check its mount options and permissions")
    if problem.errno in GONE:
        return NasUnreachable(f"{root}: the target is not reachable ({why}); uploading goes on when it is back")
    return StoreError(f"{root}/{path}: {why}")


class FolderTarget:
    """A folder of this machine, local or mounted.

    Args:
        root: the folder.
        marker: name of the file that tells the right folder from an empty mount point; empty for no check.
    """

    def __init__(self, root: Path, marker: str) -> None:
        self._root = root
        self._marker = marker
        self._fd: int | None = None
        self._known: set[str] = set()

    @property
    def name(self) -> str:
        return str(self._root)

    def connect(self) -> None:
        self.disconnect()
        with self._told(""):
            self._fd = os.open(self._root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        if self._marker:
            try:
                os.stat(self._marker, dir_fd=self._fd)
            except FileNotFoundError:
                self.disconnect()
                raise NasUnreachable(
                    f"{self._root}: the marker file {self._marker} is missing, as in an empty mount point;"
                    f" mount the target, or create the file there once"
                ) from None
            except OSError as problem:
                self.disconnect()
                raise store_error(problem, self.name) from problem

    def disconnect(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    @contextlib.contextmanager
    def _told(self, path: str) -> Iterator[None]:
        try:
            yield
        except OSError as problem:
            self._known.clear()
            raise store_error(problem, self.name, path) from problem

    def _root_fd(self) -> int:
        if self._fd is None:
            raise NasUnreachable(f"{self._root}: not connected")
        return self._fd

    def size(self, path: str) -> int | None:
        with self._told(path):
            try:
                found = os.stat(path, dir_fd=self._root_fd(), follow_symlinks=False)
            except FileNotFoundError:
                return None
        if not stat.S_ISREG(found.st_mode):
            raise StoreError(f"{self._root}/{path}: something that is no plain file has this name; move it away")
        return found.st_size

    def is_same_file(self, path: str, source: os.stat_result) -> bool:
        with self._told(path):
            try:
                found = os.stat(path, dir_fd=self._root_fd())
            except FileNotFoundError:
                return False
        return os.path.samestat(found, source)

    def make_folder(self, path: str) -> None:
        if path in ("", ".") or path in self._known:
            return
        parent = str(PurePosixPath(path).parent)
        self.make_folder(parent)
        with self._told(path):
            with contextlib.suppress(FileExistsError):
                os.mkdir(path, dir_fd=self._root_fd())
            # Also when it was there: whoever made it may have died before this line.
            self._sync_folder(parent)
        self._known.add(path)

    def create(self, path: str) -> Writer:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        with self._told(path):
            return _FolderFile(os.open(path, flags, 0o644, dir_fd=self._root_fd()), self.name, path)

    def open(self, path: str) -> Reader:
        with self._told(path):
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=self._root_fd())
        with contextlib.suppress(OSError):  # a hint: where it is not known the read still compares what it gets
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        return _FolderFile(descriptor, self.name, path)

    def rename(self, old: str, new: str) -> None:
        with self._told(new):
            os.rename(old, new, src_dir_fd=self._root_fd(), dst_dir_fd=self._root_fd())
            self._sync_folder(str(PurePosixPath(new).parent))

    def remove(self, path: str) -> None:
        with self._told(path), contextlib.suppress(FileNotFoundError):
            os.unlink(path, dir_fd=self._root_fd())

    def names(self, folder: str) -> list[str]:
        with self._told(folder):
            try:
                descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=self._root_fd())
            except FileNotFoundError:
                return []
            try:
                return sorted(os.listdir(descriptor))  # noqa: PTH208 - of an open folder, not of a path
            finally:
                os.close(descriptor)

    def _sync_folder(self, path: str) -> None:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=self._root_fd())
        try:
            os.fsync(descriptor)
        except OSError as problem:
            # Some network file systems do not know the call for folders: their server keeps names by itself.
            if problem.errno not in (errno.EINVAL, errno.ENOTSUP):
                raise
        finally:
            os.close(descriptor)


class _FolderFile:
    """Reader and writer over one descriptor, unbuffered."""

    def __init__(self, descriptor: int, root: str, path: str) -> None:
        self._descriptor = descriptor
        self._root = root
        self._path = path
        self._is_open = True

    def write(self, data: memoryview) -> None:
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError as problem:
            raise store_error(problem, self._root, self._path) from problem

    def sync(self) -> None:
        try:
            os.fsync(self._descriptor)
        except OSError as problem:
            raise store_error(problem, self._root, self._path) from problem

    def readinto(self, buffer: memoryview) -> int:
        try:
            return os.readv(self._descriptor, [buffer])
        except OSError as problem:
            raise store_error(problem, self._root, self._path) from problem

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            try:
                os.close(self._descriptor)
            except OSError as problem:  # NFS tells a full disk here at the latest
                raise store_error(problem, self._root, self._path) from problem
