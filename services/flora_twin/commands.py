"""The commands of ``flora-twin`` without other services: ``serve``, ``picture``, ``grow``, ``runs`` and ``faults``."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from flora_common import files
from flora_common.config import load_config
from flora_common.counted import counted
from flora_common.errors import BadInput
from flora_common.light_schedule import parse_schedule
from flora_common.outputs import can_be_made, check_file, is_picture, is_track, must_be_new
from flora_common.runs import LIGHTS, RunFolder, track_text
from flora_common.suggest import did_you_mean
from flora_twin import faults as menu
from flora_twin.grow import grow
from flora_twin.photographed_folder import write_runs
from flora_twin.photographs import EXPOSURE_US, STRIPS, photographs_in
from flora_twin.runs import CLOSED_LOOP, HOURS, OPEN_LOOP, SMALLEST_PIXEL_CM, PlannedRun, dataset_runs, planned_runs
from flora_twin.seeds import LARGEST_SEED, Seed
from flora_twin.server import WorldServer, bound, only_one, parse_start, serve
from flora_twin.world import World

Force = Annotated[bool, typer.Option("--force", help="Replace the file that is there.")]


def register(app: typer.Typer) -> None:
    """Add these commands to an application."""
    app.command("serve")(serve_world)
    app.command("picture")(picture)
    app.command("grow")(grow_track)
    app.command("runs")(grow_runs)
    app.command("faults")(list_faults)


class TwinSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[twin]``: the virtual grow box of a rig; it listens where ``[rig.clock]`` says."""

    seed: Annotated[int, msgspec.Meta(ge=0, le=LARGEST_SEED)] = 1
    """The individual plant and all chance."""

    rate: Annotated[float, msgspec.Meta(ge=0.0, le=10_000.0)] = 0.0
    """Times real time; 0 is lock-step: time moves on when the rig is done with the tick."""

    start: str = ""
    """UTC at time 0, ISO 8601; empty for the present."""

    planted: bool = True
    """Whether the plant is there at first."""


def serve_world(
    *,
    config: Annotated[Path | None, typer.Option(help="The rig's TOML file; options below go before it.")] = None,
    address: Annotated[str | None, typer.Option(help="ZeroMQ address to bind, such as ipc:///run/flora/twin.")] = None,
    state_dir: Annotated[Path | None, typer.Option(help="Folder for checkpoint and truth.jsonl.")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=LARGEST_SEED, help="The individual plant and all chance.", show_default="1")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(min=0.0, help="0: lock-step. Else times real time.", show_default="0")
    ] = None,
    start: Annotated[str | None, typer.Option(help="UTC at time 0, ISO 8601; the present where missing.")] = None,
    planted: Annotated[
        bool | None,
        typer.Option("--planted/--empty", help="Whether the plant is there at first.", show_default="planted"),
    ] = None,
) -> None:
    """Serve the virtual grow box until SIGTERM; goes on where it was when STATE_DIR holds a checkpoint."""
    rig, section = load_config(config, "twin", TwinSection)
    given = {"seed": seed, "rate": rate, "start": start, "planted": planted}
    section = msgspec.structs.replace(section, **{key: value for key, value in given.items() if value is not None})
    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
    cv2.setNumThreads(1)  # the other services need the other cores
    start_utc_ns = parse_start(section.start) if section.start else time.time_ns()
    folder, where = state_dir or Path(rig.state_dir) / "twin", address or rig.clock.twin
    if not folder.exists():
        can_be_made(folder, "--state-dir")
    # The folder first: whoever binds an ipc address takes it away from a world that is there. And bound once: who
    # connected to an address that is bound for a moment only has lost what it asked.
    with only_one(folder), bound(where) as router:
        world = World(section.seed, planted=section.planted)
        server = WorldServer(world, folder, start_utc_ns=start_utc_ns, rate=section.rate, monotonic_s=time.monotonic)
        serve(server, router)


def picture(
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write: .jpg or .png.")],
    seed: Seed = 1,
    hours: Annotated[float, typer.Option(help="Age of the plant.")] = 48.0,
    light: Annotated[str, typer.Option(help="Lamp in the picture: left, right, dark or both.")] = "left",
    schedule: Annotated[str, typer.Option(help="Light before: `6h`, or `right 37h, left`; LIGHT where missing.")] = "",
    flash: Annotated[bool, typer.Option("--flash/--no-flash", help="Whether the flash lights it.")] = True,
    empty: Annotated[bool, typer.Option("--empty", help="The setup without a plant.")] = False,
    force: Force = False,
) -> None:
    """Take one photograph of a plant that grew under a light schedule."""
    check_file(output, force=force, is_ours=is_picture, what="a picture")
    if output.suffix.lower() not in {".jpg", ".jpeg", ".png"}:
        raise BadInput(f"{output}: a picture ends in .jpg or .png")
    if not 0.0 <= hours <= 400.0:
        raise BadInput(f"hours is {hours:g}; it must lie in [0, 400]")
    if light not in LIGHTS:
        raise BadInput(f"light `{light}` does not exist{did_you_mean(light, LIGHTS)}")
    before = parse_schedule(schedule or light)
    world = World(seed, planted=not empty)
    while world.time_s < hours * 3600.0 - 1e-6:
        world.set_strips(STRIPS[before(world.time_s)])
        world.advance_to(min(world.time_s + 100.0, hours * 3600.0))
    world.set_strips(STRIPS[next(known for known in LIGHTS if known == light)])
    world.set_flash(flash)
    jpeg, _ = world.photograph(EXPOSURE_US)
    if output.suffix.lower() == ".png":
        _, data = cv2.imencode(".png", np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)))
        files.write_bytes(output, data.tobytes())
    else:
        files.write_bytes(output, jpeg)


