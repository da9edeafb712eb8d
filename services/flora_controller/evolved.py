"""A controller file as a steering rule."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flora_common.controller_file import LEFT_AT_MOST, LoadedController
from flora_common.network import NotFinite
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_controller.steering import Decision, Memory, View


@dataclass(frozen=True, slots=True)
class Evolved:
    """Asks a network. No decision where anything in it is not a finite number."""

    loaded: LoadedController
    target: Target | None
    obstacle: Obstacle | None
    name: str
    needs_stem: bool = True

    @property
    def sha256(self) -> str:
        return self.loaded.sha256

    @property
    def stem_range(self) -> StemRange | None:
        return self.loaded.file.stem_range

    def decide(self, view: View, memory: Memory) -> Decision:
        if view.points_cm is None:
            return Decision(None, reason="no stem")
        try:
            (output,) = self.loaded.network.activate(
                self.loaded.values(view.points_cm.tolist(), self.target, self.obstacle)
            )
        except NotFinite as problem:
            return Decision(None, reason=f"the network has no answer: {problem}")
        if not math.isfinite(output):
            return Decision(None, reason=f"the network has no answer: its output is {output:g}")
        if output <= LEFT_AT_MOST:
            return Decision("left", output, f"network: {output:.3f} is at most 0.5")
        return Decision("right", output, f"network: {output:.3f} is above 0.5")
