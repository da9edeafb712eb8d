"""The machine that a bench ran on."""

from __future__ import annotations

import platform
from pathlib import Path


def processor() -> str:
    """Its processor's name, as Linux tells it; the architecture where it tells none."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()
