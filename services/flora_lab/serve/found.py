"""The record of what was found in which plant: ``found.jsonl`` for programs, ``found.md`` for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import msgspec

from flora_common import files
from flora_lab.serve.ledger import Entry, Ledger, of_plants

LINES_FILE: Final = "found.jsonl"
PAGE_FILE: Final = "found.md"
_VERDICTS: Final = {
    "nothing_wrong": "nothing wrong",
    "explained": "explained",
    "unexplained": "something is left unexplained",
}
_FIELDS: Final = (
    "rig",
    "run",
    "plant",
    "when",
    "stage",
    "verdict",
    "causes",
    "summary",
    "reason",
    "folder",
    "simulator",
    "track_sha256",
)


def write(folder: Path, ledger: Ledger) -> None:
    """Both, whole; they follow from the ledger, and may be thrown away.

    Raises:
        DiskFull: no room.
    """
    told = [entry for entry in ledger.entries if entry.stage in ("done", "failed")]
    lines = [msgspec.json.encode(as_plain(entry)) for entry in sorted(told, key=lambda e: e.when)]
    files.write_bytes(folder / LINES_FILE, b"".join(line + b"\n" for line in lines))
    files.write_text(folder / PAGE_FILE, page(ledger))


def as_plain(entry: Entry) -> dict[str, Any]:
    """One line of ``found.jsonl``."""
    return {name: getattr(entry, name) for name in _FIELDS}


def page(ledger: Ledger) -> str:
    """``found.md``: a heading per plant."""
    lines = ["# What was found in which plant", ""]
    by_plant = of_plants(ledger.entries)
    if not by_plant:
        lines += ["No run has been diagnosed yet.", ""]
    for plant, entries in by_plant.items():
        lines += [f"## {_plain(plant)}", "", "| when | rig | run | verdict | causes | |", "|---|---|---|---|---|---|"]
        for entry in entries:
            cells = [entry.when[:16].replace("T", " "), entry.rig, entry.run, _verdict(entry), _causes(entry)]
            link = f"[report]({Path(entry.folder).name}/report.html)" if entry.stage == "done" else ""
            lines.append("| " + " | ".join([*map(_plain, cells), link]) + " |")
        lines += ["", *(f"{_plain(entry.run)}: {_plain(entry.summary or entry.reason)}\n" for entry in entries)]
    return "\n".join(lines)


def _verdict(entry: Entry) -> str:
    return _VERDICTS.get(entry.verdict, entry.verdict) if entry.stage == "done" else "not diagnosed"


def _causes(entry: Entry) -> str:
    return "; ".join(
        f"{cause['effect']} ({round(100 * cause['confidence'])} %: {_parameters(cause['parameters'])})"
        for cause in entry.causes
    )


def _parameters(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())


def _plain(text: str) -> str:
    """Text in which nothing is taken for Markdown's own signs."""
    return " ".join("".join("\\" + c if c in "|<>[]*`#\\" else c for c in text).split())
