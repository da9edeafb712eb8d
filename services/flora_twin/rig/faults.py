"""The fault menu at work: faults of the box over its wire, faults of the rig by hand on its processes and folders.

``nas_gone@30h:6h`` takes the NAS away from hour 30 for six hours; ``service_killed@12h=flora-stem`` kills once.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput, FloraError
from flora_common.suggest import did_you_mean
from flora_twin.faults import CLOCK_JUMPS, MENU
from flora_twin.rig.virtual_rig import BUS, SERVICES, Seen, VirtualRig

_FORM: Final = re.compile(r"^(?P<name>\w+)@(?P<at>\d+(\.\d+)?)h?(:(?P<for>\d+(\.\d+)?)h?)?(=(?P<argument>[\w.+-]+))?$")
_ONCE: Final = ("service_killed", "bus_restarted")
_OF_THE_NAS: Final = ("nas_gone", "nas_read_only")
_MOUNT_TRIES: Final = 20
_MOUNT_AGAIN_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """One fault of the menu at a time of the run.

    Attributes:
        name: of the menu.
        at_h: hours since the run's start.
        for_h: how long it lasts; None for those that happen once.
        argument: a service's name, or seconds of a clock jump.
    """

    name: str
    at_h: float
    for_h: float | None = None
    argument: str = ""


def parse_fault(text: str) -> PlannedFault:
    """``NAME@HOUR[:HOURS][=ARGUMENT]``.

    Raises:
        BadInput: not of this form, or not on the menu.
    """
    match = _FORM.match(text)
    if match is None:
        raise BadInput(f"fault `{text}`: write NAME@HOUR[:HOURS][=ARGUMENT], such as nas_gone@30h:6h")
    name = match["name"]
    if name not in MENU:
        raise BadInput(f"fault `{name}` is not on the menu{did_you_mean(name, MENU)}")
    argument = match["argument"] or ""
    if name == "service_killed" and argument not in (BUS, *SERVICES):
        raise BadInput(f"fault `{text}`: name a service, such as service_killed@12h=flora-stem")
    if name == "clock_jumps" and argument and not _is_number(argument):
        raise BadInput(f"fault `{text}`: name the seconds of the jump, such as clock_jumps@12h=3600")
    return PlannedFault(name, float(match["at"]), float(match["for"]) if match["for"] else None, argument)


def check_plan(plan: Sequence[PlannedFault]) -> None:
    """Whether each fault can begin, and lasts as long as it is to.

    Raises:
        BadInput: a thing is to break that is broken already: the end of the one fault would be that of the other.
    """
    before: dict[str, PlannedFault] = {}
    for planned in sorted(plan, key=lambda planned: planned.at_h):
        if planned.name in _ONCE:
            continue
        what = "the NAS" if planned.name in _OF_THE_NAS else planned.name
        first = before.get(what)
        before[what] = planned
        if first is None or (what == CLOCK_JUMPS and first.for_h is None and planned.for_h is None):
            continue  # a clock may be set again
        if first.for_h is None or planned.at_h < first.at_h + first.for_h:
            raise BadInput(
                f"fault {planned.name}@{planned.at_h:g}h would begin before {first.name}@{first.at_h:g}h has ended; "
                "let one follow the other"
            )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


@contextlib.contextmanager
def fault(rig: VirtualRig, name: str, argument: str = "") -> Iterator[None]:
    """A fault for as long as the block lasts; those that happen once happen at its beginning."""
    begin(rig, name, argument)
    try:
        yield
    finally:
        end(rig, name)


def begin(rig: VirtualRig, name: str, argument: str = "") -> None:
    """Let a fault begin."""
    nas = rig.layout.nas
    match name:
        case "service_killed":
            rig.supervisor.kill(argument, signal.SIGKILL)
        case "bus_restarted":
            rig.supervisor.kill(BUS, signal.SIGKILL)
        case "nas_gone":
            nas.rename(_aside(nas))
        case "nas_read_only":
            _make_read_only(nas)
        case "clock_jumps":
            rig.box.ask("fault", name=name, on=True, seconds=float(argument or 86_400.0))
        case _:
            rig.box.ask("fault", name=name, on=True)


def end(rig: VirtualRig, name: str) -> None:
    """Let a fault end; nothing to do for those that happen once."""
    nas = rig.layout.nas
    match name:
        case "service_killed" | "bus_restarted":
            return
        case "nas_gone":
            _aside(nas).rename(nas)
        case "nas_read_only":
            _make_writable(nas)
        case _:
            rig.box.ask("fault", name=name, on=False)


class FaultSchedule:
    """Begins and ends planned faults as the run's hours go by; call it with what was seen."""

    def __init__(self, rig: VirtualRig, plan: Sequence[PlannedFault]) -> None:
        self._rig = rig
        self._waiting = sorted(plan, key=lambda planned: planned.at_h)
        self._lasting: list[PlannedFault] = []

    def __call__(self, seen: Seen) -> None:
        if seen.tick is None:
            return
        hour = seen.tick.time_s / 3600
        self._end_until(hour)
        while self._waiting and hour >= self._waiting[0].at_h:
            planned = self._waiting.pop(0)
            self._end_until(planned.at_h)  # one that began just now, too: several may be due at one tick
            begin(self._rig, planned.name, planned.argument)
            self._lasting.append(planned)

    def _end_until(self, hour: float) -> None:
        for planned in [p for p in self._lasting if p.for_h is not None and hour >= p.at_h + p.for_h]:
            self._lasting.remove(planned)
            end(self._rig, planned.name)

    def end_all(self) -> None:
        """Let whatever still lasts end, so that the rig's folders are whole again."""
        while self._lasting:
            end(self._rig, self._lasting.pop().name)


def _aside(nas: Path) -> Path:
    return nas.with_name(nas.name + ".gone")


def _make_read_only(nas: Path) -> None:
    """Root passes over permissions, so for root the folder becomes a read-only mount of itself."""
    if os.geteuid() != 0:
        nas.chmod(0o555)
        return
    _mount("--bind", str(nas), str(nas))
    for tries_left in reversed(range(_MOUNT_TRIES)):
        try:
            _mount("-o", "remount,ro,bind", str(nas))
            return
        except FloraError:  # as long as a file there is open for writing
            if not tries_left:
                _make_writable(nas)
                raise
            time.sleep(_MOUNT_AGAIN_S)


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise FloraError(f"nas_read_only: {arguments[-1]} cannot be mounted read-only here: {done.stderr.strip()}")


def _make_writable(nas: Path) -> None:
    if os.geteuid() != 0:
        nas.chmod(0o755)
        return
    # Whoever has a file open there keeps it; a mount that were left behind could not even be deleted.
    done = subprocess.run(["umount", "--lazy", str(nas)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise OSError(errno.EBUSY, done.stderr.strip(), str(nas))
