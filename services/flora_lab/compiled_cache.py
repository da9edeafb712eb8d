"""Where compiled code is kept from one start to the next, so that it is never older than its sources.

Numba compiles a function anew when the function's own file has changed, but not when only a file has changed whose
functions it calls: after an update it would go on with the old ones, whose results may differ. Here the folder of the
cache is named after the content of all files that hold compiled functions, and after the lanes that the user has set,
which are constants in them.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from flora_lab import lanes

VARIABLE: Final = "NUMBA_CACHE_DIR"
_PREFIX: Final = "numba-"
_COMPILED: Final = (b"jit", b"numba", b"inlined")
"""Words of which a file has one if it holds compiled functions, or hands some on."""


def use_cache_of(package: Path) -> None:
    """Let Numba keep what it compiles from the sources in ``package`` in a folder for these sources alone.

    The folder lies beside the sources; where nothing can be written there, in the user's own cache; where that cannot
    be either, it is a temporary one, which goes with this process: Numba refuses to work without. One that the user
    has set stays, and so does one of the same sources that this process was started with.
    """
    given = os.environ.get(VARIABLE, "")
    sources = fingerprint(package)
    name = _PREFIX + "-".join(part for part in (lanes.given(), sources) if part)
    if given and (_PREFIX not in given or Path(given).name.startswith(name)):
        return
    os.environ[VARIABLE] = str(_writable(name, sources, (package / "__pycache__", _of_user())))
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = os.environ[VARIABLE]


def _writable(name: str, sources: str, parents: Iterable[Path]) -> Path:
    """A folder of this name in the first place where it can be written, without those of earlier sources."""
    for parent in parents:
        folder = parent / name
        try:
            is_new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        for old in parent.glob(f"{_PREFIX}*") if is_new else ():
            if sources not in old.name:
                shutil.rmtree(old, ignore_errors=True)
        return folder
    folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _of_user() -> Path:
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if given.is_absolute():
        return given / "flora"
    try:
        return Path.home() / ".cache" / "flora"
    except RuntimeError:  # there is none
        return Path(os.devnull)


def fingerprint(package: Path) -> str:
    """Of the content of all files in ``package`` that hold, or import, compiled functions."""
    found = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        data = path.read_bytes()
        if any(word in data for word in _COMPILED):
            found.update(f"{path.relative_to(package)}\0{len(data)}\0".encode())
            found.update(data)
    return found.hexdigest()[:16]
