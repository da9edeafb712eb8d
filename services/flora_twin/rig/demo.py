"""``flora-twin demo``: a plant from seedling to 21 cm, steered round an obstacle by the real services."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from flora_common.errors import BadInput
from flora_common.paper_experiment import RUN_HOURS
from flora_twin.rig.experiment import Experiment, check_photographs, parse_speed, run_experiment
from flora_twin.rig.faults import parse_fault
from flora_twin.rig.outcome import tell
from flora_twin.rig.shipped_controller import CONTROLLER, EVOLVED, KEYS_DIR
from flora_twin.seeds import Seed


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-twin``."""
    app.command("demo")(demo)


def demo(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("out"),
    seed: Seed = 1,
    speed: Annotated[
        str, typer.Option(help="lockstep (as fast as the services answer), realtime, or N times.")
    ] = "lockstep",
    hours: Annotated[float, typer.Option(min=0.1, max=2000.0, help="Length of the run.")] = RUN_HOURS,
    controller: Annotated[
        str,
        typer.Option(
            help="evolved (signed, shipped with flora), a built-in one, or a .controller.json or .lights.toml file."
        ),
    ] = EVOLVED,
    keys: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Public keys (*.pub) of those whose controllers the rig takes meanwhile."),
    ] = None,
    fault: Annotated[
        list[str] | None, typer.Option(metavar="NAME@HOUR[:HOURS][=ARG]", help="A fault of the menu; repeatable.")
    ] = None,
    dashboard: Annotated[
        bool, typer.Option("--dashboard/--no-dashboard", help="Serve the rig's page while the plant grows.")
    ] = True,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Grow a virtual plant with all services and show what came of it."""
    asked = Experiment(
        out=out,
        made_by="flora-twin demo",
        start=datetime.now(UTC).replace(microsecond=0),
        seed=seed,
        rate=parse_speed(speed),
        hours=hours,
        controller=str(CONTROLLER) if controller == EVOLVED else _named(controller),
        keys_dirs=((KEYS_DIR,) if controller == EVOLVED else ()) + ((_with_keys(keys),) if keys else ()),
        is_signed=controller == EVOLVED,
        goes_on=True,
        faults=tuple(parse_fault(text) for text in fault or ()),
        quiet=quiet,
        dashboard=dashboard,
    )
    console = Console(stderr=False)
    figures, outcome = run_experiment(asked, console)
    tell(console, out, figures, outcome)
    check_photographs(outcome)


def _with_keys(folder: Path) -> Path:
    """The folder.

    Raises:
        BadInput: no public key is in it.
    """
    if not any(folder.glob("*.pub")):
        raise BadInput(f"--keys {folder}: holds no public key (*.pub); `flora-lab keygen` makes one")
    return folder.resolve()


def _named(controller: str) -> str:
    """A file by its full path: services have a working folder of their own.

    Raises:
        BadInput: it is not there. Nobody must learn that after the run before has been removed.
    """
    if not controller.endswith((".json", ".toml")):
        return controller
    path = Path(controller).resolve()
    if not path.is_file():
        raise BadInput(f"--controller {controller}: no such file")
    return str(path)
