"""The ``flora-lab`` command: every subcommand is a module with a ``register(app)`` of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, cast

import typer

from flora_common.cli import run_cli, version_line
from flora_common.errors import BadInput
from flora_lab import track

PROGRAM = "flora-lab"

# By version, Typer brings its own copy of click or uses the installed one; the base of its public error fits both.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])


def build_app() -> typer.Typer:
    """The command line with all subcommands."""
    app = typer.Typer(help="The flora lab: from photographs to controllers.", add_completion=False)

    @app.callback()
    def common(
        version: Annotated[bool, typer.Option("--version", help="Print the version and end.", is_eager=True)] = False,
    ) -> None:
        if version:
            print(version_line(PROGRAM))
            raise typer.Exit

    for module in (track,):
        module.register(app)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 2 for bad input, 1 otherwise."""
    arguments = list(sys.argv[1:] if argv is None else argv)

    def work() -> int:
        try:
            result = build_app()(args=arguments or ["--help"], prog_name=PROGRAM, standalone_mode=False)
        except _UsageError as problem:
            message = " ".join(problem.format_message().split())
            raise BadInput(f"{message} (see {PROGRAM} {_subcommand(arguments)}--help)") from problem
        except typer.Abort:
            raise KeyboardInterrupt from None
        return result if isinstance(result, int) else 0

    return run_cli(PROGRAM, work)


def _subcommand(arguments: Sequence[str]) -> str:
    return f"{arguments[0]} " if arguments and not arguments[0].startswith("-") else ""


if __name__ == "__main__":
    sys.exit(main())
