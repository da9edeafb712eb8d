"""Whose a run folder at the target is, so that two rigs whose runs have one name do not put each other's files aside.

A run folder of the spool has a mark of its own, ``.flora-owner``, made once with a number that no other has. It stays
with the folder through restarts, a lost ledger and a move to another machine. The same bytes at the target say whose
files are there; they are written before the first of them, where nobody's mark is there yet. Whoever finds another
mark sends nothing: its files stay in the spool, and nothing of the other's is touched.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common.errors import StoreError
from flora_common.files import write_bytes
from flora_common.messages.envelope import as_sentence
from flora_uploader.target import Target
from flora_uploader.transfer import take_away, temporary_path

MARK: Final = ".flora-owner"
LONGEST: Final = 4096
"""Bytes that are read of a mark; one has about a hundred."""

Name = Annotated[str, msgspec.Meta(max_length=256)]


class Mark(msgspec.Struct, frozen=True):
    """What a mark says.

    Attributes:
        run: a number that only this run folder has.
        rig, machine: where it was made, for people.
    """

    run: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    rig: Name = ""
    machine: Name = ""


class Owners:
    """Compares the marks of spool and target.

    Args:
        target: where files go.
        temporary_id: distinguishes the temporary names of this uploader from those of others.
        rig, machine: what a new mark says of its origin.
    """

    def __init__(self, target: Target, temporary_id: str, *, rig: str, machine: str) -> None:
        self._target = target
        self._temporary_id = temporary_id
        self._rig = rig
        self._machine = machine[:256]

    def other(self, run: str, folder: Path) -> str:
        """Why nothing of a run may be sent: the target, which is connected, has another run of that name.

        Where the target has nobody's mark, or one that is damaged, this run's is written. A run folder of the spool
        that cannot be written to has no mark, and is sent where there is none at the target either.

        Args:
            run: name of the run folder.
            folder: in the spool.

        Returns:
            One sentence; empty where the run may be sent.

        Raises:
            StoreError: the target's problems, or the mark in the spool cannot be read.
        """
        ours, path = self._of_spool(folder), f"{run}/{MARK}"
        there = self._at_target(path)
        mark = _read(there)
        if ours is not None and mark is None:
            self._write(path, ours)
            there = self._at_target(path)  # another rig may have written its own at the same moment
            mark = _read(there)
        if mark is None or there == ours:
            return ""
        whose = " on ".join(filter(None, (mark.rig, mark.machine)))
        return as_sentence(
            f"{self._target.name}/{run} is another run of that name (of {whose or 'another rig'}); nothing of {folder} "
            f"is sent: give one of both rigs a target of its own, or delete {path} there if all of it is this run's"
        )

    def _of_spool(self, folder: Path) -> bytes | None:
        path = folder / MARK
        try:
            with path.open("rb") as file:
                data = file.read(LONGEST)
        except FileNotFoundError:
            data = b""
        except OSError as problem:  # not to be made anew: the target has it already
            raise StoreError(
                f"{path}: cannot be read ({problem.strerror}); check its disk and permissions"
            ) from problem
        if _read(data) is not None:
            return data
        data = msgspec.json.encode(Mark(os.urandom(16).hex(), self._rig, self._machine)) + b"\n"
        try:
            write_bytes(path, data)
        except (OSError, StoreError):
            return None
        return data

    def _at_target(self, path: str) -> bytes:
        if self._target.size(path) is None:
            return b""
        buffer = bytearray(LONGEST)
        reader = self._target.open(path)
        try:
            count = reader.readinto(memoryview(buffer))
        finally:
            reader.close()
        return bytes(buffer[:count])

    def _write(self, path: str, data: bytes) -> None:
        target, temporary = self._target, temporary_path(path, self._temporary_id)
        target.make_folder(str(Path(path).parent))
        try:
            writer = target.create(temporary)
            try:
                writer.write(memoryview(data))
                writer.sync()
            finally:
                writer.close()
            target.rename(temporary, path)
        except StoreError as problem:
            take_away(target, temporary, problem)
            raise


def _read(data: bytes) -> Mark | None:
    try:
        return msgspec.json.decode(data, type=Mark)
    except (ValueError, RecursionError):
        return None
