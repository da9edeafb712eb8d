"""``flora-lab serve``: its options, those of every service."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer

from flora_common.errors import BadInput


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-lab``."""
    app.command("serve")(serve)


def serve(
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A TOML file (default /etc/flora/flora.toml).")
    ] = None,
    check_config: Annotated[bool, typer.Option("--check-config", help="Check the configuration and end.")] = False,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print what is in force, defaults included, and end.")
    ] = False,
    version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="Say more.")] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Only warnings and errors.")] = False,
) -> None:
    """Run as a service: watch plants while they grow, diagnose each run when it has ended, take jobs from the bus.

    What it watches, and where jobs work, stands in \\[lab] of the configuration file. SIGTERM ends it; nothing is lost.
    """
    if verbose and quiet:
        raise BadInput("give either --verbose or --quiet")
    flags = {
        "--check-config": check_config,
        "--print-config": print_config,
        "--version": version,
        "--verbose": verbose,
        "--quiet": quiet,
    }
    given = ["--config", str(config)] if config is not None else []
    service = importlib.import_module("flora_lab.serve.service")
    raise typer.Exit(service.main([*given, *(flag for flag, is_given in flags.items() if is_given)]))
