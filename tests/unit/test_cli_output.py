"""Commands whose output cannot be written, or that nobody reads to its end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest

NO_FILE_NAME = """
import errno, sys, typer
from flora_common.cli import run_typer
def app():
    app = typer.Typer()
    @app.command()
    def command(): raise OSError(errno.EIO, "a bug of ours")
    return app
sys.exit(run_typer("program", app, ["--"]))
"""
LONG = """
import sys, typer
from flora_common.cli import run_typer
def app():
    app = typer.Typer()
    @app.command()
    def command(): typer.echo("x" * 1_000_000)
    return app
sys.exit(run_typer("program", app, ["--"]))
"""
SHORT = """
import sys
from flora_common.cli import run_cli
sys.exit(run_cli("program", lambda: print("one line")))
"""
HELP = LONG.replace('["--"]', '["--help"]')
HELP_OF_SERVICE = """
import sys
from flora_common.cli import ArgumentParser, run_cli
sys.exit(run_cli("program", lambda: len(vars(ArgumentParser("program").parse_args(["--help"])))))
"""

BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
each = pytest.mark.parametrize("code", [LONG, SHORT, HELP, HELP_OF_SERVICE], ids=["long", "short", "help", "service"])
buffered = pytest.mark.parametrize("flags", [[], ["-u"]], ids=["buffered", "unbuffered"])


def run(code: str, *flags: str, stdout: IO[bytes] | int) -> subprocess.CompletedProcess[bytes]:
    """A program of its own, for stdout must be a true one."""
    command = [sys.executable, *flags, "-c", code]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, env=BUFFERED, check=False)


@each
@buffered
def test_a_full_device_is_told_in_one_line(code: str, flags: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = run(code, *flags, stdout=full)
    assert done.returncode == 1
    said = "program: the output cannot be written (No space left on device); free some space\n"
    assert done.stderr.decode() == said


@each
@buffered
def test_output_that_nobody_reads_is_no_error(code: str, flags: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = run(code, *flags, stdout=writer)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


def test_other_errors_without_a_file_name_keep_their_traceback() -> None:
    done = run(NO_FILE_NAME, stdout=subprocess.PIPE)
    assert done.returncode == 1
    assert b"a bug of ours" in done.stderr
    assert done.stderr.count(b"\n") > 1


@pytest.mark.parametrize("encoding", ["utf-8:strict", "ascii:strict"])
def test_a_name_that_the_terminal_cannot_show_is_written_with_escapes(encoding: str) -> None:
    """As in every locale but C: strict, so that a name of bytes from an old disk would end in a traceback."""
    code = SHORT.replace('"one line"', '"b\\udcff: good"')
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, env={**os.environ, "PYTHONIOENCODING": encoding}, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"b\\udcff: good\n", b"")
