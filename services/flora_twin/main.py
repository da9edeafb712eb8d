"""``flora-twin``: the command line. Groups of commands register themselves; this module only gathers them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Final

import typer

from flora_common.cli import run_typer, version_line
from flora_twin import commands
from flora_twin.rig import demo

PROGRAM: Final = "flora-twin"

REGISTER: Final[tuple[Callable[[typer.Typer], None], ...]] = (commands.register, demo.register)
"""Each adds commands to the application."""


def build_app() -> typer.Typer:
    """The application with all commands."""
    app = typer.Typer(name=PROGRAM, add_completion=False, pretty_exceptions_enable=False)

    @app.callback(invoke_without_command=True)
    def root(version: bool = typer.Option(False, "--version", help="Print the version and end.")) -> None:
        """The virtual grow box: a physical plant, lamps, flash, camera and time."""
        if version:
            typer.echo(version_line(PROGRAM))
            raise typer.Exit

    for register in REGISTER:
        register(app)
    return app


def main() -> None:
    """Entry point."""
    sys.exit(run_typer(PROGRAM, build_app))


if __name__ == "__main__":
    main()
