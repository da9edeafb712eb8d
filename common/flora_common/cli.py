"""How every command ends: 0, 2 for bad input with one line, 1 otherwise."""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib.metadata
import io
import itertools
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, NoReturn, cast

from flora_common.errors import BadInput, FloraError

if TYPE_CHECKING:
    import typer

INTERRUPTED_STATUS = 130
_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT)


def version_line(program: str) -> str:
    """Program, package version and the hash of the message catalogue that it speaks."""
    from flora_common.messages.reference import catalogue_hash  # noqa: PLC0415 - only needed for this one line

    return f"{program} {importlib.metadata.version('flora')}, message catalogue {catalogue_hash()}"


def run_cli(program: str, work: Callable[[], int | None]) -> int:
    """Run a command's work and turn expected failures into one line on stderr and an exit status.

    A bug keeps its traceback: it is not caught here.
    """
    _write_every_name()
    try:
        status = work() or 0
        _flush_output()
        return status
    except FloraError as problem:
        print(f"{program}: {problem}", file=sys.stderr)
        return problem.exit_status
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return INTERRUPTED_STATUS
    except BrokenPipeError:
        # Whoever read our output has gone (`flora-monitor tail | head`): not an error, and nobody to tell.
        _drop_output()
        return 0
    except OSError as problem:
        # A full disk is no bug; where it holds one of our files, `files` has told the name already.
        if problem.filename is not None or problem.errno not in _NO_ROOM:
            raise
        _drop_output()
        print(f"{program}: the output cannot be written ({problem.strerror}); free some space", file=sys.stderr)
        return 1


def _write_every_name() -> None:
    """A file name that is no text, or that the terminal has no signs for, is written with escapes, as stderr does."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def _flush_output() -> None:
    """Write what stdout still holds, while its errors can be told: at the interpreter's end they are many lines."""
    if sys.stdout is not None and not sys.stdout.closed:
        sys.stdout.flush()


def _drop_output() -> None:
    """Let what stdout still holds go nowhere: the interpreter would try to write it once more at its end, and fail."""
    with contextlib.suppress(OSError, ValueError, AttributeError):  # it may be closed, or no file, as under a test
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


class ArgumentParser(argparse.ArgumentParser):
    """For commands without Typer: wrong arguments are bad input; to be asked inside :func:`run_cli`, which tells it."""

    def error(self, message: str) -> NoReturn:
        raise _wrong_arguments(message, self.prog)

    def print_help(self, file: Any = None) -> None:
        # Not as argparse does it, which says nothing where the text could not be written.
        print(self.format_help(), end="", file=file, flush=True)


def _wrong_arguments(message: str, command: str) -> BadInput:
    return BadInput(f"{' '.join(message.split())} (see {command} --help)")


def run_typer(program: str, app: Callable[[], typer.Typer], argv: Sequence[str] | None = None) -> int:
    """Run a Typer command line as :func:`run_cli` does; wrong arguments are bad input, told in one line.

    Args:
        program: the command.
        app: makes the command line.
        argv: arguments without the program name; ``sys.argv`` where None.
    """
    import typer  # noqa: PLC0415 - only for the commands that people type; services start without it

    # By version, Typer brings its own copy of click or uses the installed one; the base of its public error fits both.
    usage_error = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])
    arguments = list(sys.argv[1:] if argv is None else argv)

    def work() -> int:
        if any(not own and before[:1] != "-" for before, own in itertools.pairwise(arguments)):
            # of a variable that is not set: as a path it would be the current folder
            raise _wrong_arguments("an argument is empty, where something must be named", program)
        try:
            result = app()(args=arguments or ["--help"], prog_name=program, standalone_mode=False)
        except usage_error as problem:
            unknown = "No such command" in problem.format_message()
            subcommand = f" {arguments[0]}" if arguments and arguments[0][:1] != "-" and not unknown else ""
            raise _wrong_arguments(problem.format_message(), f"{program}{subcommand}") from problem
        except typer.Abort:
            raise KeyboardInterrupt from None
        except OSError as problem:
            if not isinstance(problem.filename, str):
                raise
            # A path that the person named: missing, not permitted, a file where a folder must be.
            raise BadInput(f"{problem.filename}: {problem.strerror}") from problem
        except SystemExit as ending:
            # Typer, and Rich in a help text, end with status 1 by themselves where nobody reads on.
            if isinstance(ending.__context__, BrokenPipeError):
                raise BrokenPipeError from ending
            raise
        if result == INTERRUPTED_STATUS:  # by version, Typer turns Ctrl-C into this status without a word
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0

    return run_cli(program, work)


def print_version(program: str) -> Callable[[bool], None]:
    """The callback of a Typer command's ``--version``."""
    import typer  # noqa: PLC0415 - see run_typer

    def callback(wanted: bool) -> None:
        if wanted:
            print(version_line(program))
            raise typer.Exit

    return callback
