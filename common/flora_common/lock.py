"""A file, or a folder, that one process holds at a time; the kernel lets go of it however that process ends.

The file is never removed: who removes a lock lets two processes hold one each.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path


class AlreadyHeld(Exception):
    """Another process holds it.

    Attributes:
        pid: its number as text, or ``unknown``.
    """

    def __init__(self, pid: str) -> None:
        super().__init__(f"held by pid {pid}")
        self.pid = pid


def hold(path: Path) -> int:
    """Hold ``path`` for this process and write its number there, for people and for whoever comes second.

    Returns:
        The descriptor: the lock ends when it is closed, or with the process.

    Raises:
        AlreadyHeld: another process was first.
        OSError: the file cannot be opened or made.
    """
    descriptor = _opened(path)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        said = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        raise AlreadyHeld(said if said.isdigit() else "unknown") from None
    except BaseException:
        os.close(descriptor)
        raise
    # On a full or read-only disk it holds all the same, its holder only stays nameless: the plant needs its lamps.
    with contextlib.suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


def hold_folder(folder: Path) -> int:
    """Hold a folder itself for this process; nothing is written there.

    Returns:
        The descriptor, as :func:`hold`. Where the file system has no locks nobody is kept away.

    Raises:
        AlreadyHeld: another process was first; which one, nobody can say.
        OSError: there is no such folder, or it cannot be opened.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise AlreadyHeld("unknown") from None
    except OSError:
        pass
    return descriptor


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as problem:
        if problem.errno not in (errno.EROFS, errno.EACCES):
            raise
        # A card at its end is mounted read-only, and a service that somebody has tried with sudo leaves its lock to
        # root; the kernel locks a file that can only be read, too.
        try:
            return os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            raise problem from None  # it says what is wrong with the folder where there is no such file
