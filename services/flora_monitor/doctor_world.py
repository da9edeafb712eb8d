"""What the doctor knows of the machine, handed in: files below a root, child processes, accounts, room on disks.

A check answers with a sentence where all is well, and otherwise raises a :class:`Remark`. Nothing here judges.
"""

from __future__ import annotations

import contextlib
import fcntl
import grp
import os
import pwd
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, Protocol

from flora_common.clock_sync import is_synchronised

Verdict = Literal["good", "wrong", "not used here", "not looked at"]

CHILD_DEADLINE_S: Final = 30.0
"""A Pi 3 takes some seconds to import OpenCV from a slow card."""
KILLED_WITHIN_S: Final = 1.0
LONGEST_READ: Final = 1 << 20
RELEASES: Final = Path("/opt/flora/releases")
"""Where ``make install-rig`` puts flora; there is no checkout on such a rig."""


class Remark(Exception):
    """A check's answer where it is not plainly good: a sentence of what, where, and what to do."""

    verdict: Verdict = "wrong"


class Wrong(Remark):
    """Something must be done."""


class NotUsed(Remark):
    """This rig has no such part."""

    verdict = "not used here"


class NotLookedAt(Remark):
    """It cannot be told, and the sentence says why."""

    verdict = "not looked at"


@dataclass(frozen=True, slots=True)
class Account:
    """Whom a process runs as; ``groups`` holds ``gid`` too."""

    name: str
    uid: int
    gid: int
    groups: frozenset[int]

    def may(self, status: os.stat_result, *, write: bool) -> bool:
        """Whether the mode of a file or folder lets this account read it, or read and write it (no access lists)."""
        return self._has(status, 0o6 if write else 0o4)

    def may_enter(self, status: os.stat_result) -> bool:
        """Whether the mode of a folder lets this account at what is in it."""
        return self._has(status, 0o1)

    def _has(self, status: os.stat_result, wanted: int) -> bool:
        shift = 6 if status.st_uid == self.uid else 3 if status.st_gid in self.groups else 0
        return self.uid == 0 or status.st_mode >> shift & wanted == wanted


@dataclass(frozen=True, slots=True)
class Done:
    """How a child process ended; ``status`` is None where it had to be killed at its deadline."""

    status: int | None
    out: str
    err: str

    @property
    def is_good(self) -> bool:
        return self.status == 0

    @property
    def reason(self) -> str:
        """The last line that it said: of a traceback, the error."""
        if self.status is None:
            return "no answer in time"
        lines = [line.strip() for line in (self.err or self.out).splitlines() if line.strip()]
        return lines[-1] if lines else f"ended with status {self.status}"


@dataclass(frozen=True, slots=True)
class Room:
    """A file system: what a service can still write, and the device number that ``stat`` gives.

    Attributes:
        free_files: new files beside what is there; None where it does not count them.
    """

    free_bytes: int
    is_read_only: bool
    device: int
    free_files: int | None = None


class Run(Protocol):
    """Runs a command to its end, or to its deadline."""

    def __call__(self, command: Sequence[str], *, account: Account | None = None) -> Done: ...


@dataclass(frozen=True, slots=True)
class World:
    """The machine.

    Attributes:
        root: below which its files are looked for; ``/`` but in tests.
        me: who asks.
        run: runs a child process, as another account where ``me`` is root.
        lookup: an account by its name, with further groups by theirs; None where there is none of that name.
        room: the file system of a path that exists.
        is_synchronised: whether the wall clock can be believed.
        python: the interpreter that the services run in.
    """

    root: Path
    me: Account
    run: Run
    lookup: Callable[[str, Sequence[str]], Account | None]
    room: Callable[[Path], Room]
    is_synchronised: Callable[[], bool]
    python: Path

    def at(self, path: str | Path) -> Path:
        """Where a path of the machine lies."""
        return self.root / str(path).lstrip("/") if Path(path).is_absolute() else Path(path)

    def real(self, path: str | Path) -> Path:
        """A path of the machine with its links followed, as far as they do not lead in a circle."""
        found = Path(os.path.realpath(self.at(path)))
        root = self.root.resolve()
        return Path("/") / found.relative_to(root) if found.is_relative_to(root) else found

    def program(self, name: str) -> str:
        """A command of flora, beside the interpreter that runs this one."""
        return str(self.python.parent / name)

    @property
    def install_anew(self) -> str:
        """What to do where a part of flora's own is damaged: how it was installed decides."""
        release = self.real(self.python.parent.parent)
        if not release.is_relative_to(RELEASES):
            return "install flora anew: `make setup` in its checkout"
        # An installation leaves a release alone that is there already.
        return (
            "`make rollback-rig` on the machine with flora's checkout goes back to the release before; "
            f"`sudo rm -r {release}` here, then `make install-rig` there, installs this one anew"
        )

    def read(self, path: str) -> str | None:
        """The text of a file of the machine; None where it is missing or must not be read."""
        try:
            with self.at(path).open("rb") as file:
                return file.read(LONGEST_READ).decode(errors="replace")
        except OSError:
            return None

    def is_locked(self, lock: Path) -> bool:
        """Whether a process holds a service's lock file, or may hold it as far as can be told."""
        try:
            descriptor = os.open(self.at(lock), os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:
            return False
        except OSError:
            return True
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
        return False


def this_machine() -> World:
    """The machine that the command runs on."""
    return World(
        root=Path("/"),
        me=_me(),
        run=run_child,
        lookup=_lookup,
        room=room_of,
        is_synchronised=is_synchronised,
        python=Path(sys.executable),
    )


def run_child(command: Sequence[str], *, account: Account | None = None, deadline_s: float = CHILD_DEADLINE_S) -> Done:
    """Run a command with nothing on its stdin; it and its children are killed at the deadline.

    A process that hangs in the kernel, on a server that went dark, cannot be ended: it is left behind, not waited for.
    """
    other = account if account is not None and os.geteuid() == 0 and account.uid != 0 else None
    try:
        child = subprocess.Popen(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
            user=other.uid if other else None,
            group=other.gid if other else None,
            extra_groups=sorted(other.groups) if other else None,
        )
    except OSError as problem:
        return Done(127, "", f"{command[0]}: {problem.strerror}")
    try:
        out, err = child.communicate(timeout=deadline_s)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.communicate(timeout=KILLED_WITHIN_S)
        return Done(None, "", "")
    return Done(child.returncode, out, err)


def room_of(path: Path) -> Room:
    """The file system that holds an existing path."""
    found = os.statvfs(path)
    is_read_only, free_files = bool(found.f_flag & os.ST_RDONLY), found.f_favail if found.f_files else None
    return Room(found.f_bavail * found.f_frsize, is_read_only, path.stat().st_dev, free_files)


def _me() -> Account:
    uid, gid = os.geteuid(), os.getegid()
    try:
        name = pwd.getpwuid(uid).pw_name
    except KeyError:
        name = str(uid)
    return Account(name, uid, gid, frozenset({gid, *os.getgroups()}))


def _lookup(name: str, groups: Sequence[str]) -> Account | None:
    try:
        user = pwd.getpwnam(name)
    except KeyError:
        return None
    of_user = os.getgrouplist(user.pw_name, user.pw_gid)
    further = [found.gr_gid for found in grp.getgrall() if found.gr_name in groups]
    return Account(user.pw_name, user.pw_uid, user.pw_gid, frozenset({user.pw_gid, *of_user, *further}))
