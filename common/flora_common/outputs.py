"""Where commands write: one rule for all of them, looked at before any work is done, so that a wrong place costs none.

What is there already stays, unless ``--force`` is given; and then only what the same command made is replaced, never a
file or folder of something else.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from flora_common.errors import BadInput
from flora_common.runs import TRACK_HEADER

IsOurs = Callable[[Path], bool]
"""Whether a file is of the kind that a command makes; it may be any file, so only its beginning is to be believed."""


def can_be_made(path: Path, option: str = "-o") -> None:
    """Whether something can be made at a place where nothing is; changes nothing.

    Raises:
        BadInput: a file where a folder must be, or a folder in which nothing may be made.
    """
    there = next(parent for parent in path.absolute().parents if os.path.lexists(parent))
    if not there.is_dir():
        raise BadInput(f"{path}: cannot be written, {there} is no folder; name another place with {option}")
    if not os.access(there, os.W_OK | os.X_OK):
        raise BadInput(f"{path}: cannot be written, nothing may be made in {there}; name another place with {option}")


def is_there(path: Path, option: str = "-o") -> bool:
    """Whether anything is there, a link that leads nowhere included; see :func:`can_be_made` where nothing is."""
    if os.path.lexists(path):
        return True
    can_be_made(path, option)
    return False


def must_be_new(path: Path, option: str = "-o") -> None:
    """Whether a folder may be made there; BadInput where something is, or none can be."""
    if is_there(path, option):
        raise BadInput(f"{path}: is there already; name another folder with {option}")


def check_folder(
    path: Path, *, force: bool, needed: frozenset[str], allowed: frozenset[str] = frozenset(), what: str
) -> None:
    """Whether such a folder may be written there.

    Args:
        path: where.
        force: whether one of the kind that is there is to be replaced.
        needed, allowed: names of the files that such a folder must have, and may have besides.
        what: names the kind in messages.

    Raises:
        BadInput: something is there, and it is not to be, or must not be, replaced; or nothing can be made there.
    """
    if not is_there(path):
        return
    names = {entry.name for entry in path.iterdir()} if path.is_dir() and not path.is_symlink() else set()
    if not needed <= names <= needed | allowed:
        raise BadInput(f"{path}: is there already, is not {what} and is not replaced; name another folder with -o")
    if not force:
        raise BadInput(f"{path}: is there already; name another folder with -o, or add --force")


def check_file(path: Path, *, force: bool, is_ours: IsOurs, what: str, option: str = "-o") -> None:
    """Whether such a file may be written there.

    Args:
        path: where.
        force: whether one of the kind that is there is to be replaced; an empty one is of any kind.
        is_ours: whether a file is of that kind.
        what: names the kind in messages.
        option: that named the path.

    Raises:
        BadInput: see :func:`check_folder`.
    """
    if not is_there(path, option):
        return
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name a file with {option}")
    if not path.is_file() or (path.stat().st_size > 0 and not is_ours(path)):
        raise BadInput(f"{path}: is there already, is not {what} and is not replaced; name another file with {option}")
    if not force:
        raise BadInput(f"{path}: is there already; name another file with {option}, or add --force")


def check_apart(paths: Sequence[Path], files_of_input: Callable[[], Iterable[Path]]) -> None:
    """Whether nothing of the input would be replaced.

    Args:
        paths: that will be written.
        files_of_input: lists what is read; asked only where something is in the way.

    Raises:
        BadInput: one of the paths is a file of the input, whatever links lead to it.
    """
    there = {path.resolve(): path for path in paths if path.exists()}
    for file in files_of_input() if there else ():
        if (found := there.get(file.resolve())) is not None:
            raise BadInput(f"{found}: belongs to the input, which stays as it is; name another file")


def beginning(path: Path, count: int) -> bytes:
    """The first bytes of a file."""
    with path.open("rb") as file:
        return file.read(count)


def is_png(path: Path) -> bool:
    """Whether a file is a picture as PNG."""
    return beginning(path, 8) == b"\x89PNG\r\n\x1a\n"


def is_picture(path: Path) -> bool:
    """Whether a file is a picture as PNG or JPEG."""
    return is_png(path) or beginning(path, 3) == b"\xff\xd8\xff"


def is_film(path: Path) -> bool:
    """Whether a file is a film as MP4 or AVI."""
    head = beginning(path, 12)
    return head[4:8] == b"ftyp" or (head[:4], head[8:]) == (b"RIFF", b"AVI ")


def is_track(path: Path) -> bool:
    """Whether a file begins as a track does."""
    return beginning(path, len(TRACK_HEADER)) == TRACK_HEADER.encode()
