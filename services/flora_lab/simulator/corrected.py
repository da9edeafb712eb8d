"""A learned simulator that lacks an effect, with a mechanistic part beside it that supplies what the effect changes.

Beside the learned plant two mechanistic ones grow from the same stem under the same light: one as it was fitted to the
runs that the learned one is from, and one with the effect. What they differ by is added to the learned stem. Both are
the same individual, and the same happens to them by chance, so that what they have in common cancels. Stems are added
point by point, so that a corrected one is not tissue: it may get a millimetre shorter from one step to the next.

Whoever recognises an individual takes part of the effect for its nature. So the individual is recognised by the
mechanistic plant that has the effect, and the learned simulator is shown the stems as they would have been without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.geometry import resample_by_height
from flora_lab.simulator.growing import GrowingState
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator, run
from flora_lab.simulator.paper import PaperSimulator
from flora_lab.simulator.remembering import RememberingSimulator
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import INFO_FILE, Extension, Stored

LearnedSimulator = PaperSimulator | SequenceSimulator | RememberingSimulator

_KINDS: Final[dict[str, type[LearnedSimulator]]] = {
    kind.kind: kind for kind in (PaperSimulator, SequenceSimulator, RememberingSimulator)
}
_LEARNED, _MECHANISTIC = "learned", "mechanistic"
"""Of the two parts: begins the names of their weights, and is the name of the table of their scales."""
EVEN_CM: Final = 1e-6
"""Heights that are evenly spaced but for rounding."""


@dataclass(frozen=True, slots=True)
class CorrectedState:
    """Plants at a time.

    Attributes:
        learned: state of the learned simulator.
        plain, extended: of the mechanistic plants without and with the effects.
    """

    learned: Any
    plain: GrowingState
    extended: GrowingState


class CorrectedSimulator(Simulator[CorrectedState]):
    """See the module.

    Args:
        learned: that lacks effects.
        extended: that has them, fitted to the same runs.

    Attributes:
        mechanistic: the latter.
        plain: the same without the effects.
    """

    kind: ClassVar[str] = "corrected"

    def __init__(self, learned: LearnedSimulator, extended: RodSimulator) -> None:
        self.learned = learned
        self.mechanistic = extended
        self.step_s = learned.step_s
        self.plain = extended.without_extensions()

    @property
    def extensions(self) -> tuple[Extension, ...]:
        """The effects."""
        return self.mechanistic.extensions

    @property
    def has_individuals(self) -> bool:
        """Those of the learned part: the mechanistic ones beside it are the same plant."""
        return self.learned.has_individuals

    def start(self, points_cm: Array, chance: Chance | None = None, before: Array | None = None) -> CorrectedState:
        """See :meth:`Simulator.start`."""
        plain, extended = (one.start(points_cm, chance, before) for one in (self.plain, self.mechanistic))
        return CorrectedState(self.learned.start(points_cm, chance, before), plain, extended)

    def watch(self, history: History) -> CorrectedState:
        """See :meth:`Simulator.watch`; a learned simulator without individuals is shown the stems as they were."""
        traits = self.mechanistic.recognised(history)
        own = traits - self.mechanistic.added_traits
        plain, extended = self.plain.known(history, own), self.mechanistic.known(history, traits)
        if isinstance(self.learned, PaperSimulator | RememberingSimulator):
            return CorrectedState(self.learned.watch(history), plain, extended)
        without = replace(history, points_cm=history.points_cm - self._added_cm(history, own, traits))
        learned = self.learned.known(history, self.learned.recognised(without))
        return CorrectedState(learned, plain, extended)

    def _added_cm(self, history: History, own: Array, traits: Array) -> Array:
        """What the effects had added to each stem of a history, shape (n, batch, 10, 2)."""
        first = replace(history, points_cm=history.points_cm[:1], light=history.light[:0])
        added = np.zeros(history.points_cm.shape)
        for simulator, individuals, sign in ((self.plain, own, -1.0), (self.mechanistic, traits, 1.0)):
            state = simulator.known(first, individuals)
            added[1:] += sign * run(simulator, state, history.light, history.step_s, history.covariates)
        return added

    def step(
        self, state: CorrectedState, light: Array, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[CorrectedState, Array]:
        """See :meth:`Simulator.step`; steps and lights are those that the learned simulator knows."""
        learned, _ = self.learned.step(state.learned, light, dt_s, covariates)
        plain, _ = self.plain.step(state.plain, light, dt_s, covariates)
        extended, _ = self.mechanistic.step(state.extended, light, dt_s, covariates)
        after = CorrectedState(learned, plain, extended)
        return after, self.stems_cm(after)

    def stems_cm(self, state: CorrectedState) -> Array:
        """See :meth:`Simulator.stems_cm`."""
        added = self.mechanistic.stems_cm(state.extended) - self.plain.stems_cm(state.plain)
        return np.stack([_stem(points) for points in self.learned.stems_cm(state.learned) + added])

    def is_beyond_data(self, state: CorrectedState) -> Array:
        """Which plants the learned or the extended simulator was never shown the like of, shape (batch,)."""
        strange = self.learned.is_beyond_data(state.learned)
        return np.asarray(strange | self.mechanistic.is_beyond_data(state.extended))

    def weights(self) -> dict[str, Array]:
        """For :func:`flora_lab.simulator.store.write_simulator`."""
        parts = ((_LEARNED, self.learned.weights()), (_MECHANISTIC, self.mechanistic.weights()))
        return {f"{part}.{name}": array for part, weights in parts for name, array in weights.items()}

    def scales(self) -> dict[str, Any]:
        """For ``[scales]``: those of both parts."""
        return {
            "learned_kind": self.learned.kind,
            "mechanistic_step_s": self.mechanistic.step_s,
            _LEARNED: dict(self.learned.scales()),
            _MECHANISTIC: self.mechanistic.scales(),
        }

    @staticmethod
    def from_stored(stored: Stored) -> CorrectedSimulator:
        """A simulator from its folder.

        Raises:
            BadInput: something is missing, or fits no simulator; an effect that no simulator can have.
        """
        told = stored.info.scales.get("learned_kind")
        kind = _KINDS.get(told) if isinstance(told, str) else None
        if kind is None:
            where = stored.path / INFO_FILE
            raise BadInput(f"{where}: scales.learned_kind is {str(told)[:40]}; it must be one of {', '.join(_KINDS)}")
        learned = kind.from_stored(stored.inner(_LEARNED, kind.kind, stored.info.step_s))
        step_s = stored.scale("mechanistic_step_s")
        return CorrectedSimulator(
            learned, RodSimulator.from_stored(stored.inner(_MECHANISTIC, RodSimulator.kind, step_s))
        )


def _stem(points: Array) -> Array:
    """A stem as it is told: above the ground, its ten points at even heights."""
    points[:, 1] = np.maximum(points[:, 1], 0.0)
    even = np.linspace(0.0, points[-1, 1], len(points))
    if not np.isfinite(points).all() or np.abs(points[:, 1] - even).max() <= EVEN_CM:
        return points
    return resample_by_height(points, len(points))
