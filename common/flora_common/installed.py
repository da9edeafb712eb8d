"""The installed commands, for programs that start one another: each is its own program, with its own environment."""

from __future__ import annotations

import sys
from pathlib import Path


def command(name: str) -> str:
    """Path of an installed command, beside the running Python."""
    return str(Path(sys.executable).parent / name)
