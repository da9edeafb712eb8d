"""Which runs were diagnosed, with what result: written whole at each change, so that nothing is done twice or lost."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from flora_common import files
from flora_common.errors import BadInput, StoreError
from flora_common.messages.envelope import as_sentence

LEDGER_FILE: Final = "ledger.json"
MOST_ATTEMPTS: Final = 3
"""A diagnosis that ended without a word of its own, or was killed, is tried so often; one that says why not, once."""

Stage = Literal["waiting", "done", "failed", "left out"]


class Entry(msgspec.Struct):
    """One run, as its track was.

    Attributes:
        rig, run, plant: names.
        run_dir: the run folder.
        track_sha256, track_bytes, track_mtime_ns: of its ``track.csv``.
        stage: ``left out`` is for runs that the simulator was learned from.
        attempts: that were begun.
        reason: why it failed or was left out.
        folder: of the diagnosis.
        verdict, summary: as in ``diagnosis.json``.
        causes: likewise, without what is not for a list.
        when: UTC, of the end.
        is_said: whether the bus was told.
    """

    rig: str
    run: str
    plant: str
    run_dir: str
    track_sha256: str
    track_bytes: int
    track_mtime_ns: int
    stage: Stage = "waiting"
    attempts: int = 0
    reason: str = ""
    folder: str = ""
    verdict: str = ""
    summary: str = ""
    causes: list[dict[str, Any]] = []
    simulator: str = ""
    when: str = ""
    is_said: bool = False

    @property
    def name(self) -> str:
        """Of its diagnosis: the same run with another track is another one."""
        return f"{self.rig}-{self.run}-{self.track_sha256[:8]}"


class _File(msgspec.Struct):
    entries: list[Entry]
    format: int = 1


class Ledger:
    """All entries, oldest first.

    Args:
        folder: of all diagnoses.

    Raises:
        StoreError: what is there is not a ledger.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LEDGER_FILE
        self.entries: list[Entry] = []
        if self.path.exists():
            try:
                self.entries = msgspec.json.decode(self.path.read_bytes(), type=_File).entries
            except (ValueError, RecursionError) as problem:
                raise StoreError(f"{self.path}: not a ledger of flora-lab ({problem}); move it away") from problem

    def save(self) -> None:
        """Write it whole.

        Raises:
            DiskFull: no room; the old one stands.
        """
        files.write_bytes(self.path, msgspec.json.format(msgspec.json.encode(_File(self.entries)), indent=1) + b"\n")

    def knows(self, rig: str, run: str, size: int, mtime_ns: int) -> bool:
        """Whether this very track was met before, by its size and time alone: nothing is read for it."""
        return any((e.rig, e.run, e.track_bytes, e.track_mtime_ns) == (rig, run, size, mtime_ns) for e in self.entries)

    def add(self, entry: Entry) -> bool:
        """Add a run; False where its track was met before, under another time of the file."""
        for known in self.entries:
            if (known.rig, known.run, known.track_sha256) == (entry.rig, entry.run, entry.track_sha256):
                known.track_bytes, known.track_mtime_ns = entry.track_bytes, entry.track_mtime_ns
                return False
        self.entries.append(entry)
        return True

    def waiting(self) -> list[Entry]:
        """Runs to be diagnosed."""
        return [entry for entry in self.entries if entry.stage == "waiting"]

    def unsaid(self) -> list[Entry]:
        """What the bus has not been told."""
        return [entry for entry in self.entries if entry.stage in ("done", "failed") and not entry.is_said]

    def failed_since(self) -> list[Entry]:
        """Diagnoses that failed, and after which none of the same rig was done."""
        last: dict[str, list[Entry]] = {}
        for entry in sorted(self.entries, key=lambda e: e.when):
            if entry.stage == "done":
                last[entry.rig] = []
            elif entry.stage == "failed":
                last.setdefault(entry.rig, []).append(entry)
        return [entry for failed in last.values() for entry in failed]


def failed(entry: Entry, reason: str, *, is_final: bool) -> None:
    """An attempt ended without a result; after the last one it has failed."""
    entry.reason = as_sentence(" ".join(reason.split()))
    if is_final or entry.attempts >= MOST_ATTEMPTS:
        entry.stage = "failed"


def done(entry: Entry, diagnosis: bytes, folder: Path) -> None:
    """A diagnosis is there.

    Args:
        entry: its run.
        diagnosis: ``diagnosis.json``.
        folder: of it.

    Raises:
        BadInput: it is none.
    """
    try:
        found = msgspec.json.decode(diagnosis, type=_Diagnosis)
    except (ValueError, RecursionError) as problem:
        raise BadInput(f"{folder}: its diagnosis.json is none ({problem})") from problem
    entry.stage, entry.reason, entry.folder = "done", "", str(folder)
    entry.verdict, entry.summary = found.verdict, found.summary
    entry.causes = [
        {"effect": c.effect, "confidence": c.confidence, "parameters": c.parameters, "interval": c.interval}
        for c in found.causes
    ]


class _Cause(msgspec.Struct):
    effect: str
    confidence: float
    parameters: dict[str, float]
    interval: dict[str, tuple[float, float]]


class _Diagnosis(msgspec.Struct):
    """What is read of ``diagnosis.json``."""

    verdict: Literal["nothing_wrong", "explained", "unexplained"]
    summary: str
    causes: list[_Cause]


def of_plants(entries: Iterable[Entry]) -> dict[str, list[Entry]]:
    """Entries that say something, by plant, the newest first; the plants that were heard of last first."""
    told = sorted((e for e in entries if e.stage in ("done", "failed")), key=lambda e: e.when, reverse=True)
    by_plant: dict[str, list[Entry]] = {}
    for entry in told:
        by_plant.setdefault(entry.plant or entry.run, []).append(entry)
    return by_plant
