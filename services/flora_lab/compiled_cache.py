"""Where compiled code is kept from one start to the next, so that it is never older than its sources.

Numba compiles a function anew when the function's own file has changed, but not when only a file has changed whose
functions it calls: after an update it would go on with the old ones, whose results may differ. Here the folder of the
cache is named after the content of all files that hold compiled functions.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from pathlib import Path
from typing import Final

VARIABLE: Final = "NUMBA_CACHE_DIR"
_PREFIX: Final = "numba-"
_COMPILED: Final = (b"jit", b"numba", b"inlined")
"""Words of which a file has one if it holds compiled functions, or hands some on."""


def use_cache_of(package: Path) -> None:
    """Let Numba keep what it compiles from the sources in ``package`` in a folder for these sources alone.

    A folder that the user has set stays. Where nothing can be written, Numba keeps it where it would by itself.
    """
    if VARIABLE in os.environ and _PREFIX not in os.environ[VARIABLE]:
        return
    folder = package / "__pycache__" / f"{_PREFIX}{fingerprint(package)}"
    if not folder.exists():
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return
        for old in folder.parent.glob(f"{_PREFIX}*"):
            if old != folder:
                shutil.rmtree(old, ignore_errors=True)
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def fingerprint(package: Path) -> str:
    """Of the content of all files in ``package`` that hold, or import, compiled functions."""
    found = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        data = path.read_bytes()
        if any(word in data for word in _COMPILED):
            found.update(f"{path.relative_to(package)}\0{len(data)}\0".encode())
            found.update(data)
    return found.hexdigest()[:16]
