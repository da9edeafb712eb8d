"""A subcommand of ``flora-lab`` in a process of its own, which holds the folder that it works in."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from flora_common.installed import command

BAD_INPUT_STATUS: Final = 2
_ENDS_WITHIN_S: Final = 20.0
_MOST_SAID: Final = 20_000


@dataclass(frozen=True, slots=True)
class Ended:
    """How it ended.

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
        folder: where it works; this process's own unless named.
        environment: what it is told besides.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        held: int,
        *,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process says something
        try:
            self._process = subprocess.Popen(
                [command("flora-lab"), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._said,
                pass_fds=(held,),
                start_new_session=True,
                cwd=folder,
                env={**os.environ, **(environment or {})},
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

    def ask_to_end(self) -> None:
        """Ask it to end, and do not wait."""
        self._process.terminate()

    def end(self) -> None:
        """End it, whatever it is at."""
        self.ask_to_end()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """Let go of what it said, and of how its end is heard."""
        os.close(self.ends_fd)
        self._said.close()
