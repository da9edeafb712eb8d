"""One virtual rig from start to end: the grow box, the services, the setup run, the plant, the run.

Used by the demo, by ``flora-twin rig`` and by the tests, which all share the fault menu.
"""

from __future__ import annotations

import os
import select
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Self

from flora_common.bus import BusClient
from flora_common.clock import FollowerClock
from flora_common.config import RigSection, load_config
from flora_common.installed import command
from flora_common.messages import (
    ControllerState,
    Flash,
    Frame,
    FrameMissed,
    Health,
    Lamps,
    LightCommand,
    Message,
    Stem,
    Stored,
    Tick,
)
from flora_common.twin_link import TwinLink
from flora_twin.rig.layout import Layout, remove_sockets
from flora_twin.rig.supervisor import ServiceFailed, Supervisor, end_with_parent, wait_until

BOX: Final = "flora-twin"
BUS: Final = "flora-bus"
CONTROLLER: Final = "flora-controller"
SERVICES: Final = (
    "flora-recorder",
    "flora-uploader",
    "flora-led",
    "flora-capture",
    "flora-stem",
    CONTROLLER,
    "flora-flash",
)
DASHBOARD: Final = "flora-dashboard"
"""A rig is well without it: who wants it starts it besides."""
STOP_ORDER: Final = (
    DASHBOARD,
    "flora-flash",
    "flora-capture",
    "flora-stem",
    CONTROLLER,
    "flora-led",
    "flora-recorder",
    "flora-uploader",
    "flora-bus",
)
"""The beat first, then down the line; the uploader last, so that the closed recording still reaches the NAS."""

WATCHED: Final = (Tick, Flash, Frame, FrameMissed, Stem, LightCommand, ControllerState, Lamps, Stored, Health)

ANSWER_WITHIN_S: Final = 30.0
CALIBRATION_WITHIN_S: Final = 120.0


@dataclass(slots=True)
class Seen:
    """What the bus said so far."""

    tick: Tick | None = None
    stem: Stem | None = None
    lamps: Lamps | None = None
    controller: ControllerState | None = None
    flash: Flash | None = None
    stored: Stored | None = None
    frames: list[Frame] = field(default_factory=list)
    missed: list[FrameMissed] = field(default_factory=list)
    outcomes: dict[str, int] = field(default_factory=dict)
    health: dict[str, Health] = field(default_factory=dict)
    lights: list[LightCommand] = field(default_factory=list)

    def take(self, message: Message) -> None:
        match message:
            case Tick():
                self.tick = message if message.purpose == "run" else self.tick
            case Stem():
                self.stem = message
                self.outcomes[message.outcome] = self.outcomes.get(message.outcome, 0) + 1
            case Lamps():
                self.lamps = message
            case LightCommand():
                self.lights.append(message)
            case ControllerState():
                self.controller = message
            case Stored():
                self.stored = message
            case Flash():
                self.flash = message
            case Frame():
                self.frames.append(message)
            case FrameMissed():
                self.missed.append(message)
            case Health():
                self.health[message.source] = message
            case _:
                pass


