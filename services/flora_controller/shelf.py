"""Controllers that were offered and accepted, on the disk: which one steers, and which ones stand behind it.

``controllers/`` in the state folder holds each file under its SHA-256, its signature inside it, and ``current.json``,
the one small record that says which of them counts. A file is on the disk before the record names it, and goes only
when no record names it any more; the record changes by one rename. A process killed at any point, or a power cut,
therefore leaves the old state or the new one, and every file that either names is whole.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common.controller_file import SUFFIX, LoadedController, parse_controller
from flora_common.errors import BadController
from flora_common.files import TEMPORARY_SUFFIX, sha256_of_bytes, write_bytes
from flora_common.messages.envelope import Sentence, Sha256, as_sentence

FOLDER: Final = "controllers"
RECORD: Final = "current.json"
VERSION: Final = 1
MOST_KEPT: Final = 3
"""The one that steers and the two before it."""
MOST_REMEMBERED: Final = 32
"""Controllers that were given up, and must not come back by themselves."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An accepted controller.

    Attributes:
        sha256: of its file, and its name on the shelf.
        offer: under which it came; answers about it bear this.
        name: for people.
        shadow_ticks: how many it has to answer in shadow before it steers.
    """

    sha256: Sha256
    offer: str
    name: str
    shadow_ticks: int = 0


class GivenUp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A controller that was returned from, under which offer it had come (empty where that is not known), and why."""

    sha256: Sha256
    offer: str
    reason: Sentence


class ShelfRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the shelf's files are there for.

    Attributes:
        base: name and hash of the configured controller when this was written; where the operator has named another
            one since, that one steers.
        line: the newest first: it steers, the others are what is returned to; after the last, the configured one.
        candidate: in shadow.
        given_up: the latest last.
        note: why the last one was returned from; empty from the next acceptance on.
    """

    base: str
    version: int = VERSION
    line: Annotated[tuple[Entry, ...], msgspec.Meta(max_length=MOST_KEPT)] = ()
    candidate: Entry | None = None
    given_up: Annotated[tuple[GivenUp, ...], msgspec.Meta(max_length=MOST_REMEMBERED)] = ()
    note: str = ""

    @property
    def named(self) -> set[str]:
        """Hashes of the files that must stay."""
        return {entry.sha256 for entry in (*self.line, *([self.candidate] if self.candidate else []))}

    def given_up_of(self, sha256: str) -> GivenUp | None:
        """How that controller was given up; None where it never was."""
        return next((entry for entry in self.given_up if entry.sha256 == sha256), None)

    def with_candidate(self, entry: Entry | None) -> ShelfRecord:
        """Another one in shadow, or none."""
        return msgspec.structs.replace(self, candidate=entry, note="" if entry else self.note)

    def with_first(self, entry: Entry) -> ShelfRecord:
        """This one steers; the one that did so far stands behind it."""
        behind = [other for other in self.line if other.sha256 != entry.sha256]
        return msgspec.structs.replace(self, line=(entry, *behind)[:MOST_KEPT], candidate=None, note="")

    def without(self, entry: Entry, reason: str, *, note: str) -> ShelfRecord:
        """This one was given up, wherever it stood."""
        return msgspec.structs.replace(
            self.only(self.named - {entry.sha256}),
            given_up=self._given_up_with(GivenUp(entry.sha256, entry.offer, as_sentence(reason))),
            note=as_sentence(note),
        )

    def _given_up_with(self, *given_up: GivenUp) -> tuple[GivenUp, ...]:
        new = {one.sha256 for one in given_up}
        return (*(other for other in self.given_up if other.sha256 not in new), *given_up)[-MOST_REMEMBERED:]

    def only(self, usable: set[str]) -> ShelfRecord:
        """With nothing but these, in their order."""
        candidate = self.candidate if self.candidate is not None and self.candidate.sha256 in usable else None
        line = tuple(entry for entry in self.line if entry.sha256 in usable)
        return msgspec.structs.replace(self, line=line, candidate=candidate)

    def on_base(self, base: str, accepted: Iterable[str], reason: str) -> ShelfRecord:
        """The operator's controller steers; what was offered before it must not come back by being offered again.

        Args:
            base: name and hash of the operator's controller.
            accepted: hashes of all other files that could be accepted once more; one of them that the operator's
                controller is, or was until now, may still be offered.
            reason: why, in a clause.
        """
        ended = [*self.line, *([self.candidate] if self.candidate else [])]
        here = {entry.sha256 for entry in ended} | {one.sha256 for one in self.given_up}
        by_hand = tuple(name.rpartition(" ")[2] for name in (self.base, base))
        given_up = [
            GivenUp(sha256, "", as_sentence(reason)) for sha256 in accepted if sha256 not in here.union(by_hand)
        ]
        given_up += [GivenUp(entry.sha256, entry.offer, as_sentence(reason)) for entry in reversed(ended)]
        return ShelfRecord(base=base, given_up=self._given_up_with(*given_up))


class Shelf:
    """The folder. One process writes it; anybody may read it meanwhile.

    Args:
        folder: made when something is put there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read(self, *, base: str) -> tuple[ShelfRecord, str]:
        """The record, or an empty one, and why a stored one could not be used (empty where it could)."""
        path = self._folder / RECORD
        try:
            record = msgspec.json.decode(path.read_bytes(), type=ShelfRecord)
        except FileNotFoundError:
            return ShelfRecord(base=base), ""
        except (OSError, ValueError, RecursionError) as problem:
            return ShelfRecord(base=base), f"{path} cannot be used ({problem}); the configured controller steers"
        if record.version != VERSION:
            return ShelfRecord(base=base), f"{path} is of version {record.version}; the configured controller steers"
        return record, ""

    def put(self, loaded: LoadedController) -> None:
        """Lay a file on the shelf; nothing refers to it before :meth:`write`.

        Raises:
            StoreError: no room on the disk.
            OSError: it cannot be written.
        """
        write_bytes(self._path(loaded.sha256), loaded.data)

    def write(self, record: ShelfRecord) -> None:
        """Make this record the valid one, then clear away what it does not name.

        Raises:
            StoreError: no room on the disk; the old record stands.
            OSError: it cannot be written; the old record stands.
        """
        write_bytes(self._folder / RECORD, msgspec.json.encode(record))
        named = {self._path(sha256).name for sha256 in record.named}
        for path in self._folder.iterdir():
            if path.name not in named and path.name.endswith((SUFFIX, TEMPORARY_SUFFIX)):
                # What cannot be removed only takes room; the next writing tries again.
                with contextlib.suppress(OSError):
                    path.unlink()

    def load(self, sha256: str) -> LoadedController:
        """A file that the record names, checked as if it were new.

        Raises:
            BadController: it is gone, or is not what it was.
        """
        path = self._path(sha256)
        try:
            data = path.read_bytes()
        except OSError as problem:
            raise BadController(f"{path}: cannot be read ({problem.strerror})") from problem
        if sha256_of_bytes(data) != sha256:
            raise BadController(f"{path}: damaged since it was accepted (its SHA-256 is another)")
        return parse_controller(data, where=str(path))

    def _path(self, sha256: str) -> Path:
        return self._folder / f"{sha256}{SUFFIX}"
