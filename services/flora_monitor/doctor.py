"""``flora-monitor doctor``: a tick or a sentence for each part of a rig, before the plant depends on it.

The checks look and do not judge each other: one that fails leaves the rest to be looked at. Nothing is switched or
written but with ``--touch``, and then nothing that a running service holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import msgspec

from flora_common.config import RigSection
from flora_common.files import shown
from flora_common.health import ONLY_LOOKS, services_of_catalogue
from flora_monitor.doctor_case import Case, Heard, check_config, print_configs
from flora_monitor.doctor_devices import check_camera, check_flash, check_strips
from flora_monitor.doctor_machine import check_clock, check_journal, check_memory, check_power, check_programs
from flora_monitor.doctor_store import check_controller, check_disk, check_keys, check_nas, check_run
from flora_monitor.doctor_units import check_units, read_units
from flora_monitor.doctor_world import NotUsed, Remark, Verdict, World, Wrong

MARKS: Final[dict[Verdict, str]] = {"good": "✓", "wrong": "✗", "not used here": "–", "not looked at": "?"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One part of the rig.

    Attributes:
        part: its name.
        verdict: in two words.
        text: what was found; where it is wrong: what, where, and what to do.
    """

    part: str
    verdict: Verdict
    text: str


def check_bus(case: Case) -> str:
    """The bus answers, and every service that must be there is ready."""
    where = case.rig.bus_subscribe
    if not case.heard.is_there:
        if where.startswith("ipc:///"):
            # Raises where the caller may not look into the folder: the bus may well be there.
            case.world.at(where.removeprefix("ipc://")).exists()
        if case.heard.hindrance:
            raise Wrong(case.heard.hindrance)
        if case.is_virtual:
            start = "flora-twin demo starts a virtual rig"
        else:
            start = "sudo systemctl start flora-rig.target, then look again"
        raise Wrong(f"nobody answers at {where}: {start}")
    unwell = [
        f"{line.service} {line.state}{f' ({line.reason})' if line.reason else ''}"
        for line in case.heard.lines
        if not line.ok
    ]
    if unwell:
        raise Wrong(f"{where} answers; not well: {'; '.join(unwell)}")
    return f"{where} answers, {len(case.heard.lines)} services are ready"


def check_services(case: Case) -> str:
    """As :func:`~flora_monitor.doctor_units.check_units`, where this rig is started by systemd at all."""
    if case.is_virtual:
        raise NotUsed("the virtual rig is started by flora-twin")
    return check_units(case.world, case.units, case.services)


CHECKS: Final[tuple[tuple[str, Callable[[Case], str]], ...]] = (
    ("config", check_config),
    ("programs", check_programs),
    ("run folder", check_run),
    ("bus", check_bus),
    ("camera", check_camera),
    ("strips", check_strips),
    ("flash", check_flash),
    ("controller", check_controller),
    ("keys", check_keys),
    ("clock", check_clock),
    ("disk", check_disk),
    ("NAS", check_nas),
    ("memory", check_memory),
    ("power", check_power),
    ("units", check_services),
    ("journal", check_journal),
)
"""In the order in which a person mends: what later checks rest on comes first."""


def take_case(
    world: World, rig: RigSection, config: Path | None, services: tuple[str, ...], heard: Heard, *, touch: bool
) -> Case:
    """Ask the services for their configuration, and systemd for their units."""
    return Case(
        world=world,
        rig=rig,
        config=config,
        services=services,
        printed=print_configs(world, config, (*services_of_catalogue(), ONLY_LOOKS)),
        units=read_units(world, services),
        heard=heard,
        touch=touch,
    )


def examine(case: Case) -> Iterator[Finding]:
    """One finding after the other, as soon as it is known."""
    for part, check in CHECKS:
        yield _finding(part, check, case)


def _finding(part: str, check: Callable[[Case], str], case: Case) -> Finding:
    try:
        return Finding(part, "good", check(case))
    except Remark as remark:
        return Finding(part, remark.verdict, str(remark))
    except OSError as problem:
        # A file of the machine that the caller may not see, or that went away meanwhile.
        advice = "; run this command with sudo" if isinstance(problem, PermissionError) else ""
        return Finding(part, "not looked at", f"{problem.filename}: {problem.strerror}{advice}")


def sentence(finding: Finding) -> str:
    """The text, after the verdict where the mark alone would not say enough."""
    return finding.text if finding.verdict in ("good", "wrong") else f"{finding.verdict}: {finding.text}"


def json_of(finding: Finding) -> str:
    """For programs: one object."""
    return msgspec.json.encode(replace(finding, text=shown(finding.text))).decode()


def summary(findings: list[Finding]) -> str:
    """How many of each verdict, in one line."""
    wrong = [finding.part for finding in findings if finding.verdict == "wrong"]
    unseen = [finding.part for finding in findings if finding.verdict == "not looked at"]
    told = f"{len(wrong)} of {len(findings)} wrong: {', '.join(wrong)}" if wrong else "nothing is wrong"
    return told + (f"; not looked at: {', '.join(unseen)}" if unseen else "")
