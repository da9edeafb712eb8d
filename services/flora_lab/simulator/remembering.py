"""The paper's simulator with its clock set right and a memory beside it.

The paper's network gives the next stem from this one and the lamp; it remembers nothing, and its steps may be those of
a plant that lives ``factor`` times too fast. Here a step of five minutes is that part of its step, and to it is added
what the plant does besides, as a linear function of the stem and of what is remembered of the lamps:

    stem' = stem + (network(stem, lamp) - stem) / factor + W [1, stem, m, h m]
    m_k' = m_k + (1 - exp(-dt / tau_k)) (side - m_k)

with ``side`` -1 for the left lamp and 1 for the right one, ``m`` the traces that it leaves for some hours, and ``h``
the height of the tip. Light is taken into the traces before they act, so that a new lamp acts at once, if weakly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from flora_common.arrays import Array, FloatArray
from flora_common.errors import BadInput
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.paper import COORDINATES, PaperSimulator
from flora_lab.simulator.store import INFO_FILE, Stored

TRACES_H: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Time constants of what is remembered, hours: from a plant's answer to a lamp to the hours for which it bends on."""
FEATURES: Final = 1 + COORDINATES + 2 * len(TRACES_H)
_LEARNED: Final = "learned"
_H: Final = 3600.0


@dataclass(frozen=True, slots=True)
class RememberingState:
    """Some plants at a time.

    Attributes:
        stems: points 2 to 10, cm, shape (batch, 18).
        traces: of the lamps, shape (batch, 5).
    """

    stems: FloatArray
    traces: FloatArray


class RememberingSimulator(Simulator[RememberingState]):
    """See the module.

    Args:
        learned: the paper's simulator, without a state of its own.
        factor: how many times too fast it is.
        memory: W, shape (18, 29), cm per step of ``learned``; zeros for none.
    """

    kind: ClassVar[str] = "remembering"

    def __init__(self, learned: PaperSimulator, factor: float, memory: FloatArray) -> None:
        if memory.shape != (COORDINATES, FEATURES):
            raise ValueError(f"memory is {memory.shape}; expected {(COORDINATES, FEATURES)}")
        self.learned = learned
        self.factor = factor
        self.memory = memory
        self.step_s = learned.step_s

    def start(
        self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None
    ) -> RememberingState:
        """See :meth:`Simulator.start`. Nothing happens by chance; ``before`` has shone for long."""
        stems = np.asarray(points_cm[:, 1:].reshape(-1, COORDINATES), dtype=np.float64)
        traces = np.zeros((len(stems), len(TRACES_H)))
        if before is not None:
            traces += sides(before)[:, None]
        return RememberingState(stems, traces)

    def watch(self, history: History) -> RememberingState:
        """See :meth:`Simulator.watch`: of the stems only the last one counts, of the lamps all."""
        state = self.start(history.points_cm[-1])
        traces = state.traces
        for light in history.light:
            traces = remembered(traces, sides(light), history.step_s)
        return RememberingState(state.stems, traces)

    def step(
        self, state: RememberingState, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[RememberingState, FloatArray]:
        """See :meth:`Simulator.step`; steps and lights are those that the paper's simulator knows."""
        side = sides(light)
        for _ in range(self.learned.steps_in(dt_s)):
            traces = remembered(state.traces, side, self.step_s)
            moved = self.learned_step_cm(state.stems, light) + self._beside(features(state.stems, traces))
            state = RememberingState(state.stems + moved, traces)
        return state, self.stems_cm(state)

    def learned_step_cm(self, stems: FloatArray, light: FloatArray) -> FloatArray:
        """What the network does in a step, at the right clock, shape (batch, 18)."""
        points = self.learned.start(with_anchor(stems))
        after = self.learned.step(points, light, self.step_s)[1][:, 1:].reshape(-1, COORDINATES)
        return np.asarray((after - stems) / self.factor)

    def _beside(self, values: FloatArray) -> FloatArray:
        """What memory adds in a step, shape (batch, 18); summed in one order, whatever other plants there are."""
        added = np.zeros((len(values), COORDINATES))
        for column, weights in zip(values.T, self.memory.T, strict=True):
            added += column[:, None] * weights
        return added

    def stems_cm(self, state: RememberingState) -> FloatArray:
        """See :meth:`Simulator.stems_cm`."""
        return with_anchor(state.stems)

    def is_beyond_data(self, state: RememberingState) -> Array:
        """Which plants have a coordinate outside of the box of the training inputs, shape (batch,)."""
        return self.learned.is_beyond_data(self.learned.start(self.stems_cm(state)))

    def weights(self) -> dict[str, Any]:
        """For :func:`flora_lab.simulator.store.write_simulator`."""
        own = {f"{_LEARNED}.{name}": array for name, array in self.learned.weights().items()}
        return {**own, "memory": self.memory}

    def scales(self) -> dict[str, Any]:
        """For ``[scales]``."""
        return {"time_scale_factor": self.factor, _LEARNED: dict(self.learned.scales())}

    @staticmethod
    def from_stored(stored: Stored) -> RememberingSimulator:
        """A simulator from its folder.

        Raises:
            BadInput: weights or scales that are missing or of another shape.
        """
        learned = PaperSimulator.from_stored(stored.inner(_LEARNED, PaperSimulator.kind, stored.info.step_s))
        factor = stored.scale("time_scale_factor")
        if factor <= 0.0 or learned.stateful:
            raise BadInput(
                f"{stored.path / INFO_FILE}: scales.{stored.part}time_scale_factor must be above 0, and "
                f"scales.{stored.part}learned.stateful false"
            )
        return RememberingSimulator(learned, factor, stored.weight("memory", (COORDINATES, FEATURES)))


def sides(light: FloatArray) -> FloatArray:
    """Levels of both lamps, shape (..., 2), as -1 for the left to 1 for the right one, shape (...)."""
    return np.asarray(light[..., 1] - light[..., 0], dtype=np.float64)


def remembered(traces: FloatArray, side: FloatArray, dt_s: float) -> FloatArray:
    """Traces, shape (batch, 5), after a lamp has shone for ``dt_s``; ``side`` of shape (batch,)."""
    return np.asarray(traces + taken_in(dt_s) * (side[:, None] - traces))


def taken_in(dt_s: float) -> FloatArray:
    """Share of a lamp that each trace takes in, shape (5,)."""
    return np.asarray(-np.expm1(-dt_s / (_H * np.array(TRACES_H))))


def features(stems: FloatArray, traces: FloatArray) -> FloatArray:
    """What memory acts on, shape (batch, 29); see the module."""
    return np.concatenate([np.ones((len(stems), 1)), stems, traces, stems[:, -1:] * traces], axis=1)


def with_anchor(stems: FloatArray) -> FloatArray:
    """Points 2 to 10, shape (batch, 18), as whole stems, shape (batch, 10, 2)."""
    points = np.zeros((len(stems), STEM_POINTS, 2))
    points[:, 1:] = stems.reshape(-1, STEM_POINTS - 1, 2)
    return points
