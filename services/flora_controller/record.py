"""What the controller must still know after it was killed: one small file, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import msgspec

from flora_common.files import write_bytes
from flora_common.messages import ControllerState, LightCommand
from flora_common.runs import Light
from flora_controller.shadow import Shadow, Watch

RECORD_FILE: Final = "controller.json"
VERSION: Final = 1


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """State of a run under a controller.

    Attributes:
        run: which run it belongs to; another run starts anew.
        controller: which rule decided last; another one starts without this one's memory, counts and best fitness.
        version: of this file's format.
        tick: the last tick that was answered.
        light: what was commanded last.
        memory: of the rule.
        watch: what it decided lately.
        shadow: how far the trial of another one has come; None while there is none.
        blind_ticks: how many ticks in a row, up to the last one, gave no stem or no decision.
        decisions, switches: how many the rule has made, and how many of its commands changed the lamp.
        best_fitness: the paper's F of the tip at its best, 1 at most; None before the first stem, or without a target.
        target_reached: whether the tip was ever in the target's circle.
        collided_at_s: when the stem first touched the obstacle, seconds since the run's start; None where it did not.
        clearance_cm: the least distance of stem and obstacle; None before the first stem, or without an obstacle.
        run_over: why the run is over; empty while it goes on.
        command, said: the answer to ``tick``, to be given again if it is asked again.
    """

    run: str
    controller: str = ""
    version: int = VERSION
    tick: int = 0
    light: Light | None = None
    memory: dict[str, float] = msgspec.field(default_factory=dict)
    watch: Watch = Watch()
    shadow: Shadow | None = None
    blind_ticks: int = 0
    decisions: int = 0
    switches: int = 0
    best_fitness: float | None = None
    target_reached: bool = False
    collided_at_s: float | None = None
    clearance_cm: float | None = None
    run_over: str = ""
    command: LightCommand | None = None
    said: ControllerState | None = None


def read_record(path: Path, *, run: str) -> tuple[Record, str]:
    """The stored record, or a new one, and why a stored one was dropped (empty where it was not)."""
    fresh = Record(run=run)
    try:
        record = msgspec.json.decode(path.read_bytes(), type=Record)
    except FileNotFoundError:
        return fresh, ""
    except (OSError, ValueError, RecursionError) as problem:
        return fresh, f"{path} cannot be used ({problem}); starting anew"
    if record.version != VERSION:
        return fresh, f"{path} is of version {record.version}; starting anew"
    if record.run != run:
        return fresh, "another run; starting anew"
    return record, ""


def write_record(path: Path, record: Record) -> None:
    """Write the record, flushed to the disk.

    Raises:
        StoreError: no room on the disk.
        OSError: it cannot be written.
    """
    write_bytes(path, msgspec.json.encode(record))
