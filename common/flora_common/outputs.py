"""Where commands write: looked at before any work is done, so that a wrong place costs none. What is there stays."""

from __future__ import annotations

import os
from pathlib import Path

from flora_common.errors import BadInput


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


def must_be_new(path: Path) -> None:
    """Whether a folder may be made there; BadInput where something is, or none can be."""
    if is_there(path):
        raise BadInput(f"{path}: is there already; name another folder with -o")
