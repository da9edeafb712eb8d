"""Any simulator folder as the simulated plant that it holds."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, Final

from flora_common.errors import BadInput
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.store import INFO_FILE, Stored, read_stored

KINDS: Final = {
    "paper": "flora_lab.simulator.paper:PaperSimulator",
    "sequence": "flora_lab.simulator.sequence:SequenceSimulator",
    "mechanistic": "flora_lab.simulator.rod_simulator:RodSimulator",
    "remembering": "flora_lab.simulator.remembering:RememberingSimulator",
    "corrected": "flora_lab.simulator.corrected:CorrectedSimulator",
}
"""``kind`` in ``simulator.toml`` to the class that reads it, with ``from_stored(stored)``. Imported when it is needed:
a kind's libraries take their time."""
EXTENDED: Final = ("mechanistic", "remembering", "corrected")
"""Kinds whose plants can have named effects beside, or are without named errors."""


def load(path: Path) -> Simulator[Any]:
    """The simulated plant in a folder.

    Raises:
        BadInput: see :func:`flora_lab.simulator.store.read_stored`; a kind that this program does not know; or weights
            and scales that are not what the kind needs.
    """
    return simulator_of(read_stored(path))


def simulator_of(stored: Stored) -> Simulator[Any]:
    """The simulated plant that was stored.

    Raises:
        BadInput: a kind that this program does not know, or one that cannot be extended as it is told to be; or weights
            and scales that are not what the kind needs.
    """
    kind = stored.info.kind
    place = KINDS.get(kind)
    if place is None:
        raise BadInput(
            f"{stored.path / INFO_FILE}: kind `{kind[:40]}` is not known; this program reads {', '.join(KINDS)}"
        )
    if stored.info.extension and kind not in EXTENDED:
        raise BadInput(
            f"{stored.path / INFO_FILE}: kind `{kind}` takes no [[extension]]; only {', '.join(EXTENDED)} do"
        )
    module, _, name = place.partition(":")
    simulator: Simulator[Any] = getattr(importlib.import_module(module), name).from_stored(stored)
    return simulator