class VirtualRig:
    """A context manager: leaving it ends every process and removes the sockets.

    Args:
        layout: its folder.
        seed: the plant's individual.
        rate: 0 for lock-step, else times real time.
    """

    def __init__(self, layout: Layout, *, seed: int, rate: float = 0.0) -> None:
        self.layout = layout
        self.supervisor = Supervisor(layout.sockets, layout.logs)
        self.seen = Seen()
        self._seed = seed
        self._rate = rate
        self._box: TwinLink | None = None
        self._bus: BusClient | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        if value is None:
            self.supervisor.stop_all(STOP_ORDER)
        else:
            self.supervisor.end_all([n for n in STOP_ORDER if n != BUS])
        if self._bus is not None:
            self._bus.close()
        if self._box is not None:
            self._box.close()
        remove_sockets(self.layout)

    @property
    def box(self) -> TwinLink:
        """The wire to the grow box, for faults and planting."""
        if self._box is None:
            self._box = TwinLink(self.layout.box_address, timeout_s=ANSWER_WITHIN_S)
        return self._box

    def start(self, services: Sequence[str] = SERVICES) -> None:
        """Start box, bus and services, and wait until all are ready.

        Raises:
            ServiceFailed: one of them is not.
        """
        # Ready before it is asked: a question to a box that has died would be waited for, deaf to Ctrl-C.
        self.supervisor.start(BOX, [command(BOX), "serve", *self._box_arguments()])
        self.box.ask("plant", present=False)
        self.supervisor.start(BUS, self._argv(BUS))
        for name in services:
            self.supervisor.launch(name, self._argv(name))
        self.supervisor.wait_ready(services, within_s=60.0)
        self._watch()

    def _box_arguments(self) -> list[str]:
        layout = self.layout
        arguments = ["--address", layout.box_address, "--state-dir", str(layout.box_dir), "--seed", str(self._seed)]
        start = layout.run.read_run_file().start
        return [*arguments, "--rate", f"{self._rate:g}", *(["--start", start.isoformat()] if start else [])]

    def _argv(self, name: str) -> list[str]:
        return [command(name), "--config", str(self.layout.config)]

    def _watch(self) -> None:
        rig, _ = load_config(self.layout.config, "rig", RigSection)
        mono_ns, utc_ns, rate = self.box.now()
        clock = FollowerClock(rate, mono_ns=mono_ns, utc_ns=utc_ns)
        self._bus = BusClient(rig.bus, rig=rig.name, source="flora-twin-rig", clock=clock)
        self._bus.subscribe(*WATCHED)
        self._bus.connect()

    def poll(self) -> None:
        """Let the supervisor work and hear the bus."""
        self.supervisor.poll()
        if self._bus is None:
            return
        self._bus.handle_publisher()
        for _, message in self._bus.receive():
            self.seen.take(message)

    def calibrate(self) -> None:
        """Take the background pictures of the empty box, then put the plant in.

        Raises:
            ServiceFailed: the setup run did not come to its end.
        """
        argv = [command("flora-stem"), "calibrate", "--config", str(self.layout.config), "--wait"]
        with (self.layout.logs / "calibrate.log").open("ab") as log:
            setup = subprocess.Popen(
                argv,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                preexec_fn=end_with_parent(),  # noqa: PLW1509 - as the supervisor's
            )
        assert setup.stdin is not None
        assert setup.stdout is not None
        try:
            deadline_s = time.monotonic() + CALIBRATION_WITHIN_S
            said = b""
            # It says in a line that all pictures are taken, and waits for the plant to be put in.
            while b"\n" not in said:
                self.poll()
                if setup.poll() is not None or time.monotonic() > deadline_s:
                    raise ServiceFailed(f"the setup run failed: see {self.layout.logs / 'calibrate.log'}")
                if select.select([setup.stdout], [], [], 0.01)[0]:
                    said += os.read(setup.stdout.fileno(), 4096)
            self.box.ask("plant", present=True)
            setup.stdin.write(b"\n")
            setup.stdin.close()
            wait_until(
                lambda: setup.poll() is not None, within_s=ANSWER_WITHIN_S, poll=self.poll, what="end of the setup run"
            )
            if setup.returncode != 0:
                raise ServiceFailed(f"the setup run failed: see {self.layout.logs / 'calibrate.log'}")
        finally:
            if setup.poll() is None:
                setup.kill()
            setup.wait()
            setup.stdout.close()
            setup.stdin.close()

    def run(
        self,
        until: Callable[[Seen], bool],
        *,
        each: Callable[[Seen], None] = lambda seen: None,
        stalled_after_s: float = 180.0,
    ) -> None:
        """Let the run go on until a condition on what the bus said holds.

        Args:
            until: the condition.
            each: called after every poll: progress, faults on schedule.
            stalled_after_s: real seconds without a new tick that count as a stall (beyond one beat's own length).

        Raises:
            ServiceFailed: no tick for too long.
        """
        beat_s = self.layout.run.read_run_file().interval_s / self._rate if self._rate else 0.0
        last, last_s = self.seen.tick, time.monotonic()
        while not until(self.seen):
            self.poll()
            each(self.seen)
            if self.seen.tick is not last:
                last, last_s = self.seen.tick, time.monotonic()
            if time.monotonic() - last_s > stalled_after_s + beat_s:
                raise ServiceFailed(f"no tick for {stalled_after_s + beat_s:g} s: see the logs in {self.layout.logs}")
            time.sleep(0.005)

    def finish(self) -> None:
        """End the run politely: beat first, recording closed, everything at the NAS."""
        self.supervisor.stop_all([n for n in STOP_ORDER if n != BUS])
        upload = subprocess.run(
            [command("flora-uploader"), "--config", str(self.layout.config), "--once"],
            capture_output=True,
            text=True,
            check=False,
        )
        if upload.returncode != 0:
            raise ServiceFailed(f"the last upload failed: {upload.stderr.strip() or upload.stdout.strip()}")

    def restarts(self) -> dict[str, int]:
        """How often each process was started again."""
        return {name: child.restarts for name, child in self.supervisor.children.items() if child.restarts}
