"""Folders that the lab makes: an information file in TOML, and a data file that it names by its hash."""

from __future__ import annotations

from pathlib import Path

from flora_common import files
from flora_common.errors import BadInput
from flora_common.toml_strict import T, convert, read_toml


def must_be_new(path: Path) -> None:
    """Whether a folder may be made there; BadInput where something is."""
    if path.exists() or path.is_symlink():
        raise BadInput(f"{path}: is there already; name another folder with -o")


def check_output(
    path: Path, *, force: bool, needed: frozenset[str], allowed: frozenset[str] = frozenset(), what: str
) -> None:
    """Whether such a folder may be written there.

    Args:
        path: where.
        force: whether one of the kind that is there is to be replaced.
        needed, allowed: names of the files that such a folder must have, and may have besides.
        what: names the kind in messages.

    Raises:
        BadInput: something is there, and it is not to be, or must not be, replaced.
    """
    if not path.exists() and not path.is_symlink():
        return
    if not force:
        raise BadInput(f"{path}: is there already; name another folder with -o, or add --force")
    names = {entry.name for entry in path.iterdir()} if path.is_dir() and not path.is_symlink() else set()
    if not needed <= names <= needed | allowed:
        raise BadInput(f"{path}: is not {what} and is not replaced; name another folder with -o")


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
