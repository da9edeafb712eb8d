"""What a rig accepted last from each key: the memory without which an old controller could come back as a new one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import msgspec

from flora_common.controller_file import Serial
from flora_common.errors import StoreError
from flora_common.files import write_bytes

SERIALS_FILE: Final = "serials.json"


class Accepted(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file of a key that was accepted last, which is the one with the highest serial."""

    serial: Serial
    sha256: str


class Serials(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Of all keys, by their short names."""

    keys: Mapping[str, Accepted] = {}
    version: Literal[1] = 1

    def last(self, key: str) -> Accepted | None:
        return self.keys.get(key)

    def with_(self, key: str, accepted: Accepted) -> Serials:
        return Serials({**self.keys, key: accepted})


def read_serials(path: Path) -> Serials:
    """The stored serials; none where there is no such file.

    Raises:
        StoreError: a file that cannot be read. It must not count as none: that would let old controllers in.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=Serials)
    except FileNotFoundError:
        return Serials()
    except (OSError, ValueError, RecursionError) as problem:
        raise StoreError(
            f"{path}: which controllers were accepted cannot be read ({problem}); no signed one is accepted until you "
            "delete it and restart flora-controller"
        ) from problem


def write_serials(path: Path, serials: Serials) -> None:
    """Write the serials, flushed to the disk.

    Raises:
        StoreError: no room on the disk.
        OSError: it cannot be written.
    """
    write_bytes(path, msgspec.json.encode(serials))
