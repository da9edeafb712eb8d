"""One experiment in the virtual rig: an individual plant, steered for hours by the real services, and its outcome."""

from __future__ import annotations

import contextlib
import math
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from flora_common.config import DASHBOARD_PORT
from flora_common.controller_file import SUFFIX, LoadedController
from flora_common.errors import BadInput, DiskFull, FloraError
from flora_common.files import make_folder, write_bytes
from flora_common.geometry import collides
from flora_common.installed import command
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET, RUN_HOURS, STOP_HEIGHT_CM
from flora_common.runs import RunFile
from flora_common.shapes import Obstacle, Target
from flora_twin.box import camera_section
from flora_twin.rig.faults import FaultSchedule, PlannedFault, check_plan
from flora_twin.rig.integrity import check_run
from flora_twin.rig.layout import Layout, claimed, make_layout, remove_sockets, with_task
from flora_twin.rig.outcome import Outcome, write_report
from flora_twin.rig.supervisor import ServiceFailed
from flora_twin.rig.truth import check_truth
from flora_twin.rig.virtual_rig import CONTROLLER, DASHBOARD, SERVICES, Seen, VirtualRig

LEAST_FREE_BYTES: Final = 1 << 20
"""With less, whatever went wrong went wrong for want of room: a photograph alone is a tenth of it."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """What is asked for.

    Attributes:
        out: folder for report, picture strip, and the rig's own folder ``rig/``.
        made_by: the command; what another one made is not replaced.
        start: UTC at which the run is said to begin.
        seed: the plant's individual.
        rate: 0 for lock-step, else times real time.
        hours: length of the run.
        controller: a built-in name, the path of a controller file, or one that is read already. Of that the rig gets a
            copy of its own, so that nothing that happens to the file changes the run.
        keys_dirs: folders of the public keys, ``*.pub``, of those whose controllers the rig takes.
        is_signed: a controller file that is named must be signed by one of them.
        target, obstacle: the task.
        stop_height_cm: height of the tip that counts as the end.
        goes_on: for all its hours, whatever the plant does; else the run ends where it is over.
        faults: on schedule.
        quiet: no progress bar.
        dashboard: serve the rig's page meanwhile.
    """

    out: Path
    made_by: str
    start: datetime
    seed: int = 1
    rate: float = 0.0
    hours: float = RUN_HOURS
    controller: str | LoadedController = "waypoint"
    keys_dirs: tuple[Path, ...] = ()
    is_signed: bool = False
    target: Target = REALITY_TARGET
    obstacle: Obstacle = REALITY_OBSTACLE
    stop_height_cm: float = STOP_HEIGHT_CM
    goes_on: bool = False
    faults: tuple[PlannedFault, ...] = ()
    quiet: bool = False
    dashboard: bool = False

    @property
    def controller_name(self) -> str:
        """For people."""
        return (
            self.controller.file.name if isinstance(self.controller, LoadedController) else Path(self.controller).name
        )


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


def run_experiment(asked: Experiment, console: Console) -> tuple[dict[str, Any], Outcome]:
    """Grow the plant; returns the report's figures, and what else happened.

    Raises:
        FloraError: a service failed, or it refuses what it was given. What cannot be used is told before anything in
            the folder is removed.
    """
    _check_hours(asked)
    _check_controller(asked)
    with claimed(asked.out, asked.made_by) as root, _full_disk_told(asked.out):
        return _run_in(root, asked, console)


def _run_in(root: Path, asked: Experiment, console: Console) -> tuple[dict[str, Any], Outcome]:
    with contextlib.ExitStack() as held:
        port = take_port(held) if asked.dashboard else None
        layout = _make_rig(root, asked, port)
        began_s = time.monotonic()
        rig = held.enter_context(VirtualRig(layout, seed=asked.seed, rate=asked.rate))
        held.enter_context(_polite_end(rig))
        if not asked.quiet:
            console.print("starting box, bus and services", style="dim")
        rig.start(SERVICES if port is None else (*SERVICES, DASHBOARD))
        if port is not None and not asked.quiet:
            console.print(f"look at it: http://127.0.0.1:{port}/")
        if not asked.quiet:
            console.print("background pictures of the empty box, every lamp state", style="dim")
        rig.calibrate()
        _grow(rig, asked, console)
        restarts = rig.restarts()
        rig.finish()
    outcome = Outcome(
        seen=rig.seen,
        restarts=restarts,
        integrity=check_run(layout.run, layout.nas / layout.run.path.name),
        truth=check_truth(layout.run, layout.box_dir),
        hours=min(asked.hours, rig.seen.tick.time_s / 3600) if rig.seen.tick else 0.0,
        took_s=time.monotonic() - began_s,
    )
    figures = write_report(
        layout,
        asked.out,
        outcome,
        controller=asked.controller_name,
        stop_height_cm=asked.stop_height_cm,
        hours=asked.hours,
    )
    return figures, outcome


def check_photographs(outcome: Outcome) -> None:
    """Whether every photograph is there.

    Raises:
        ServiceFailed: one is not.
    """
    if not outcome.integrity.whole:
        raise ServiceFailed(f"photographs were lost: {outcome.integrity}")


def _make_rig(root: Path, asked: Experiment, port: int | None) -> Layout:
    run_file = RunFile(camera=camera_section(), rig="demo", plant=f"virtual bean, seed {asked.seed}", start=asked.start)
    task = with_task(run_file, asked.target, asked.obstacle)
    sections: dict[str, dict[str, Any]] = {} if port is None else {"dashboard": {"port": port}}
    if not isinstance(asked.controller, LoadedController):
        keys = root.resolve() / "keys"
        named = {"use": asked.controller, "keys_dir": str(keys)} | ({"trust": "required"} if asked.is_signed else {})
        layout = make_layout(root, task, sections=sections | {"controller": named})
        make_folder(keys)
        for number, path in enumerate(path for folder in asked.keys_dirs for path in sorted(folder.glob("*.pub"))):
            write_bytes(keys / f"{number}-{path.name}", path.read_bytes())
        return layout
    copy = root.resolve() / f"steering{SUFFIX}"
    # Whoever signed it, and whatever it was evolved for: this is where that is found out.
    rules = {"use": str(copy), "trust": "none", "task": "any", "stop_height_cm": asked.stop_height_cm}
    layout = make_layout(root, task, sections=sections | {"controller": rules})
    write_bytes(copy, asked.controller.data)
    return layout


def take_port(held: contextlib.ExitStack) -> int:
    """The usual port of the page, or any where somebody else has it: several demos may run on one machine.

    Args:
        held: what keeps others away until the page has ended. Of two demos that begin at once one would find the usual
            port free that the other's page, some seconds later, has; any other one might be given away meanwhile.

    Raises:
        ServiceFailed: there is none.
    """
    for port in (DASHBOARD_PORT, 0):
        with contextlib.ExitStack() as tried, contextlib.suppress(OSError):
            if port:
                mark = tried.enter_context(socket.socket(socket.AF_UNIX))
                mark.bind(f"\0flora-page-{port}")  # in no folder, and gone with its process
            # Bound as the page binds: who has just left it is no bar, nor is this one, which does not listen.
            reserved = tried.enter_context(socket.socket())
            reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            reserved.bind(("127.0.0.1", port))
            held.enter_context(tried.pop_all())
            return int(reserved.getsockname()[1])
    raise ServiceFailed("no port of 127.0.0.1 is free for the page; --no-dashboard does without")


def _check_controller(asked: Experiment) -> None:
    """Whether flora-controller would steer so: it is asked in a rig that is thrown away."""
    with tempfile.TemporaryDirectory(prefix="flora-") as folder:
        layout = _make_rig(Path(folder) / "rig", asked, None)
        try:
            done = subprocess.run(
                [command(CONTROLLER), "--config", str(layout.config), "--check-config"],
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            remove_sockets(layout)
    if done.returncode == 0:
        return
    said = (done.stderr.strip().splitlines() or [f"ended with status {done.returncode}"])[-1]
    if done.returncode != BadInput.exit_status:
        raise ServiceFailed(f"{CONTROLLER} cannot be asked: {said}")
    # A file of the rig that is gone by now helps nobody.
    raise BadInput(said.removeprefix(f"{CONTROLLER}: ").removeprefix(f"{layout.run.run_toml}: "))


def _check_hours(asked: Experiment) -> None:
    if not math.isfinite(asked.hours) or not math.isfinite(asked.stop_height_cm):
        raise BadInput("--hours and --stop-height: give numbers")
    for planned in asked.faults:
        if planned.at_h >= asked.hours:
            raise BadInput(
                f"fault {planned.name}@{planned.at_h:g}h would never strike: the run ends at {asked.hours:g} h"
            )
    check_plan(asked.faults)


@contextlib.contextmanager
def _full_disk_told(out: Path) -> Iterator[None]:
    """On a full disk services die, fall silent or leave half a line, and each says something else of it."""
    try:
        yield
    except (FloraError, OSError, ValueError) as problem:
        if shutil.disk_usage(out).free >= LEAST_FREE_BYTES:
            raise
        raise DiskFull(f"{out}: no room on the disk; free some space, or choose a folder elsewhere") from problem


@contextlib.contextmanager
def _polite_end(rig: VirtualRig) -> Iterator[None]:
    """Ctrl-C, SIGTERM, and SIGHUP of a closed terminal end the experiment with every process stopped."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: rig.supervisor.interrupt()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _grow(rig: VirtualRig, asked: Experiment, console: Console) -> None:
    schedule = FaultSchedule(rig, asked.faults)
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f}/{task.total:g} h,"),
        TimeRemainingColumn(compact=True),
        TextColumn("left"),
        console=console,
        disable=asked.quiet,
    )
    with progress:
        bar = progress.add_task("growing", total=asked.hours)

        def each(seen: Seen) -> None:
            schedule(seen)
            if seen.tick is not None:
                grown_h = min(seen.tick.time_s / 3600, asked.hours)  # the last tick may come after them
                progress.update(bar, completed=grown_h, description=describe(seen))

        try:
            rig.run(lambda seen: is_enough(seen, asked), each=each)
        finally:
            schedule.end_all()


def is_enough(seen: Seen, asked: Experiment) -> bool:
    """The lamps of the last tick within the hours are confirmed, or those of the stem with which the run is over."""
    tick, lamps, stem = seen.tick, seen.lamps, seen.stem
    if tick is None or lamps is None:
        return False
    if tick.time_s / 3600 >= asked.hours - 1e-6 and lamps.tick >= tick.tick:
        return True
    if asked.goes_on or stem is None or not stem.points_cm or lamps.tick < stem.tick:
        return False
    return stem.points_cm[-1][1] >= asked.stop_height_cm or collides(stem.points_cm, asked.obstacle)


def describe(seen: Seen) -> str:
    """The state of the plant in half a line."""
    state, lamps = seen.controller, seen.lamps
    tip = "no stem yet" if state is None or state.tip_cm is None else "tip ({:+.1f}, {:.1f}) cm".format(*state.tip_cm)
    fitness = "" if state is None or state.fitness is None else f"  fitness {100 * state.fitness:5.1f} %"
    lamp = "" if lamps is None else f"  lamp {lamps.lit:5}"
    return f"{tip}{fitness}{lamp}"
