"""A virtual rig of its own for each test: folder, sockets, processes, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from flora_common.runs import RunFile
from flora_twin.rig.layout import make_layout, with_task
from flora_twin.rig.virtual_rig import VirtualRig

START = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)


@pytest.fixture
def virtual_rig(tmp_path: Path) -> Iterator[Callable[..., VirtualRig]]:
    """Makes a virtual rig that is not yet started; keywords are configuration sections."""
    from flora_twin.box import camera_section

    with ExitStack() as stack:

        def make(*, seed: int = 1, rate: float = 0.0, **sections: dict[str, Any]) -> VirtualRig:
            run_file = RunFile(camera=camera_section(), rig="test", plant=f"seed {seed}", start=START)
            layout = make_layout(tmp_path / "rig", with_task(run_file), sections=sections)
            return stack.enter_context(VirtualRig(layout, seed=seed, rate=rate))

        yield make
