"""Modules that are imported when they are needed.

Numba, scipy, matplotlib and neat-python take seconds to load; who asks a subcommand for its options need not wait for
them.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any


def modules_of(package: str) -> Callable[[str], Any]:
    """What imports a module of a package by its name."""
    return lambda name: importlib.import_module(f"{package}.{name}")
