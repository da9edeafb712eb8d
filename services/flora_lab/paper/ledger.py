"""``steps.toml``: which steps of :mod:`flora_lab.paper.steps` were done or begun, and by which key."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common import files
from flora_common.errors import BadInput
from flora_common.outputs import is_there
from flora_common.toml_strict import to_toml
from flora_lab.made_folders import read_info

FORMAT: Final = "flora-paper-1"
STEPS_FILE: Final = "steps.toml"


class StepEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[step]]`` of ``steps.toml``.

    Attributes:
        name: of the step.
        key: of what was done, or begun.
        is_finished: whether it was done.
        took_s: seconds of work so far.
    """

    name: str
    key: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]
    is_finished: bool
    took_s: Annotated[float, msgspec.Meta(ge=0.0)]


class StepsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``steps.toml``."""

    format: str
    step: list[StepEntry] = []


class Ledger:
    """``steps.toml``, written after every change."""

    def __init__(self, folder: Path, entries: Mapping[str, StepEntry]) -> None:
        self._path = folder / STEPS_FILE
        self._entries = dict(entries)

    @property
    def names(self) -> list[str]:
        return list(self._entries)

    def get(self, name: str) -> StepEntry | None:
        """What is known of a step."""
        return self._entries.get(name)

    def put(self, entry: StepEntry) -> None:
        """Note a step.

        Raises:
            DiskFull: no room; what was noted before stands.
        """
        self._entries[entry.name] = entry
        self.write()

    def clear(self) -> None:
        """Forget all steps."""
        self._entries = {}
        self.write()

    def write(self) -> None:
        """Write the file.

        Raises:
            DiskFull: no room; what was noted before stands.
        """
        files.write_text(self._path, to_toml(StepsFile(FORMAT, list(self._entries.values()))))


def read_ledger(folder: Path) -> Ledger:
    """The steps of a folder; none where it is new.

    Raises:
        BadInput: ``steps.toml`` is none.
    """
    path = folder / STEPS_FILE
    if not path.exists():
        return Ledger(folder, {})
    found = read_info(path, StepsFile, FORMAT)
    return Ledger(folder, {entry.name: entry for entry in found.step})


def check_folder(path: Path) -> None:
    """Whether steps may be done there; changes nothing.

    Raises:
        BadInput: something else is there.
    """
    if not is_there(path):
        return
    if not path.is_dir():
        raise BadInput(f"{path}: is no folder; name a new one with -o")
    if any(not entry.name.startswith(".") for entry in path.iterdir()) and not (path / STEPS_FILE).is_file():
        raise BadInput(f"{path}: holds other files, and no {STEPS_FILE}; name a new folder with -o")
    read_ledger(path)
