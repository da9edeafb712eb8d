"""What one picture shows, found without regard to others."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

from flora_common.arrays import Float32Array
from flora_common.runs import CameraSection
from flora_common.vision.path.doubts import EDGE_PX, touching_px
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Way
from flora_common.vision.path.likeness import Likeness
from flora_common.vision.path.strands import Strands, find_strands


@dataclass(frozen=True, eq=False)
class Sight:
    """What one picture shows: can be made anywhere, in any order.

    Attributes:
        evidence: of the plant.
        likeness: of the rest to the empty setup.
        camera: anchor and scale, px of the full picture.
        widest_px: what is thicker is leaf.
        foot_px: the place in the window that is nearest to the anchor.
        ways: what the network tells, likeliest first; none where there is no plant.
        flat: how the whole picture differs from the empty setup, as :class:`.survey.Survey` has it; None where that was
            learnt from the plant's own pictures, for it has ghosts of them.
    """

    evidence: Evidence
    likeness: Likeness
    camera: CameraSection
    widest_px: float
    foot_px: tuple[float, float]
    flat: Float32Array | None
    ways: tuple[Way, ...] = ()

    def with_ways(self, ways: tuple[Way, ...]) -> Sight:
        """The same with other ways; what was worked out already is kept."""
        other = copy(self)
        other.__dict__["ways"] = ways  # it is frozen, and nothing that is worked out follows from them
        return other

    @cached_property
    def strands(self) -> Strands:
        """Thin pieces of plant; found when they are asked for, for it takes as long as all the rest."""
        return find_strands(self.evidence, widest_px=self.widest_px, foot_px=self.foot_px)

    @cached_property
    def touching_cm(self) -> float:
        """Over how much of the picture's sides and upper edge wide parts of plant touch it."""
        (x, y), width = self.evidence.origin_px, self.evidence.plant.shape[1]
        if min(x, y, self.camera.width_px - (x + width)) > EDGE_PX:
            return 0.0
        return touching_px(self.strands, self.camera) / self.camera.px_per_cm
