"""The sequence simulator: a learned law with memory, in several members."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from flora_common.errors import BadInput
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange, GrowingSimulator, read_noise, read_prior, read_range
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.neural_law import WEIGHTS, NeuralLaw, weight_shapes
from flora_lab.simulator.store import Stored

Array = npt.NDArray[Any]


class SequenceSimulator(GrowingSimulator):
    """The sequence simulator.

    Args:
        law: what was learned.
        prior, noise, shown, step_s: see :class:`flora_lab.simulator.growing.GrowingSimulator`.
    """

    kind: ClassVar[str] = "sequence"
    law_error_cm: ClassVar[float] = 0.5
    """Chosen on plants of its own (virtual ones, seeds 6000 to 6111): 0.3 to 0.8 did about as well."""

    def __init__(
        self, law: NeuralLaw, prior: Prior, noise: DriveNoise, shown: DataRange, step_s: float = STEP_S
    ) -> None:
        super().__init__(law, prior, noise, shown, step_s)
        self.neural = law

    def members(self) -> list[SequenceSimulator]:
        """Each member as a simulator of its own, if there are several."""
        count = self.neural.memory_shape[0]
        if count == 1:
            return []
        return [
            SequenceSimulator(self.neural.member(m), self.prior, self.noise, self.shown, self.step_s)
            for m in range(count)
        ]

    def weights(self) -> dict[str, Array]:
        return super().weights() | self.neural.weights

    def scales(self) -> dict[str, Any]:
        return super().scales() | {"zone_cm": self.neural.zone_cm}

    @staticmethod
    def from_stored(stored: Stored) -> SequenceSimulator:
        """A simulator from its folder.

        Raises:
            BadInput: something is missing, or shapes do not fit one another.
        """
        recurrent = stored.weight("w_hh", (None, None, None))
        members, hidden = recurrent.shape[:2]
        if members < 1 or hidden < 1:
            raise BadInput(
                f"{stored.path}: `w_hh` is {recurrent.shape}; there must be at least one member and one cell"
            )
        shapes = weight_shapes(members, hidden)
        weights = {name: stored.weight(name, shapes[name]).astype(np.float32) for name in WEIGHTS}
        law = NeuralLaw(weights, stored.scale("zone_cm"))
        return SequenceSimulator(
            law, read_prior(stored, len(law.traits)), read_noise(stored), read_range(stored), stored.info.step_s
        )
