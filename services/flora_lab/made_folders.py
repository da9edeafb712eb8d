"""Folders that the lab makes: an information file in TOML, and a data file that it names by its hash."""

from __future__ import annotations

from pathlib import Path

from flora_common import files
from flora_common.errors import BadInput
from flora_common.toml_strict import T, convert, read_toml


def read_info(path: Path, into: type[T], wanted: int | str) -> T:
    """The information file of such a folder.

    Args:
        path: of the file.
        into: what it must hold.
        wanted: its ``format``; told first, for a file of another one holds other things.

    Raises:
        BadInput: it cannot be read, is of another format, or holds something else.
    """
    table = read_toml(path, BadInput)
    found = table.get("format")
    if found != wanted:
        raise BadInput(f"{path}: format {str(found)[:30]} is not known; this program reads {wanted}")
    return convert(table, into, where=str(path), error=BadInput)


def read_named(path: Path, sha256: str, info_name: str) -> bytes:
    """The data file that an information file names.

    Raises:
        BadInput: it cannot be read, or is another than the one that is named.
    """
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    found = files.sha256_of_bytes(data)
    if found != sha256:
        raise BadInput(f"{path}: is damaged or belongs to another {info_name}: its SHA-256 is {found[:12]}…")
    return data
