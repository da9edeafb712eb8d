"""``flora-stem calibrate``: the setup run, which photographs the empty setup under every lamp.

It asks over the bus, one step at a time: ``setup`` names lamps and file; flora-led lights them, flora-flash fires,
flora-capture stores ``background/<file>`` and says ``frame``; then comes the next step. The beat rests meanwhile.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zmq

from flora_common.bus import BusClient
from flora_common.cli import ArgumentParser, run_cli
from flora_common.config import RigSection, load_config
from flora_common.counted import counted
from flora_common.errors import BadInput, BusUnreachable, DeviceError, StoreError
from flora_common.files import fsync_folder, make_folder
from flora_common.lock import AlreadyHeld, hold_folder
from flora_common.messages import Frame, FrameMissed, Lamps, Message, Setup
from flora_common.runs import Light, RunFolder
from flora_common.service import default_clock
from flora_stem.section import StemSection

SOURCE: Final = "flora-stem-calibrate"
STATES: Final[tuple[Light, ...]] = ("left", "right", "dark", "both")
SAY_AGAIN_S: Final = 15.0
"""Who hears nothing of a setup run for a minute takes it for over."""
BUS_WITHIN_S: Final = 10.0
TRIES: Final = 2


class SetupRunFailed(DeviceError):
    """A picture of the empty setup did not come."""


@dataclass(frozen=True, slots=True)
class Step:
    """One lamp state and one picture; numbered from 1."""

    number: int
    lamps: Light
    shot: str


def plan(each: int) -> list[Step]:
    """``each`` pictures in every lamp state."""
    shots = [(lamps, f"{lamps}-{k}.jpg") for lamps in STATES for k in range(1, each + 1)]
    return [Step(number, lamps, shot) for number, (lamps, shot) in enumerate(shots, start=1)]


class SetupRun:
    """Asks for one step after the other; told of time and messages, it knows neither socket nor clock.

    Args:
        steps: what to photograph.
        timeout_s: real seconds that a step may take.
        say: publishes.
    """

    def __init__(self, steps: Sequence[Step], *, timeout_s: float, say: Callable[[Message], None]) -> None:
        self._steps = steps
        self._timeout_s = timeout_s
        self._say = say
        self._at = -1
        self._begun_s = self._said_s = 0.0
        self._lit = False
        self._missed = 0
        self._after_tick = 0

    @property
    def step(self) -> Step | None:
        """The step that is under way; None before the first and after the last."""
        return self._steps[self._at] if 0 <= self._at < len(self._steps) else None

    def begin(self, now_s: float) -> None:
        """Ask for the next step."""
        self._at += 1
        self._lit, self._missed = False, 0
        self._begun_s = now_s
        self._ask(now_s)

    def hear(self, message: Message, now_s: float) -> None:
        """A message of the rig.

        Raises:
            SetupRunFailed: there is no photograph for this step.
        """
        step = self.step
        if isinstance(message, Lamps) and step is not None and message.setup_step == step.number:
            self._lit = True
        if not isinstance(message, Frame | FrameMissed):
            return
        is_new = message.tick > self._after_tick
        self._after_tick = max(self._after_tick, message.tick)
        if step is None or not is_new or message.purpose != "background":
            return
        if isinstance(message, FrameMissed):
            if message.shot == step.shot:
                self._missed += 1
                if self._missed == TRIES:
                    raise SetupRunFailed(f"no photograph for {step.shot} ({message.because}): {message.reason}")
                self._ask(now_s)
        elif message.path == f"background/{step.shot}":
            self.begin(now_s)

    def check(self, now_s: float) -> None:
        """Say again what was said long ago; give up where nothing comes.

        Raises:
            SetupRunFailed: the step has taken too long.
        """
        step = self.step
        if step is not None and now_s - self._begun_s > self._timeout_s:
            waits_for = "flora-flash and flora-capture" if self._lit else "flora-led"
            what = "no photograph came" if self._lit else f"nobody lit `{step.lamps}`"
            raise SetupRunFailed(
                f"step {step.number} ({step.shot}): {what} in {self._timeout_s:g} s; is {waits_for} running?"
            )
        if now_s - self._said_s > SAY_AGAIN_S:
            self._ask(now_s)

    def end(self) -> None:
        """Let the beat go on."""
        self._say(Setup(active=False))

    def _ask(self, now_s: float) -> None:
        step = self.step or self._steps[-1]
        self._said_s = now_s
        self._say(Setup(active=True, step=step.number, steps=len(self._steps), lamps=step.lamps, shot=step.shot))


class Line:
    """The bus for a command that runs for a minute: waits for messages with a time limit."""

    def __init__(self, bus: BusClient) -> None:
        self.bus = bus
        self._poller = zmq.Poller()
        self._poller.register(bus.publisher, zmq.POLLIN)
        self._poller.register(bus.subscriber, zmq.POLLIN)

    def wait(self, seconds: float) -> Iterator[Message]:
        """What of the rig arrives within the time; returns as soon as there is something."""
        self._poller.poll(int(seconds * 1000))
        self.bus.handle_publisher()
        for rig, message in self.bus.receive():
            if rig == self.bus.rig:
                yield message

    def connect(self) -> list[Message]:
        """Wait for the bus; returns what it kept.

        Raises:
            BusUnreachable: nobody answers.
        """
        self.bus.connect()
        kept: list[Message] = []
        give_up_s = time.monotonic() + BUS_WITHIN_S
        while not self.bus.connected:
            if time.monotonic() > give_up_s:
                nobody = f"no answer from the bus in {BUS_WITHIN_S:g} s; is flora-bus running?"
                raise BusUnreachable(self.bus.hindrance or nobody)
            kept += self.wait(0.1)
        return kept


def set_aside(run: RunFolder) -> Path | None:
    """Move the pictures of an earlier setup run into a folder of their own; nothing is deleted.

    Raises:
        StoreError: the folder is read-only, full or not ours. Those that were moved already are safe; asking again
            moves the rest.
    """
    try:
        pictures = run.background_pictures()
        if not pictures:
            return None
        number = 1
        while (run.background / f"before-{number}").exists():
            number += 1
        folder = run.background / f"before-{number}"
        make_folder(folder)
        for picture in pictures:
            picture.rename(folder / picture.name)
        fsync_folder(folder)
        fsync_folder(run.background)
    except OSError as problem:
        raise StoreError(
            f"{run.background}: the earlier pictures cannot be set aside ({problem.strerror});"
            " see that the folder can be written"
        ) from problem
    return folder


def take_pictures(setup: SetupRun, line: Line, steps: int) -> None:
    """Go through all steps, telling each on stderr.

    Raises:
        SetupRunFailed: a step brought no picture.
    """
    for message in line.connect():
        setup.hear(message, 0.0)
    setup.begin(time.monotonic())
    told = None
    while setup.step is not None:
        if setup.step is not told:
            told = setup.step
            print(f"setup run: {told.number} of {steps}, lamps {told.lamps}, {told.shot}", file=sys.stderr, flush=True)
        for message in line.wait(0.5):
            setup.hear(message, time.monotonic())
        setup.check(time.monotonic())


def wait_for_enter(setup: SetupRun, line: Line) -> None:
    """Keep the beat at rest until a line, or the end, comes on standard input."""
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        for message in line.wait(0.2):
            setup.hear(message, time.monotonic())
        setup.check(time.monotonic())
    sys.stdin.readline()


@contextlib.contextmanager
def _always_ended(setup: SetupRun, line: Line) -> Iterator[None]:
    try:
        yield
    finally:
        setup.end()
        line.bus.handle_publisher()
        line.bus.close()


@contextlib.contextmanager
def alone(rig: RigSection) -> Iterator[None]:
    """Keep other setup runs of the rig away meanwhile: each would photograph what the other one has lit.

    Raises:
        BadInput: there is one.
    """
    with contextlib.ExitStack() as held:
        try:
            # The folder, no file in it: whoever calibrates as root would leave one that the next person cannot open.
            held.callback(os.close, hold_folder(Path(rig.state_dir)))
        except AlreadyHeld:
            raise BadInput(f"another setup run of rig `{rig.name}` is under way; wait for its end") from None
        except OSError:
            pass  # no service has run here yet: the bus will tell
        yield


def photograph(rig: RigSection, run: RunFolder, options: argparse.Namespace) -> None:
    """The whole setup run.

    Raises:
        FloraError: there are pictures already, nobody answers, or a picture did not come.
    """
    there = run.background_pictures()
    if there and not options.again:
        raise BadInput(
            f"{run.background}: already holds {counted(len(there), 'picture')}; --again sets them aside and takes "
            "new ones"
        )
    steps = plan(options.each)
    clock = default_clock(rig)
    line = Line(BusClient(rig.bus, rig=rig.name, source=SOURCE, clock=clock))
    line.bus.subscribe(Lamps, Frame, FrameMissed)
    setup = SetupRun(steps, timeout_s=options.timeout, say=line.bus.publish)
    with _always_ended(setup, line):
        aside = set_aside(run)
        if aside is not None:
            print(f"setup run: earlier pictures are in {aside}", file=sys.stderr)
        take_pictures(setup, line, len(steps))
        after = "; put the plant in and press Enter" if options.wait else ""
        print(f"{len(steps)} pictures of the empty setup are in {run.background}{after}", flush=True)
        if options.wait:
            wait_for_enter(setup, line)


def main(argv: Sequence[str]) -> int:
    """The command; returns the exit status."""

    def work() -> None:
        options = _parser().parse_args(argv)
        for ending in (signal.SIGTERM, signal.SIGHUP):  # the beat must go on, however this ends; also a lost ssh line
            signal.signal(ending, signal.default_int_handler)
        rig, _ = load_config(options.config, "stem", StemSection)
        run = RunFolder(Path(rig.run_dir))
        run.read_run_file()
        with alone(rig):
            photograph(rig, run, options)

    return run_cli("flora-stem calibrate", work)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        "flora-stem calibrate",
        description="Photographs the empty setup in every lamp state, with all services running and no plant.",
    )
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the rig's TOML file (default /etc/flora/flora.toml)"
    )
    parser.add_argument(
        "--each", type=_count, default=2, metavar="N", help="pictures per lamp state, 1 to 50 (default 2)"
    )
    parser.add_argument(
        "--timeout", type=_seconds, default=50.0, metavar="S", help="real seconds that a picture may take (default 50)"
    )
    parser.add_argument("--again", action="store_true", help="set pictures of an earlier setup run aside")
    parser.add_argument(
        "--wait", action="store_true", help="keep the beat at rest until Enter: time to put the plant in"
    )
    return parser


def _count(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 0
    if not 1 <= value <= 50:
        raise argparse.ArgumentTypeError("must be 1 to 50")
    return value


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 3600.0:
        raise argparse.ArgumentTypeError("must be above 0, 3600 s at most")
    return value
