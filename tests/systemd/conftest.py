"""One booted machine for all tests of this folder, and the table that they fill."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from booted import machine_or_skip
from installed_rig import Rig, Table


@pytest.fixture(scope="session")
def table() -> Iterator[Table]:
    table = Table()
    yield table
    table.print()


@pytest.fixture(scope="session")
def rig() -> Iterator[Rig]:
    folder = Path(tempfile.mkdtemp(prefix="flora-systemd-"))
    machine = None
    try:
        machine = machine_or_skip(folder)
        yield Rig(machine, folder)
    finally:
        if machine is not None:
            machine.close()
        shutil.rmtree(folder)
