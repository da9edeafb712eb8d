"""What is called on a node of a cluster: is flora there the flora here? Then the work.

It goes to the nodes as code, not as the name of a module, so that a node without flora can answer too. Therefore it
imports nothing but the standard library.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("flora_common", "flora_lab")
LIBRARIES = ("flora", "ray", "numpy", "numba", "neat-python")
"""Those whose versions decide numbers, or whether machines understand each other."""
NOT_INSTALLED = "not installed"
DONE, DIFFERS = "done", "differs"

_known: dict[str, str] = {}
"""What :func:`call` found in this process. Only nodes may fill it, for it goes with the code as it is."""


def versions() -> dict[str, str]:
    """What has to be the same on all machines for the results to be the same: a name that people know to a version."""
    found = {"Python": platform.python_version(), "the processor": platform.machine()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = NOT_INSTALLED
    found["flora's source"] = _source()
    return found


def call(wanted: dict[str, str], target: str, *arguments: Any) -> tuple[str, Any]:
    """Call a function of flora, if versions are those that are wanted.

    Args:
        wanted: of :func:`versions`, on the machine that asks.
        target: ``module:function``.
        arguments: of plain types, which any node can unpack.

    Returns:
        ``DONE`` and what the function returned; or ``DIFFERS`` and the name of the machine, what differs and the
        version there.
    """
    if not _known:
        _known.update(versions())
    for name, version in wanted.items():
        if _known.get(name) != version:
            return DIFFERS, (platform.node(), name, _known.get(name, NOT_INSTALLED))
    module, _, function = target.partition(":")
    return DONE, getattr(importlib.import_module(module), function)(*arguments)


def _source() -> str:
    """Beginning of the SHA-256 of flora's Python files: between two releases the version says nothing."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            return NOT_INSTALLED
        folder = Path(spec.origin).parent
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            digest.update(f"{package}/{path.relative_to(folder).as_posix()} {len(content)}\n".encode())
            digest.update(content)
    return digest.hexdigest()[:12]
