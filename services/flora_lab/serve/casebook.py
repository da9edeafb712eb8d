"""The diagnoses of ended runs: which is due, and what becomes of it. Pure but for the folder of all of them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput
from flora_common.messages import DiagnosisFound
from flora_common.messages.catalogue import MOST_CAUSES, Verdict
from flora_common.messages.envelope import as_sentence
from flora_lab.serve import found, ledger
from flora_lab.serve.child import Ended
from flora_lab.serve.ledger import Entry, Ledger

DIAGNOSIS_FILE: Final = "diagnosis.json"
AGAIN_S: Final = 600.0
"""Real seconds after which a diagnosis that ended without a word of its own is tried again."""


class Casebook:
    """All runs that have ended.

    Args:
        output: folder of the diagnoses.
        utc: the time now, as text.

    Raises:
        StoreError: the ledger that is there is none.
    """

    def __init__(self, output: Path, utc: Callable[[], str]) -> None:
        self.output = output
        self.ledger = Ledger(output)
        self._utc = utc
        self._not_before_s: dict[str, float] = {}
        if not self.ledger.path.exists():
            self._keep()

    def add(self, entries: Iterable[Entry]) -> int:
        """Runs that have ended; returns how many of them are new.

        Raises:
            DiskFull: no room to remember them; they are met again.
        """
        met = [self.ledger.add(entry) for entry in entries]
        if met:
            self.ledger.save()
        return sum(met)

    def next(self, simulator: Path, now_s: float) -> Entry | None:
        """The run to be diagnosed now. Runs that the simulator was learned from, and such as are done, are told apart.

        Raises:
            DiskFull: no room.
        """
        for entry in self.ledger.waiting():
            if now_s < self._not_before_s.get(entry.name, 0.0):
                continue
            entry.simulator = str(simulator)
            if (self.folder_of(entry) / DIAGNOSIS_FILE).is_file():
                self._done(entry)
            elif entry.attempts >= ledger.MOST_ATTEMPTS:
                self._failed(entry, entry.reason or "the service was killed while it was diagnosed", is_final=True)
            elif entry.track_sha256 in learned_from(simulator):
                entry.stage, entry.reason, entry.when = "left out", f"{simulator.name} was learned from it", self._utc()
                self._keep()
            else:
                return entry
        return None

    def folder_of(self, entry: Entry) -> Path:
        """Where its diagnosis goes."""
        return self.output / entry.name

    def arguments(self, entry: Entry, simulator: Path) -> list[str]:
        """Of ``flora-lab``."""
        return ["diagnose", entry.run_dir, "--simulator", str(simulator), "-o", str(self.folder_of(entry)), "--quiet"]

    def begins(self, entry: Entry) -> None:
        """Counted before it is begun: what kills the whole machine is not tried for ever.

        Raises:
            DiskFull: no room; it must not begin.
        """
        entry.attempts += 1
        try:
            self.ledger.save()
        except BaseException:
            entry.attempts -= 1
            raise

    def given_up(self, entry: Entry) -> None:
        """It was ended because the service ends: that is no failure of its own.

        Raises:
            DiskFull: no room.
        """
        entry.attempts -= 1
        self.ledger.save()

    def ended(self, entry: Entry, ended: Ended, now_s: float) -> None:
        """It ended.

        Raises:
            DiskFull: no room; what is in its folder is found at the next start.
        """
        if ended.status == 0:
            self._done(entry)
            return
        self._not_before_s[entry.name] = now_s + AGAIN_S
        self._failed(entry, ended.reason, is_final=ended.is_final)

    def unsaid(self) -> list[tuple[Entry, DiagnosisFound]]:
        """What the bus is to be told."""
        return [(entry, message_of(entry)) for entry in self.ledger.unsaid()]

    def said(self, entry: Entry) -> None:
        """It was told.

        Raises:
            DiskFull: no room; it may be said again after a restart.
        """
        entry.is_said = True
        self.ledger.save()

    def trouble(self) -> str:
        """Which diagnoses failed, since one was done; empty for none."""
        failed = self.ledger.failed_since()
        if not failed:
            return ""
        last = failed[-1]
        more = f" (and {len(failed) - 1} more, see {found.PAGE_FILE})" if len(failed) > 1 else ""
        return f"{last.rig}/{last.run} could not be diagnosed: {last.reason}{more}"

    def _done(self, entry: Entry) -> None:
        folder = self.folder_of(entry)
        entry.when = self._utc()
        try:
            ledger.done(entry, (folder / DIAGNOSIS_FILE).read_bytes(), folder)
        except (BadInput, FileNotFoundError) as problem:
            self._failed(entry, str(problem), is_final=True)
            return
        self._keep()

    def _failed(self, entry: Entry, reason: str, *, is_final: bool) -> None:
        entry.when = self._utc()
        ledger.failed(entry, reason, is_final=is_final)
        self._keep()

    def _keep(self) -> None:
        self.ledger.save()
        found.write(self.output, self.ledger)


def message_of(entry: Entry) -> DiagnosisFound:
    """For the bus."""
    verdicts: dict[str, Verdict] = {v: v for v in ("nothing_wrong", "explained", "unexplained")}
    causes = entry.causes[:MOST_CAUSES]
    return DiagnosisFound(
        run=entry.run,
        verdict=verdicts.get(entry.verdict, "failed") if entry.stage == "done" else "failed",
        plant=entry.plant[:200],
        causes=tuple(cause["effect"] for cause in causes),
        confidence=tuple(min(max(float(cause["confidence"]), 0.0), 1.0) for cause in causes),
        path=entry.folder[:500],
        track_sha256=entry.track_sha256,
        sentence=as_sentence(entry.summary or entry.reason),
    )


def learned_from(simulator: Path) -> frozenset[str]:
    """Hashes of the tracks that a simulator was learned from; none where it does not say."""
    try:
        told = tomllib.loads((simulator / "simulator.toml").read_text(encoding="utf-8"))
        return frozenset(track["sha256"] for track in told["provenance"]["track"])
    except (OSError, ValueError, KeyError, TypeError):
        return frozenset()  # what is wrong with it the diagnosis says
