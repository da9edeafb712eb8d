"""``flora-twin``: the command line. Groups of commands register themselves; this module only gathers them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Final

import typer

from flora_common.cli import print_version, run_typer
from flora_twin import commands
from flora_twin.rig import demo, experiment_command
from flora_twin.seeds import LARGEST_SEED

PROGRAM: Final = "flora-twin"

REGISTER: Final[tuple[Callable[[typer.Typer], None], ...]] = (
    commands.register,
    demo.register,
    experiment_command.register,
)
"""Each adds commands to the application."""


def build_app() -> typer.Typer:
    """The application with all commands."""
    app = typer.Typer(name=PROGRAM, add_completion=False, pretty_exceptions_enable=False)

    @app.callback(invoke_without_command=True)
    def root(
        context: typer.Context,
        *,
        version: Annotated[
            bool,
            typer.Option(
                "--version", help="Print the version and end.", is_eager=True, callback=print_version(PROGRAM)
            ),
        ] = False,
        seed: Annotated[
            int | None, typer.Option(min=0, max=LARGEST_SEED, help="Which individual plant, for every command.")
        ] = None,
    ) -> None:
        """flora-twin: the virtual grow box (a physical plant, lamps, flash, camera and time), and the demo in it.

        `flora-twin --seed 7` alone runs the demo with that plant.
        """
        if seed is not None:
            context.default_map = {
                name: {"seed": seed} for name in ("demo", "experiment", "serve", "picture", "grow", "runs")
            }
        if context.invoked_subcommand is None:
            demo.demo(seed=1 if seed is None else seed)

    for register in REGISTER:
        register(app)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 2 for bad input, 1 otherwise."""
    return run_typer(PROGRAM, build_app, argv)


if __name__ == "__main__":
    sys.exit(main())
