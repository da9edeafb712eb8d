"""The ``flora-lab`` command: every subcommand is a module with a ``register(app)`` of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Final

import typer

from flora_common.cli import print_version, run_typer
from flora_lab.dataset import command as dataset
from flora_lab.diagnose import command as diagnose
from flora_lab.evaluate import command as evaluate
from flora_lab.evolve import command as evolve
from flora_lab.jobs import command as jobs
from flora_lab.paper import command as paper
from flora_lab.publish import command as publish
from flora_lab.publish import signing_command as signing
from flora_lab.report import command as report
from flora_lab.rhythm import command as rhythm
from flora_lab.rollout import command as rollout
from flora_lab.serve import command as serve
from flora_lab.track import command as track
from flora_lab.train import command as train

PROGRAM: Final = "flora-lab"
SUBCOMMANDS: Final = (
    track,
    report,
    dataset,
    rollout,
    train,
    evolve,
    evaluate,
    diagnose,
    rhythm,
    paper,
    signing,
    publish,
    serve,
    jobs,
)


def build_app() -> typer.Typer:
    """The command line with all subcommands."""
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

    for module in SUBCOMMANDS:
        module.register(app)
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status: 0, 2 for bad input, 1 otherwise."""
    return run_typer(PROGRAM, build_app, argv)


if __name__ == "__main__":
    sys.exit(main())
