"""One diagnosis at a time, in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from flora_common import lock
from flora_common.errors import FloraError
from flora_common.files import TEMPORARY_SUFFIX
from flora_common.installed import command

LOCK_FILE: Final = ".lock"
BAD_INPUT_STATUS: Final = 2
_ENDS_WITHIN_S: Final = 20.0
_MOST_SAID: Final = 20_000


class StillBusy(FloraError):
    """A diagnosis that an earlier service started is not at its end."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How a diagnosis ended.

    Attributes:
        status: 0 where all is well; negative for a signal.
        said: its last line.
    """

    status: int
    said: str

    @property
    def is_final(self) -> bool:
        """Whether it would end so again."""
        return self.status == BAD_INPUT_STATUS

    @property
    def reason(self) -> str:
        """In a sentence."""
        how = f"signal {-self.status}" if self.status < 0 else f"status {self.status}"
        return self.said if self.is_final else f"{self.said or 'it said nothing'} ({how})"


class Child:
    """The process.

    Args:
        arguments: of ``flora-lab``.
        held: lock of the folder that it works in alone; it is the child's from now on.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, arguments: Sequence[str], held: int) -> None:
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process says something
        try:
            self._process = subprocess.Popen(
                [command("flora-lab"), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._said,
                pass_fds=(held,),
                start_new_session=True,
            )
        except BaseException:
            self._said.close()
            raise
        finally:
            os.close(held)  # the child holds it, even if this process is killed
        self.began_s = time.monotonic()
        self.ends_fd = os.pidfd_open(self._process.pid)

    def ended(self) -> Ended | None:
        """How it ended; None while it works."""
        status = self._process.poll()
        if status is None:
            return None
        size = self._said.seek(0, os.SEEK_END)
        self._said.seek(max(0, size - _MOST_SAID))
        lines = self._said.read().decode("utf-8", "replace").strip().splitlines()
        return Ended(status, lines[-1].removeprefix("flora-lab: ") if lines else "")

    def end(self) -> None:
        """End it, whatever it is at."""
        self._process.terminate()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """Let go of what it said, and of how its end is heard."""
        os.close(self.ends_fd)
        self._said.close()


def held_folder(output: Path) -> int:
    """The lock of a folder, as a descriptor.

    Raises:
        StillBusy: another process holds it.
    """
    try:
        return lock.hold(output / LOCK_FILE)
    except lock.AlreadyHeld as by:
        raise StillBusy(
            f"{output}: a diagnosis that was started before (by process {by.pid}) still works in it"
        ) from by


def clear_left_over(output: Path) -> None:
    """Remove what diagnoses that were killed left half written; nothing while one is at work."""
    try:
        held = held_folder(output)
    except StillBusy:
        return
    try:
        for path in output.glob(f".*{TEMPORARY_SUFFIX}"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(held)
