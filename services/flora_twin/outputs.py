"""Where commands write: looked at before any work is done, so that a wrong place costs none. What is there stays.

flora-lab has rules like these; services do not import one another.
"""

from __future__ import annotations

import os
from pathlib import Path

from flora_common.errors import BadInput


def must_be_new_folder(path: Path) -> None:
    """Whether a folder can be made there.

    Raises:
        BadInput: something is there, a link that leads nowhere included; or nothing can be made there.
    """
    if os.path.lexists(path):
        raise BadInput(f"{path}: is there already; name another folder with -o")
    _can_be_made(path)


def must_be_new_file(path: Path, *, force: bool) -> None:
    """Whether a file can be written there.

    Args:
        path: where.
        force: whether a file that is there is to be replaced.

    Raises:
        BadInput: a folder is there, or a file that is not to be replaced; or nothing can be made there.
    """
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name a file with -o")
    if os.path.lexists(path) and not force:
        raise BadInput(f"{path}: is there already; name another file with -o, or add --force")
    _can_be_made(path)


def _can_be_made(path: Path) -> None:
    """Whether the nearest folder above lets something be made in it; changes nothing.

    Raises:
        BadInput: it is no folder, or nothing may be made in it.
    """
    there = next(parent for parent in path.absolute().parents if os.path.lexists(parent))
    if not there.is_dir():
        raise BadInput(f"{path}: cannot be written, {there} is no folder; name another place with -o")
    if not os.access(there, os.W_OK | os.X_OK):
        raise BadInput(f"{path}: cannot be written, nothing may be made in {there}; name another place with -o")
