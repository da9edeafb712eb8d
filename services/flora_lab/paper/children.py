"""One installed command as a child process, which is ended before this process ends."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence

from flora_common.errors import FloraError
from flora_lab.bars import ENVIRONMENT
from flora_lab.stopped_work import WITHIN, waited_for


class ChildFailed(FloraError):
    """A command ended otherwise than well.

    Attributes:
        exit_status: the command's own; 1 where a signal ended it.
    """

    def __init__(self, message: str, exit_status: int) -> None:
        super().__init__(message)
        self.exit_status = exit_status


def run_child(program: str, arguments: Sequence[str], *, held: int, is_silent: bool) -> None:
    """Run a command to its end.

    Ctrl-C and `kill` reach this process alone; it ends the command as `kill` does, and waits. Ctrl-C would not do: a
    command whose shell put it into the background does not hear it.

    Args:
        program: path of the command.
        arguments: its own.
        held: descriptor of a lock that the command is to hold as long as it runs, even if this process is killed.
        is_silent: what it says is shown only where it fails; else what it says on stderr is seen as it comes.

    Raises:
        ChildFailed: the command's last line, and its status.
    """
    process = subprocess.Popen(
        [program, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE if is_silent else None,
        text=True,
        errors="replace",
        pass_fds=(held,),
        start_new_session=True,
        # Who waits from afar is told of steps, not of each step's own bars.
        env={name: value for name, value in os.environ.items() if name != ENVIRONMENT} | {WITHIN: "flora-lab paper"},
    )
    said = waited_for(process)
    status = process.returncode
    if status == 0:
        return
    lines = said.strip().splitlines()
    if len(lines) > 1:  # a traceback, which its last line alone does not explain
        print("\n".join(lines[:-1]), file=sys.stderr)
    words = lines[-1] if lines else "what it said is above" if not is_silent else "it said nothing"
    how = f"signal {-status}" if status < 0 else f"status {status}"
    raise ChildFailed(f"{words} ({how})", status if status > 0 else 1)
