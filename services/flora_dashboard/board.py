"""All that the page shows, kept from messages: pure, with time handed in."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from flora_common.bus import Freshness
from flora_common.clock import Clock
from flora_common.health import HealthBoard, Line, services_of_catalogue
from flora_common.messages import CATALOGUE, Frame, Health, Message, Stem, spec_of
from flora_common.runs import CameraSection, LampsSection, ObstacleSection, RunFile, TargetSection
from flora_dashboard.concerns import Concern, concerns
from flora_dashboard.history import History

NOT_SHOWN: Final = frozenset({"health", "controller_chunk", "job"})
"""Told otherwise, or no news for people."""


class Told(msgspec.Struct, frozen=True):
    """The last message of a kind.

    Attributes:
        age_s: rig seconds since it was said.
        is_fresh: said within two and a half of its periods.
        message: all of its fields.
    """

    age_s: float
    is_fresh: bool
    message: Message


class Service(msgspec.Struct, frozen=True):
    """How a service is; see :class:`flora_common.health.Line`."""

    name: str
    state: str
    reason: str
    age_s: float | None
    uptime_s: float
    resident_mib: float
    gaps: int
    bad: int
    ok: bool


class View(msgspec.Struct, frozen=True):
    """The page's content at one moment, as ``/api/state`` tells it.

    Attributes:
        format: :data:`FORMAT`.
        rig, run: names of the rig and of its run folder.
        plant, interval_s, camera, lamps, target, obstacle: of ``run.toml``; empty, 300 and None without one.
        is_connected: the bus answers.
        photograph: that the last stem was measured in, or the last one, where that has waited for its stem for longer
            than a beat; None before the first.
        is_measured: the last stem was measured in that photograph.
        last: the last message of each kind that was heard.
        services: how each service is.
        concerns: what somebody should know or do.
        rows_begin, rows_end: numbers of the first row of the history, and of the one that comes next.
    """

    format: str
    rig: str
    run: str
    plant: str
    interval_s: float
    camera: CameraSection | None
    lamps: LampsSection | None
    target: TargetSection | None
    obstacle: ObstacleSection | None
    is_connected: bool
    photograph: Frame | None
    is_measured: bool
    last: dict[str, Told]
    services: list[Service]
    concerns: list[Concern]
    rows_begin: int
    rows_end: int


FORMAT: Final = "flora-dashboard-1"


class Board:
    """What is known of a rig.

    Args:
        rig: its name.
        run: name of the run folder.
        run_file: of the run; None where there is none that can be read,
        without: and why, in a sentence.
        clock: rig time.
        history: of the run.
        health_every_s: real seconds between two signs of a service.
        ages_are_known: rig time is this machine's own clock.
    """

    def __init__(
        self,
        rig: str,
        run: str,
        run_file: RunFile | None,
        without: str = "",
        *,
        clock: Clock,
        history: History,
        health_every_s: float,
        ages_are_known: bool,
    ) -> None:
        self._rig = rig
        self._run = run
        self._run_file = run_file
        self._without = [Concern("problem", without)] if without else []
        self._clock = clock
        self._interval_s = run_file.interval_s if run_file else 300.0
        self._inbox = Freshness(clock, tick_s=self._interval_s)
        self._services = HealthBoard(services_of_catalogue(), period_s=health_every_s, ages_are_known=ages_are_known)
        self.history = history
        self._frame_before: Frame | None = None

    def hear(self, message: Message, *, real_s: float, is_live: bool) -> None:
        """A message of this rig.

        Args:
            message: any.
            real_s: monotonic seconds.
            is_live: said since this began to listen, not kept by the bus.
        """
        if isinstance(message, Health):
            self._services.hear(message, real_s=real_s, is_live=is_live)
            return
        if isinstance(message, Frame) and message.purpose != "run":
            return  # the setup without a plant has no stem, and is soon over
        newest = self._inbox.last(Frame)
        if isinstance(message, Frame) and newest is not None and newest.sha256 != message.sha256:
            self._frame_before = newest
        if isinstance(message, Stem):
            self.history.hear(message)
        kind = spec_of(type(message)).kind
        if kind not in NOT_SHOWN:
            self._inbox.hear(kind, message)

    def view(self, *, real_s: float, is_connected: bool) -> View:
        """What is to be shown now."""
        lines = self._services.lines(real_s=real_s, mono_ns=self._clock.mono_ns())
        photograph, run = self._photograph(), self._run_file
        stem = self._inbox.last(Stem)
        return View(
            format=FORMAT,
            rig=self._rig,
            run=self._run,
            plant=run.plant if run else "",
            interval_s=self._interval_s,
            camera=run.camera if run else None,
            lamps=run.lamps if run else None,
            target=run.target if run else None,
            obstacle=run.obstacle if run else None,
            is_connected=is_connected,
            photograph=photograph,
            is_measured=bool(photograph and stem and stem.frame_sha256 == photograph.sha256),
            last=self._last(),
            services=[_service(line) for line in lines],
            concerns=[
                *self._without,
                *concerns(self._inbox, lines, run=self._run, interval_s=self._interval_s, is_connected=is_connected),
            ],
            rows_begin=self.history.begin,
            rows_end=self.history.end,
        )

    def _photograph(self) -> Frame | None:
        """A picture and its stem are shown together: a new picture takes the old one's place when it is measured."""
        newest, before, stem = self._inbox.last(Frame), self._frame_before, self._inbox.last(Stem)
        is_of_before = before is not None and stem is not None and stem.frame_sha256 == before.sha256
        return before if is_of_before else newest

    def _last(self) -> dict[str, Told]:
        told = {}
        for kind, spec in CATALOGUE.items():
            message, age_s = self._inbox.last(spec.type), self._inbox.age_s(spec.type)
            if message is not None and age_s is not None:
                told[kind] = Told(round(age_s, 1), self._inbox.fresh(spec.type), message)
        return told


def _service(line: Line) -> Service:
    age_s = None if line.age_s is None else round(line.age_s, 1)
    resident_mib = round(line.resident_kib / 1024.0, 1)
    return Service(
        line.service, line.state, line.reason, age_s, line.uptime_s, resident_mib, line.gaps, line.bad, line.ok
    )


def as_json(value: Any) -> bytes:
    """One line."""
    return msgspec.json.encode(value)