def grow_track(
    output: Annotated[Path, typer.Option("-o", "--output", help="track.csv to write.")],
    seed: Seed = 1,
    hours: Annotated[float, typer.Option(help="Length of the run.")] = 72.0,
    schedule: Annotated[str, typer.Option(help="`6h` alternates; or a list such as `right 37h, left`.")] = "6h",
    force: Force = False,
) -> None:
    """Grow a plant without pictures and write its track."""
    check_file(output, force=force, is_ours=is_track, what="a track")
    track = grow(seed, schedule, hours)
    files.write_text(output, track_text(track.time_s, track.light, track.points_cm))


def grow_runs(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to write; one run folder per plant in it.")],
    seed: Seed = 1,
    open_loop: Annotated[int, typer.Option(min=0, max=1000, help="Runs with six-hour switching.")] = OPEN_LOOP,
    closed_loop: Annotated[int, typer.Option(min=0, max=1000, help="Runs that follow the tip.")] = CLOSED_LOOP,
    random_loop: Annotated[
        int, typer.Option("--random", min=0, max=1000, help="Runs under random light, each under its own.")
    ] = 0,
    hours: Annotated[float, typer.Option(help="Length of each run.")] = HOURS,
    pixel_cm: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1.0,
            help=f"Tell tracks in whole pixels of this size, {SMALLEST_PIXEL_CM:g} at least; 0 tells them exactly.",
        ),
    ] = 0.0,
    photographs: Annotated[
        bool,
        typer.Option(
            "--photographs", help="Photograph the plants in place of telling their tracks; some 40 s for 72 hours."
        ),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Drop unfinished --photographs of other settings that are there.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Grow the paper's dataset experiments: run folders with run.toml and track.csv.

    Each run is of another individual: SEED, SEED + 1, ...

    With --photographs there is no track.csv, but background/, frames/ and frames.csv as a rig leaves them, for
    `flora-lab track`; the true stems are in truth.csv. The same command, given again after it was killed, goes on after
    the last whole run; one of other settings is refused until --force drops what is there.
    """
    must_be_new(output)
    if open_loop + closed_loop + random_loop == 0:
        raise BadInput("no runs: --open-loop, --closed-loop and --random are all 0")
    if not 1.0 <= hours <= 400.0:
        raise BadInput(f"hours is {hours:g}; it must lie in [1, 400]")
    if not (pixel_cm == 0.0 or pixel_cm >= SMALLEST_PIXEL_CM):  # NaN is neither
        raise BadInput(f"--pixel-cm: {pixel_cm:g} must be 0, or lie in [{SMALLEST_PIXEL_CM:g}, 1]")
    if force and not photographs:
        raise BadInput("--force: has no effect without --photographs; leave it out")
    if photographs:
        if pixel_cm:
            raise BadInput("--pixel-cm: photographs have pixels of their own; leave it out, or --photographs")
        planned = planned_runs(
            seed, open_loops=open_loop, closed_loops=closed_loop, hours=hours, random_loops=random_loop
        )
        _photograph(output, planned, hours, quiet=quiet, force=force)
        typer.echo(f"photographed {counted(len(planned), 'run')} of {hours:g} h in {output}")
        return
    runs = dataset_runs(
        seed,
        open_loops=open_loop,
        closed_loops=closed_loop,
        hours=hours,
        random_loops=random_loop,
        pixel_cm=pixel_cm,
    )
    with files.whole_folder(output) as folder:
        for run in runs:
            inner = RunFolder(folder / run.name)
            inner.path.mkdir()
            inner.run_toml.write_text(run.run_text(), encoding="utf-8")
            inner.track_csv.write_text(run.track_text(), encoding="utf-8")
    typer.echo(f"wrote {counted(len(runs), 'run')} of {hours:g} h in {output}")


def _photograph(output: Path, planned: Sequence[PlannedRun], hours: float, *, quiet: bool, force: bool) -> None:
    each, console = photographs_in(hours), Console(stderr=True)
    cv2.setNumThreads(1)  # whoever photographs several folders at a time gives each a core
    with Progress(
        *(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()),
        console=console,
        disable=quiet or not console.is_terminal,
    ) as bar:
        task = bar.add_task("photographs", total=each * len(planned))
        write_runs(
            output,
            planned,
            hours,
            on_photograph=lambda: bar.advance(task),
            on_kept=lambda _name: bar.advance(task, each),
            force=force,
        )


def list_faults() -> None:
    """Print the fault menu."""
    for fault in menu.MENU.values():
        typer.echo(f"{fault.name:<20}{fault.layer:<7}{fault.description}")
