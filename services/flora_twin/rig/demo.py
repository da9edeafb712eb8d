"""``flora-twin demo``: a plant from seedling to 21 cm, steered round an obstacle by the real services."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from flora_common.errors import BadInput
from flora_common.runs import RunFile
from flora_twin.box import camera_section
from flora_twin.rig.faults import FaultSchedule, PlannedFault, parse_fault
from flora_twin.rig.integrity import check_run
from flora_twin.rig.layout import make_layout, with_task
from flora_twin.rig.outcome import Outcome, tell, write_report
from flora_twin.rig.supervisor import ServiceFailed
from flora_twin.rig.truth import check_truth
from flora_twin.rig.virtual_rig import Seen, VirtualRig

PAPER_RUN_HOURS = 72.0


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """What the demo is asked to do.

    Attributes:
        out: folder for report, picture strip, and the rig's own folder ``rig/``.
        seed: the plant's individual.
        rate: 0 for lock-step, else times real time.
        hours: length of the run.
        controller: a built-in name, or a controller file.
        faults: faults on schedule.
        quiet: no progress bar.
    """

    out: Path
    seed: int = 1
    rate: float = 0.0
    hours: float = PAPER_RUN_HOURS
    controller: str = "waypoint"
    faults: tuple[PlannedFault, ...] = ()
    quiet: bool = False


def register(app: typer.Typer) -> None:
    """Add the subcommand to ``flora-twin``."""
    app.command("demo")(demo)


def demo(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("out"),
    seed: Annotated[int, typer.Option(min=0, help="Which individual plant.")] = 1,
    speed: Annotated[
        str, typer.Option(help="lockstep (as fast as the services answer), realtime, or N times.")
    ] = "lockstep",
    hours: Annotated[float, typer.Option(min=0.1, max=2000.0, help="Length of the run.")] = PAPER_RUN_HOURS,
    controller: Annotated[str, typer.Option(help="Built-in controller, or a .controller.json file.")] = "waypoint",
    fault: Annotated[
        list[str] | None, typer.Option(metavar="NAME@HOUR[:HOURS][=ARG]", help="A fault of the menu; repeatable.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Grow a virtual plant with all services and show what came of it."""
    settings = DemoSettings(
        out=out,
        seed=seed,
        rate=parse_speed(speed),
        hours=hours,
        controller=str(Path(controller).resolve()) if controller.endswith(".json") else controller,
        faults=tuple(parse_fault(text) for text in fault or ()),
        quiet=quiet,
    )
    run_demo(settings, Console(stderr=False))


def parse_speed(text: str) -> float:
    """0 for lock-step, 1 for real time, else the number.

    Raises:
        BadInput: anything else.
    """
    if text in ("lockstep", "realtime"):
        return 0.0 if text == "lockstep" else 1.0
    try:
        rate = float(text)
    except ValueError:
        rate = -1.0
    if not 0.0 < rate <= 1000.0:
        raise BadInput(f"--speed `{text}`: write lockstep, realtime, or a number from above 0 to 1000")
    return rate


def run_demo(settings: DemoSettings, console: Console) -> dict[str, Any]:
    """Run the demo; returns the report's figures.

    Raises:
        FloraError: a service failed, or a photograph was lost.
    """
    _check_faults(settings)
    run_file = RunFile(
        camera=camera_section(),
        rig="demo",
        plant=f"virtual bean, seed {settings.seed}",
        start=datetime.now(UTC).replace(microsecond=0),
    )
    layout = make_layout(
        settings.out / "rig", with_task(run_file), sections={"controller": {"use": settings.controller}}
    )
    began_s = time.monotonic()
    with VirtualRig(layout, seed=settings.seed, rate=settings.rate) as rig, _polite_end(rig):
        console.print("starting box, bus and services", style="dim")
        rig.start()
        console.print("background pictures of the empty box, every lamp state", style="dim")
        rig.calibrate()
        _grow(rig, settings, console)
        restarts = rig.restarts()
        rig.finish()
    took_s = time.monotonic() - began_s
    outcome = Outcome(
        seen=rig.seen,
        restarts=restarts,
        integrity=check_run(layout.run, layout.nas / layout.run.path.name),
        truth=check_truth(layout.run, layout.box_dir),
        hours=settings.hours,
        took_s=took_s,
    )
    figures = write_report(layout, settings.out, outcome, controller=settings.controller)
    tell(console, settings.out, figures, outcome)
    if not outcome.integrity.whole:
        raise ServiceFailed(f"photographs were lost: {outcome.integrity}")
    return figures


def _check_faults(settings: DemoSettings) -> None:
    for planned in settings.faults:
        if planned.at_h >= settings.hours:
            raise BadInput(
                f"fault {planned.name}@{planned.at_h:g}h would never strike: the run ends at {settings.hours:g} h"
            )


@contextlib.contextmanager
def _polite_end(rig: VirtualRig) -> Iterator[None]:
    """Ctrl-C, SIGTERM, and SIGHUP of a closed terminal end the demo with every process stopped."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: rig.supervisor.interrupt()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _grow(rig: VirtualRig, settings: DemoSettings, console: Console) -> None:
    schedule = FaultSchedule(rig, settings.faults)
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f}/{task.total:g} h"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        disable=settings.quiet,
    )
    with progress:
        bar = progress.add_task("growing", total=settings.hours)

        def each(seen: Seen) -> None:
            schedule(seen)
            if seen.tick is not None:
                progress.update(bar, completed=seen.tick.time_s / 3600, description=describe(seen))

        try:
            rig.run(lambda seen: run_is_long_enough(seen, settings.hours), each=each)
        finally:
            schedule.end_all()


def run_is_long_enough(seen: Seen, hours: float) -> bool:
    """The lamps of the last tick within these hours are confirmed."""
    tick, lamps = seen.tick, seen.lamps
    return tick is not None and lamps is not None and tick.time_s / 3600 >= hours - 1e-6 and lamps.tick >= tick.tick


def describe(seen: Seen) -> str:
    """The state of the plant in half a line."""
    state, lamps = seen.controller, seen.lamps
    tip = "no stem yet" if state is None or state.tip_cm is None else "tip ({:+.1f}, {:.1f}) cm".format(*state.tip_cm)
    fitness = "" if state is None or state.fitness is None else f"  fitness {100 * state.fitness:5.1f} %"
    lamp = "" if lamps is None else f"  lamp {lamps.lit:5}"
    return f"{tip}{fitness}{lamp}"
