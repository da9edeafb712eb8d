"""The ``flora-lab`` command: every subcommand is a module with a ``register(app)`` of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Final

import typer

from flora_common.cli import print_version, run_typer
from flora_lab.late import modules_of

PROGRAM: Final = "flora-lab"
SUBCOMMANDS: Final = (
    "track.command",
    "report.command",
    "dataset.command",
    "rollout.command",
    "train.command",
    "evolve.command",
    "evaluate.command",
    "diagnose.command",
    "rhythm.command",
    "paper.command",
    "publish.signing_command",
    "publish.command",
    "serve.command",
    "jobs.command",
)

_module = modules_of("flora_lab")


def build_app() -> typer.Typer:
    """The command line with all subcommands; they are imported here, where Ctrl-C is told as in all work."""
    app = typer.Typer(help="flora-lab: from photographs to controllers.", add_completion=False)

    @app.callback()
    def common(
        version: Annotated[
            bool,
            typer.Option(
                "--version", help="Print the version and end.", is_eager=True, callback=print_version(PROGRAM)
            ),
        ] = False,
    ) -> None:
        """Options before the subcommand; ``version`` has done its work when this is reached."""

    for name in SUBCOMMANDS:
        _module(name).register(app)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 2 for bad input, 1 otherwise."""
    return run_typer(PROGRAM, build_app, argv)


if __name__ == "__main__":
    sys.exit(main())
