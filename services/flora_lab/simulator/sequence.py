"""The sequence simulator: a learned law with memory, in several members.

The typical plant bends at the mean of the members' rates. A drawn plant follows one of them, or that mean: what the
simulator does not know is one of the ways in which its plants differ.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import (
    DataRange,
    GrowingSimulator,
    GrowingState,
    read_noise,
    read_prior,
    read_range,
)
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.interface import Chance
from flora_lab.simulator.law import Law, Stems, advanced
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.neural_law import WEIGHTS, NeuralLaw, weight_shapes
from flora_lab.simulator.store import Stored

MEAN: Final = -1
"""In place of a member's number: the mean of them all."""
_MEMBER: Final = 13
"""Stream of random numbers that a plant's member is drawn from; its traits and its drives have others."""


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
        count = law.memory_shape[0]
        self._laws = [law.member(m) for m in range(count)] if count > 1 else []

    def members(self) -> list[SequenceSimulator]:
        """Each member as a simulator of its own, if there are several."""
        return [SequenceSimulator(law, self.prior, self.noise, self.shown, self.step_s) for law in self._laws]

    def following(self, stems: Stems, member: int) -> tuple[NeuralLaw, Stems]:
        """The law that a member is, and stems whose plants remember what it does.

        Args:
            stems: of this simulator.
            member: from 0, or :data:`MEAN`.
        """
        if member == MEAN:
            return self.neural, stems
        return self._laws[member], replace(stems, memory=np.ascontiguousarray(stems.memory[:, [member]]))

    def _drawn_members(self, chance: Chance) -> Array | None:
        """One of the members or their mean, each as likely; None where there is a single one."""
        if not self._laws:
            return None
        drawn = [np.random.default_rng([int(s), _MEMBER]).integers(MEAN, len(self._laws)) for s in chance.seeds]
        return np.array(drawn, dtype=np.int64)

    def _advanced(
        self, law: Law, state: GrowingState, light: Array, bias: Array, growth: Array, step_h: float
    ) -> Stems:
        if state.member is None:
            return super()._advanced(law, state, light, bias, growth, step_h)
        after = state.stems.copy()
        for member in np.unique(state.member).tolist():
            rows = np.flatnonzero(state.member == member)
            before = Stems(after.length[rows], after.angle[rows], after.count[rows], after.memory[rows])
            own, stems = self.following(before, member)
            lit, bent, grown = (np.ascontiguousarray(force[:, rows]) for force in (light, bias, growth))
            part = advanced(own, stems, state.traits[rows], lit, bent, grown, step_h)
            after.length[rows], after.angle[rows], after.count[rows] = part.length, part.angle, part.count
            if member == MEAN:
                after.memory[rows] = part.memory
            else:
                after.memory[rows, member] = part.memory[:, 0]
        return after

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
