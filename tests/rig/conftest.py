"""Virtual rigs for tests: folder, sockets and processes of their own, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from flora_common.runs import RunFile
from flora_twin.box import camera_section
from flora_twin.rig.layout import make_layout, with_task
from flora_twin.rig.virtual_rig import VirtualRig

START = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)


def maker(stack: ExitStack, folder: Path) -> Callable[..., VirtualRig]:
    def make(*, seed: int = 1, rate: float = 0.0, **sections: dict[str, Any]) -> VirtualRig:
        run_file = RunFile(camera=camera_section(), rig="test", plant=f"seed {seed}", start=START)
        layout = make_layout(folder / f"rig-{seed}", with_task(run_file), sections=sections)
        return stack.enter_context(VirtualRig(layout, seed=seed, rate=rate))

    return make


@pytest.fixture
def virtual_rig(tmp_path: Path) -> Iterator[Callable[..., VirtualRig]]:
    """Makes a virtual rig that is not yet started; keywords are configuration sections."""
    with ExitStack() as stack:
        yield maker(stack, tmp_path)


@pytest.fixture(scope="module")
def lasting_virtual_rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., VirtualRig]]:
    """The same, for rigs that all tests of a module share."""
    with ExitStack() as stack:
        yield maker(stack, tmp_path_factory.mktemp("rigs"))
