"""What an experiment came to: told in ten lines, as a page, and as a file for programs."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from flora_common.counted import counted
from flora_common.installed import command
from flora_twin.rig.integrity import Integrity
from flora_twin.rig.layout import Layout
from flora_twin.rig.supervisor import ServiceFailed
from flora_twin.rig.truth import TruthCheck
from flora_twin.rig.virtual_rig import Seen


@dataclass(frozen=True, slots=True)
class Outcome:
    """What happened, beside the report's figures.

    Attributes:
        seen: what the bus said.
        restarts: how often each process was started again.
        integrity: whether every announced photograph is there, whole and stored.
        truth: the measured stems beside the true ones; None where no stem was measured.
        hours: how long the plant grew.
        took_s: real seconds.
    """

    seen: Seen
    restarts: dict[str, int]
    integrity: Integrity
    truth: TruthCheck | None
    hours: float
    took_s: float


def write_report(
    layout: Layout, out: Path, outcome: Outcome, *, controller: str, stop_height_cm: float, hours: float
) -> dict[str, Any]:
    """Write ``report.html`` and ``strip.png``; returns the report's figures.

    Raises:
        ServiceFailed: the report could not be made.
    """
    notes = {"controller": controller, **_notes(outcome)}
    done = subprocess.run(
        [
            *(command("flora-lab"), "report", str(layout.run.path), "--json"),
            *("-o", str(out / "report.html"), "--strip", str(out / "strip.png"), "--force"),
            *("--title", "A virtual bean, steered round an obstacle", "--stop-height", f"{stop_height_cm:g}"),
            *("--hours", f"{hours:g}"),
            *(part for name, value in notes.items() for part in ("--note", f"{name}={value}")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise ServiceFailed(f"the report could not be made: {done.stderr.strip()}")
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


def _notes(outcome: Outcome) -> dict[str, str]:
    integrity, truth = outcome.integrity, outcome.truth
    notes = {
        "photographs announced": f"{integrity.announced}, of these missing {integrity.missing}, torn {integrity.torn}, "
        f"not verified at the NAS {integrity.not_stored}",
        "wall time": f"{outcome.took_s:.0f} s for {outcome.hours:g} hours",
    }
    if truth is not None:
        median, most = truth.tip_median_cm, truth.tip_p95_cm
        notes["measured tip off the true one"] = f"{median:.2f} cm (median), {most:.2f} cm (95 %)"
        median, most = truth.stem_median_cm, truth.stem_p95_cm
        notes["measured points off the true stem"] = f"{median:.2f} cm (median), {most:.2f} cm (95 %)"
    if truth is not None and truth.clearance_cm is not None:
        notes["true least distance to the obstacle"] = f"{truth.clearance_cm:.1f} cm"
    return notes


def tell(console: Console, out: Path, figures: dict[str, Any], outcome: Outcome) -> None:
    """The result in a few lines."""
    touched, reached = figures["collided_h"], figures["target_reached_h"]
    at_stop = f"{100 * figures['fitness_at_stop']:.1f} % at hour {figures['stop_h']:.1f}, when {figures['stop_reason']}"
    lines = []
    if reached is None:
        lines.append(("fitness", f"{at_stop}; target not reached"))
    else:
        at_target = f"{100 * figures['fitness_at_target']:.1f} % when the target was reached, hour {reached:.1f}"
        lines += [("fitness", at_target), ("", f"{100 * figures['best_fitness']:.1f} % at best; {at_stop}")]
    how = "not touched" if touched is None else f"touched at hour {touched:.1f}"
    lines.append(("obstacle", f"{how}, least distance {figures['clearance_cm']:.1f} cm"))
    integrity, truth = outcome.integrity, outcome.truth
    lines.append(
        (
            "pictures",
            f"{integrity.announced} announced, {integrity.missing} missing, {integrity.torn} torn, "
            f"{integrity.announced - integrity.not_stored} at the NAS; "
            f"{counted(len(outcome.seen.missed), 'tick')} without one",
        )
    )
    lines.append(("stems", ", ".join(f"{count} {name}" for name, count in sorted(outcome.seen.outcomes.items()))))
    if truth is not None:
        lines.append(("measured", f"tip {truth.tip_median_cm:.2f} cm off (median), {truth.tip_p95_cm:.2f} cm (95 %)"))
    if outcome.restarts:
        lines.append(("restarts", ", ".join(f"{name} {count}" for name, count in outcome.restarts.items())))
    lines.append(("time", f"{outcome.took_s:.0f} s for {outcome.hours:g} hours of plant"))
    lines.append(("look at", f"{out / 'report.html'}  and  {out / 'strip.png'}"))
    for name, value in lines:
        console.print(f"{name:<10} {value}")
