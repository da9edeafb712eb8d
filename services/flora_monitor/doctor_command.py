"""The command line of :mod:`flora_monitor.doctor`: hear the bus, look at this machine, print as it is found."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flora_common.bus import LATE_FACTOR
from flora_common.clock import SystemClock
from flora_common.health import HealthBoard
from flora_monitor.listen import PROGRAM, Listener, hear_health
from flora_monitor.options import Common, Config, Json, common_options
from flora_monitor.show import printable

if TYPE_CHECKING:
    from flora_monitor.doctor import Finding
    from flora_monitor.doctor_case import Heard

COLUMNS = (1, 10)
STYLES = {"good": "green", "wrong": "bold red", "not used here": "dim", "not looked at": "yellow"}

Touch = Annotated[
    bool,
    typer.Option("--touch", help="Switch the lamps off for real; write one file to the NAS, read it back, remove it."),
]


def doctor(config: Config = None, as_json: Json = False, touch: Touch = False) -> None:
    """A tick or a sentence for each part of the rig; status 1 when something is wrong."""
    from flora_monitor import doctor as parts  # noqa: PLC0415 - the other commands need nothing of it
    from flora_monitor.doctor_world import this_machine  # noqa: PLC0415

    common = common_options(config, None, None, None, as_json=as_json)
    heard = _heard(common)
    case = parts.take_case(this_machine(), common.rig, config, common.section.services, heard, touch=touch)
    console = Console(highlight=False)
    findings: list[Finding] = []
    for finding in parts.examine(case):
        findings.append(finding)
        if common.as_json:
            print(parts.json_of(finding), flush=True)
        else:
            console.print(_row(parts.MARKS[finding.verdict], finding, parts.sentence(finding)))
    print(f"{PROGRAM}: {parts.summary(findings)}", file=sys.stderr, flush=True)
    if any(finding.verdict == "wrong" for finding in findings):
        raise typer.Exit(1)


def _row(mark: str, finding: Finding, sentence: str) -> Table:
    """A long sentence goes on under its own beginning."""
    row = Table.grid(padding=(0, 1))
    for width in COLUMNS:
        row.add_column(width=width, no_wrap=True)
    row.add_column(overflow="fold")
    style = STYLES[finding.verdict]
    row.add_row(Text(mark, style), Text(finding.part, style), Text(printable(sentence)))
    return row


def _heard(common: Common) -> Heard:
    from flora_monitor.doctor_case import Heard  # noqa: PLC0415

    rig = common.rig
    listener = Listener(rig, only_rig=rig.name, pattern="health", without_bus=None)
    board = HealthBoard(common.section.services, period_s=rig.health_every_s, ages_are_known=common.rig.has_own_clock)
    try:
        is_there = hear_health(
            listener,
            board,
            pattern="*",
            limit_s=LATE_FACTOR * rig.health_every_s,
            ends_early=True,
        )
        hindrance = "" if is_there else listener.client.hindrance
    finally:
        listener.close()
    lines = board.lines(real_s=time.monotonic(), mono_ns=SystemClock().mono_ns()) if is_there else []
    return Heard(is_there, tuple(lines), hindrance)
