"""How every command ends: 0, 2 for bad input with one line, 1 otherwise."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Callable

from flora_common.errors import FloraError

INTERRUPTED_STATUS = 130


def version_line(program: str) -> str:
    """Program, package version and the hash of the message catalogue that it speaks."""
    from flora_common.messages.reference import catalogue_hash  # noqa: PLC0415 - only needed for this one line

    return f"{program} {importlib.metadata.version('flora')}, message catalogue {catalogue_hash()}"


def run_cli(program: str, work: Callable[[], int | None]) -> int:
    """Run a command's work and turn expected failures into one line on stderr and an exit status.

    A bug keeps its traceback: it is not caught here.
    """
    try:
        return work() or 0
    except FloraError as problem:
        print(f"{program}: {problem}", file=sys.stderr)
        return problem.exit_status
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return INTERRUPTED_STATUS
    except BrokenPipeError:
        # Whoever read our output has gone (`flora-monitor tail | head`): not an error, and nobody to tell.
        sys.stderr.close()
        return 0
