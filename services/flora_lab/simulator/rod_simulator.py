"""The mechanistic simulator: tropisms, growth and stiffening, with constants fitted to tracks."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from flora_common.runs import LampsSection
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange, GrowingSimulator, read_noise, read_prior, read_range
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.store import Stored
from flora_lab.simulator.tropism import TropismLaw

Array = npt.NDArray[Any]


class RodSimulator(GrowingSimulator):
    """The mechanistic simulator.

    Args:
        lamps: where they hang.
        prior, noise, shown, step_s: see :class:`flora_lab.simulator.growing.GrowingSimulator`.
    """

    kind: ClassVar[str] = "mechanistic"

    def __init__(
        self, lamps: LampsSection, prior: Prior, noise: DriveNoise, shown: DataRange, step_s: float = STEP_S
    ) -> None:
        super().__init__(TropismLaw(lamps), prior, noise, shown, step_s)
        self.lamps = lamps

    def scales(self) -> dict[str, Any]:
        lamps = {"lamp_distance_cm": self.lamps.distance_cm, "lamp_height_cm": self.lamps.height_cm}
        typical = dict(zip(self.law.traits, np.exp(self.prior.mean).tolist(), strict=True))
        return lamps | super().scales() | {"typical": typical}

    @staticmethod
    def from_stored(stored: Stored) -> RodSimulator:
        """A simulator from its folder.

        Raises:
            BadInput: something is missing, or cannot be a plant's.
        """
        return RodSimulator(
            LampsSection(stored.scale("lamp_distance_cm"), stored.scale("lamp_height_cm")),
            read_prior(stored, len(TropismLaw.traits)),
            read_noise(stored),
            read_range(stored),
            stored.info.step_s,
        )
