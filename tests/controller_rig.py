"""A controller with everything but the bus: what flora-controller's ``build`` puts together, tick by tick."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path
from typing import Any

import msgspec

from flora_common.controller_file import LoadedController, parse_controller
from flora_common.messages import ControllerAnswer, ControllerState, LightCommand, Stem
from flora_common.offering import chunk_of, offer_of
from flora_common.shapes import Obstacle, Target
from flora_common.signing import signed_bytes
from flora_controller.acceptance import Acceptance, Policy
from flora_controller.core import ControllerCore, ControllerSection
from flora_controller.record import Record, read_record, write_record
from flora_controller.serials import Serials, read_serials, write_serials
from flora_controller.shelf import Shelf
from flora_controller.source import FixedSource, built_in
from flora_controller.succession import Succession
from signing_keys import ADA, TIP_ONLY, signed, trusted

TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)
RIGHT_OF_IT, LEFT_OF_IT = 0.0, -9.0
"""Tips on either side of the target's x."""


def stem(tick: int, x_cm: float | None = 0.0, y_cm: float = 10.0) -> Stem:
    """A straight stem whose tip is at this place; None is a tick without one."""
    if x_cm is None:
        return Stem(tick=tick, time_s=tick * 300.0, outcome="no_stem")
    points = tuple((x_cm * i / 9, y_cm * i / 9) for i in range(10))
    return Stem(tick=tick, time_s=tick * 300.0, outcome="ok", points_cm=points)


def diverging(*, serial: int) -> LoadedController:
    """A network with an answer (0.5, left) only while the tip is above the anchor: elsewhere it has none."""
    table: dict[str, Any] = json.loads(TIP_ONLY.read_text(encoding="utf-8"))
    network = table["network"]
    hidden = network["nodes"][0] | {"type": "hidden", "activation": {"name": "cube", "custom": False}}
    network["nodes"] += [hidden | {"id": number} for number in range(1, 7)]
    way = [-1, 1, 2, 3, 4, 5, 6, 0]
    network["connections"] = [{"from": a, "to": b, "weight": 1e5, "enabled": True} for a, b in itertools.pairwise(way)]
    return parse_controller(signed_bytes(table | {"name": "diverging", "serial": serial}, ADA), where="x")


def tip_only(*, serial: int, name: str = "tip-only", **changes: Any) -> LoadedController:
    """Left where the tip is right of the target's x, else right."""
    return signed(TIP_ONLY, ADA, serial=serial, name=name, **changes)


FIRST, SECOND = tip_only(serial=1, name="first"), tip_only(serial=2, name="second")


class Rig:
    """``restart`` is a new process on the same disk."""

    def __init__(self, folder: Path, **section: Any) -> None:
        self.folder = folder
        self.section = msgspec.convert({"use": "tip-follower"} | section, ControllerSection)
        self.answers: list[ControllerAnswer] = []
        self.now_s = 0.0
        self.keys = trusted(ADA)
        self.start()

    def start(self, **section: Any) -> None:
        """The order of things is that of ``flora_controller.main.build``."""
        self.section = msgspec.structs.replace(self.section, **section)
        serials = self.folder / "serials.json"
        policy = Policy(target=TARGET, obstacle=OBSTACLE, keys=self.keys)

        def keep(kept: Serials) -> None:
            write_serials(serials, kept)

        acceptance = Acceptance(policy, read_serials(serials), keep=keep, utc=lambda: None)
        source = FixedSource(built_in(self.section, TARGET, OBSTACLE))
        self.succession = Succession(
            source,
            Shelf(self.folder / "controllers"),
            acceptance,
            shadow_ticks=self.section.shadow_ticks,
            say=self.answers.append,
        )
        record, _ = read_record(self.folder / "controller.json", run="r")
        self.core = ControllerCore(
            self.succession.lineup, self.section, target=TARGET, obstacle=OBSTACLE, record=record or Record(run="r")
        )
        self._follow(self.succession.after_tick(self.core.shadow_ticks))

    def _follow(self, has_changed: bool) -> None:
        if has_changed:
            self.core.use(self.succession.lineup)

    def tick(self, number: int, x_cm: float | None = 0.0, y_cm: float = 10.0) -> tuple[LightCommand, ControllerState]:
        answer = self.core.on_stem(stem(number, x_cm, y_cm), note=self.succession.note)
        assert answer is not None
        self._follow(self.succession.after_tick(self.core.shadow_ticks, self.core.failures))
        write_record(self.folder / "controller.json", self.core.record)
        return answer

    def offer(self, loaded: LoadedController, *, shadow_ticks: int = 0, offer: str = "") -> ControllerAnswer:
        """Bring a file as a sender would; returns the last answer."""
        self.answers.clear()
        offer = offer or os.urandom(8).hex()
        said = offer_of(loaded.data, offer=offer, name=loaded.file.name, shadow_ticks=shadow_ticks)
        self.succession.on_offer(said, self.now_s)
        for number in self.answers[-1].missing:
            self._follow(self.succession.on_chunk(chunk_of(loaded.data, offer=offer, number=number), self.now_s))
        return self.answers[-1]
