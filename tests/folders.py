"""Folders that services and commands wrote, beside each other."""

from __future__ import annotations

from pathlib import Path


def same_folders(a: Path, b: Path) -> bool:
    """Whether two folders hold files of the same names and bytes; neither holds a folder."""
    names = sorted(p.name for p in a.iterdir())
    return names == sorted(p.name for p in b.iterdir()) and all(
        (a / n).read_bytes() == (b / n).read_bytes() for n in names
    )
