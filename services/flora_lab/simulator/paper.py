"""The paper's simulator: the next stem from this one and the lamp, by an LSTM of 50 cells (Wahby et al. 2018).

The network has 19 inputs (nine points and the light), 50 LSTM cells and 18 outputs (the nine points one step later). It
is trained on single steps in random order, each from the zero state. There the products of state and recurrent weights,
and of state and forget gate, are zero, and so are their gradients: these weights stay where the dice put them. So the
network is run as it was trained, from the zero state at each step; it has no memory, and the stem is all its state. To
show what becomes of it otherwise, ``stateful`` carries the LSTM's state from step to step through those random weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_common.errors import BadInput
from flora_common.shapes import STEM_POINTS
from flora_lab.simulator.interface import Chance, Covariates, History, Simulator
from flora_lab.simulator.lstm_cell import Dense, LstmCell, LstmState
from flora_lab.simulator.store import INFO_FILE, Stored

COORDINATES: Final = 2 * (STEM_POINTS - 1)
"""Of points 2 to 10; point 1 is the anchor, always (0, 0), and no part of the vectors."""
INPUTS: Final = COORDINATES + 1
CELLS: Final = 50
BOX_QUANTILES: Final = (0.001, 0.999)
"""Of each coordinate of the training inputs: outside of this box the simulator was shown next to nothing."""
_STEP_TOLERANCE: Final = 1e-6


@dataclass(frozen=True, slots=True)
class PaperNetwork:
    """All weights of the network.

    Attributes:
        cell: 19 inputs, 50 cells.
        dense: 18 outputs.
    """

    cell: LstmCell
    dense: Dense

    def __call__(self, inputs: Float32Array, state: LstmState | None = None) -> tuple[Float32Array, LstmState]:
        """One step.

        Args:
            inputs: shape (batch, 19), units; the last is the light, 0 left, 1 right.
            state: of the LSTM; None is the zero state.

        Returns:
            The points one step later, shape (batch, 18), units; and the LSTM's state.
        """
        state = self.cell.step(inputs, state)
        return self.dense(state.hidden), state


@dataclass(frozen=True, slots=True)
class Box:
    """Where the training inputs lay.

    Attributes:
        low, high: shape (18,), units.
    """

    low: Float32Array
    high: Float32Array

    @classmethod
    def around(cls, inputs: Float32Array) -> Self:
        """The box of training inputs, shape (n, 18 or 19)."""
        low, high = np.quantile(inputs[:, :COORDINATES], BOX_QUANTILES, axis=0)
        return cls(low.astype(np.float32), high.astype(np.float32))


@dataclass(frozen=True, slots=True)
class PaperState:
    """Some plants at a time.

    Attributes:
        points: shape (batch, 18), units.
        memory: the LSTM's, where it is run statefully.
    """

    points: Float32Array
    memory: LstmState | None


class PaperSimulator(Simulator[PaperState]):
    """See the module.

    Args:
        network: its weights.
        box: where its training inputs lay.
        unit_cm: the normalised unit in cm.
        step_s: the step that it was trained on; time passes in multiples of it.
        stateful: carry the LSTM's state along.
    """

    kind = "paper"

    def __init__(
        self, network: PaperNetwork, box: Box, *, unit_cm: float, step_s: float, stateful: bool = False
    ) -> None:
        self.network = network
        self.box = box
        self.unit_cm = unit_cm
        self.step_s = step_s
        self.stateful = stateful

    @classmethod
    def from_stored(cls, stored: Stored) -> PaperSimulator:
        """From a simulator folder.

        Raises:
            BadInput: weights or scales that are missing or of another shape.
        """
        rows = 4 * CELLS
        cell = LstmCell(
            stored.weight("w_ih", (rows, INPUTS)), stored.weight("w_hh", (rows, CELLS)), stored.weight("b", (rows,))
        )
        dense = Dense.of(stored.weight("out_w", (COORDINATES, CELLS)), stored.weight("out_b", (COORDINATES,)))
        low, high = (stored.weight(name, (COORDINATES,)).astype(np.float32) for name in ("box_low", "box_high"))
        where = stored.path / INFO_FILE
        stateful = stored.info.scales.get("stateful")
        if not isinstance(stateful, bool):
            raise BadInput(f"{where}: scales.stateful is {str(stateful)[:40]}, not true or false")
        unit_cm = stored.scale("unit_cm")
        if unit_cm <= 0.0:
            raise BadInput(f"{where}: scales.unit_cm is {unit_cm:g}; it must be above 0")
        network = PaperNetwork(cell, dense)
        return cls(network, Box(low, high), unit_cm=unit_cm, step_s=stored.info.step_s, stateful=stateful)

    def weights(self) -> Mapping[str, Float32Array]:
        """What goes into ``weights.safetensors``."""
        cell, dense = self.network.cell, self.network.dense
        return {
            "w_ih": cell.w_ih,
            "w_hh": cell.w_hh,
            "b": cell.b,
            "out_w": dense.w,
            "out_b": dense.b,
            "box_low": self.box.low,
            "box_high": self.box.high,
        }

    def scales(self) -> Mapping[str, Any]:
        """What goes into ``[scales]``."""
        return {"unit_cm": self.unit_cm, "stateful": self.stateful}

    def start(
        self, points_cm: FloatArray, chance: Chance | None = None, before: FloatArray | None = None
    ) -> PaperState:
        """See :meth:`Simulator.start`. Nothing happens by chance in this simulator, so ``chance`` changes nothing."""
        points = self._units(points_cm)
        return PaperState(points, self.network.cell.zero_state(len(points)) if self.stateful else None)

    def watch(self, history: History) -> PaperState:
        """See :meth:`Simulator.watch`. Without memory only the last stem counts.

        Stateful, the LSTM is shown all stems and lights in turn, its own prediction where nothing was measured.

        Raises:
            BadInput: stateful, and the history is of another step, or holds a light that is neither left nor right.
        """
        if not self.stateful:
            return self.start(history.points_cm[-1])
        if abs(history.step_s - self.step_s) > _STEP_TOLERANCE * self.step_s:
            raise BadInput(f"a history in steps of {history.step_s:g} s; this simulator knows {self.step_s:g} s only")
        state = self.start(history.points_cm[0])
        for light, points_cm in zip(history.light, history.points_cm[1:], strict=True):
            state, _ = self.step(state, light, self.step_s)
            measured = np.isfinite(points_cm).all(axis=(1, 2))
            state = replace(state, points=np.where(measured[:, None], self._units(points_cm), state.points))
        return state

    def step(
        self, state: PaperState, light: FloatArray, dt_s: float, covariates: Covariates | None = None
    ) -> tuple[PaperState, FloatArray]:
        """See :meth:`Simulator.step`.

        Raises:
            BadInput: ``dt_s`` is no multiple of ``step_s``, or not exactly one lamp is full on.
        """
        side = _boolean_light(light)
        for _ in range(self.steps_in(dt_s)):
            inputs = np.concatenate([state.points, side], axis=1)
            points, memory = self.network(inputs, state.memory)
            state = PaperState(points, memory if self.stateful else None)
        return state, self.stems_cm(state)

    def stems_cm(self, state: PaperState) -> FloatArray:
        """See :meth:`Simulator.stems_cm`."""
        stems = np.zeros((len(state.points), STEM_POINTS, 2))
        stems[:, 1:] = state.points.reshape(-1, STEM_POINTS - 1, 2).astype(np.float64) * self.unit_cm
        return stems

    def is_beyond_data(self, state: PaperState) -> BoolArray:
        """Which plants have a coordinate outside of the box of the training inputs, shape (batch,)."""
        outside = (state.points < self.box.low) | (state.points > self.box.high)
        return np.asarray(outside.any(axis=1), dtype=np.bool_)

    def steps_in(self, dt_s: float) -> int:
        """How many of its own steps make ``dt_s``.

        Raises:
            BadInput: ``dt_s`` is no multiple of ``step_s``.
        """
        steps = round(dt_s / self.step_s) if math.isfinite(dt_s) else 0
        if steps < 1 or abs(dt_s - steps * self.step_s) > _STEP_TOLERANCE * dt_s:
            raise BadInput(f"a step of {dt_s:g} s; this simulator knows multiples of {self.step_s:g} s only")
        return steps

    def _units(self, points_cm: FloatArray) -> Float32Array:
        points = np.asarray(points_cm[:, 1:] / self.unit_cm, dtype=np.float32)
        return points.reshape(-1, COORDINATES)


def _boolean_light(light: FloatArray) -> Float32Array:
    """Levels of both lamps, shape (batch, 2), as the light condition b, shape (batch, 1): 0 left, 1 right."""
    known = ((light == 0.0) | (light == 1.0)).all(axis=1) & (light.sum(axis=1) == 1.0)
    if not known.all():
        left, right = light[int(np.argmin(known))]
        raise BadInput(
            f"light levels {left:g} left and {right:g} right: this simulator was trained with either lamp full on "
            "and the other dark, and knows nothing else"
        )
    return np.asarray(light[:, 1:], dtype=np.float32)
