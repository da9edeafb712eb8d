"""The learned law: a small LSTM that says how fast a stem bends at each distance from its tip, and how fast it grows.

Every step it is told the angles of the stem at some distances from the tip, the stem's length, and the lamps; its
memory can hold what the stem does not show (what shone before, the phase of a rhythm). It says rates only. Tissue
beyond the last distance does not bend; what a stem became, it stays, and lengths never shrink.

Plants differ in traits that act round the network: how fast they grow, early and late, how fast they bend, and how far
they lean. A plant that leans farther is to the network a typical one whose angles are all smaller.

Several members, each trained without some of the plants, have memories of their own and bend one stem at the mean of
their rates. How much they disagree tells where the model does not know.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numba
import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.simulator.fast_functions import fast_exp, fast_log1p, inlined
from flora_lab.simulator.fast_lstm import MOST_CELLS, lstm_step
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.law import Stems
from flora_lab.simulator.rod import (
    CAPACITY,
    LONGEST_STEP_H,
    along,
    elongate,
    in_lanes,
    jit,
    lateness,
    length_of,
    points_lane,
    split,
    whole_registers,
)

STEP_H: Final = LONGEST_STEP_H
NODES_CM: Final = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.5, 13.5, 17.0)
"""Distances from the tip at which angles are told and rates are said; linear in between."""
FADE_CM: Final = 4.0
"""Beyond the last node the rate falls to zero over this distance."""
ANGLE_SCALE: Final = 2.0
LENGTH_MIDDLE_CM: Final = 14.0
LENGTH_SCALE_CM: Final = 8.0
RATE_PER_CM_H: Final = 0.1
"""Bending rate of soft tissue for an output of 1."""
GROWTH_CM_PER_H: Final = 0.15
GROWTH_OFFSET: Final = 1.0
"""The rate of growth is ``GROWTH_CM_PER_H * softplus(output + GROWTH_OFFSET)``: never below zero."""
TRAIT_SHARE: Final = 0.12
"""What a trait of 1 changes, as a logarithm: plants differ by 10 to 15 % in all that they do."""
BIAS_FOLD_CM: Final = 5.0
"""A bias from outside acts on tissue of the tip and e-fold less with this distance (Ohad et al.: stiffness)."""

WEIGHTS: Final = ("w_ih", "w_hh", "b", "w_out", "b_out")
INPUTS: Final = len(NODES_CM) + 1 + 2
OUTPUTS: Final = len(NODES_CM) + 1
TRAITS: Final = ("growth_early", "growth_late", "speed", "lean")

_NODES: Final = np.array(NODES_CM)
_COUNT: Final = len(NODES_CM)
_ENDS: Final = np.array((*NODES_CM[1:], NODES_CM[-1] + FADE_CM))
"""Where nodes end to count, from the tip."""
_NO_TISSUE_CM: Final = 1e-3


@inlined
def _look(length: Array, angle: Array, n: int, total_cm: float, told: Array) -> None:
    """Angles at the nodes, as means over the tissue round them, and the length."""
    d, j = 0.0, n - 1
    above_angle = above_cm = 0.0
    for k in range(_COUNT):
        # Tissue between this node and the next tells of both, the more the nearer it is.
        here_angle, here_cm = above_angle, above_cm
        above_angle = above_cm = 0.0
        end, gap = _ENDS[k], _ENDS[k] - _NODES[k]
        while j >= 0 and d + 0.5 * length[j] < end:
            share = (d + 0.5 * length[j] - _NODES[k]) / gap
            here, above = (1.0 - share) * length[j], share * length[j]
            here_angle += here * angle[j]
            here_cm += here
            above_angle += above * angle[j]
            above_cm += above
            d += length[j]
            j -= 1
        told[k] = ANGLE_SCALE * here_angle / (here_cm + _NO_TISSUE_CM)
    told[_COUNT] = (total_cm - LENGTH_MIDDLE_CM) / LENGTH_SCALE_CM


@inlined
def _bend(
    angle: Array, n: int, arc: Array, reach: Array, total_cm: float, rates: Array, bias: float, dt_h: float
) -> None:
    """Turn the segments; ``rates`` at the nodes, and behind them a zero."""
    push = scratch(np.float64, CAPACITY)
    if bias != 0.0:
        for j in range(whole_registers(n)):
            push[j] = bias * fast_exp((arc[j] - total_cm) / BIAS_FOLD_CM)
    else:
        for j in range(whole_registers(n)):
            push[j] = 0.0
    turn, k = 0.0, _COUNT - 1
    for j in range(n):
        d = total_cm - arc[j]
        while k > 0 and d < _NODES[k]:
            k -= 1
        if d < _ENDS[k]:
            share = (d - _NODES[k]) / (_ENDS[k] - _NODES[k])
            rate = (1.0 - share) * rates[k] + share * rates[k + 1]
            turn += dt_h * reach[j] * (RATE_PER_CM_H * rate + push[j])
        angle[j] += turn


@inlined
def softplus(x: float) -> float:
    """log(1 + exp(x))."""
    return float(max(x, 0.0) + fast_log1p(fast_exp(-abs(x))))


@inlined
def sense(length: Array, angle: Array, n: int, told: Array) -> None:
    """Write what a network is told of a stem: angles at the nodes, and its length."""
    _look(length, angle, n, length_of(length, n), told)


@inlined
def respond(
    length: Array,
    angle: Array,
    n: int,
    traits: Array,
    rates: Array,
    grown: float,
    members: int,
    zone_cm: float,
    bias: float,
    growth: float,
) -> int:
    """Bend and grow as the members say; returns the number of segments.

    Args:
        length, angle: of the stem's segments, changed.
        n: how many are in use.
        traits: of the plant.
        rates: sums over the members at the nodes, and behind them a zero; changed.
        grown: sum over the members.
        members: how many.
        zone_cm: that elongates.
        bias, growth: see :meth:`flora_lab.simulator.law.Law.advance`.
    """
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    speed, lean = fast_exp(TRAIT_SHARE * traits[2]), fast_exp(TRAIT_SHARE * traits[3])
    total = along(length, n, arc, reach)
    for i in range(_COUNT):
        rates[i] *= speed * lean / members
    late = lateness(total)
    vigour = fast_exp(TRAIT_SHARE * (traits[0] * (1.0 - late) + traits[1] * late))
    grown *= vigour * GROWTH_CM_PER_H * STEP_H * max(0.0, growth) / members
    _bend(angle, n, arc, reach, total, rates, bias, STEP_H)
    elongate(length, n, arc, total, zone_cm, grown)
    return int(split(length, angle, n))


@jit
def step_lane(
    length: Array,
    angle: Array,
    n: int,
    memory: Array,
    traits: Array,
    w_ih: Array,
    w_hh: Array,
    b: Array,
    w_out: Array,
    b_out: Array,
    zone_cm: float,
    left: float,
    right: float,
    bias: float,
    growth: float,
) -> int:
    """One step of five minutes of one plant, in place; returns its number of segments."""
    members = w_ih.shape[0]
    told, rates = scratch(np.float64, INPUTS), scratch(np.float64, INPUTS)
    inputs, said = scratch(np.float32, INPUTS), scratch(np.float32, OUTPUTS)
    lean = fast_exp(TRAIT_SHARE * traits[3])
    sense(length, angle, n, told)
    for i in range(_COUNT):
        inputs[i] = told[i] / lean
    inputs[_COUNT] = told[_COUNT]
    inputs[_COUNT + 1], inputs[_COUNT + 2] = left, right
    for i in range(_COUNT + 1):
        rates[i] = 0.0
    grown = 0.0
    for m in range(members):
        lstm_step(inputs, memory[m], w_ih[m], w_hh[m], b[m], w_out[m], b_out[m], said)
        for i in range(_COUNT):
            rates[i] += said[i]
        grown += softplus(said[_COUNT] + GROWTH_OFFSET)
    return respond(length, angle, n, traits, rates, grown, members, zone_cm, bias, growth)


def _lanes(
    length: Array,
    angle: Array,
    count: Array,
    memory: Array,
    traits: Array,
    w_ih: Array,
    w_hh: Array,
    b: Array,
    w_out: Array,
    b_out: Array,
    zone_cm: float,
    light: Array,
    bias: Array,
    growth: Array,
    parts: int,
    every: int,
    out: Array,
) -> None:
    """See :meth:`flora_lab.simulator.law.Law.advance`."""
    for lane in numba.prange(length.shape[0]):
        n = count[lane]
        for k in range(light.shape[0]):
            for _ in range(parts):
                n = step_lane(
                    length[lane],
                    angle[lane],
                    n,
                    memory[lane],
                    traits[lane],
                    w_ih,
                    w_hh,
                    b,
                    w_out,
                    b_out,
                    zone_cm,
                    light[k, lane, 0],
                    light[k, lane, 1],
                    bias[k, lane],
                    growth[k, lane],
                )
            if (k + 1) % every == 0:
                points_lane(length[lane], angle[lane], n, out[(k + 1) // every - 1, lane])
        count[lane] = n


_advance = in_lanes(_lanes)


class NeuralLaw:
    """The learned law.

    Args:
        weights: by the names of :data:`WEIGHTS`, float32; the first axis of each is the member.
        zone_cm: length of the zone below the tip that elongates.

    Raises:
        ValueError: shapes that do not fit one another.
        BadInput: more than :data:`MOST_CELLS` cells.
    """

    traits: Final = TRAITS

    def __init__(self, weights: Mapping[str, Array], zone_cm: float) -> None:
        self.weights = {name: np.ascontiguousarray(weights[name], dtype=np.float32) for name in WEIGHTS}
        members, hidden = self.weights["w_hh"].shape[:2]
        if hidden > MOST_CELLS:
            raise BadInput(f"a network of {hidden} cells per member; there is room for {MOST_CELLS}")
        for name, shape in weight_shapes(members, hidden).items():
            if self.weights[name].shape != shape:
                raise ValueError(f"`{name}` is {self.weights[name].shape}; expected {shape}")
        self.zone_cm = zone_cm
        self._shape = (members, 2, hidden)

    @property
    def memory_shape(self) -> tuple[int, ...]:
        """Member, h and c, cell."""
        return self._shape

    def member(self, m: int) -> NeuralLaw:
        """The law of one member alone."""
        return NeuralLaw({name: array[m : m + 1] for name, array in self.weights.items()}, self.zone_cm)

    def advance(
        self,
        stems: Stems,
        traits: Array,
        light: Array,
        bias: Array,
        growth: Array,
        step_h: float,
        every: int,
        out: Array,
    ) -> None:
        """See :meth:`flora_lab.simulator.law.Law.advance`.

        Raises:
            BadInput: a step that is no multiple of five minutes: the network knows that one only.
        """
        parts = round(step_h / STEP_H)
        if parts < 1 or abs(parts * STEP_H - step_h) > 1e-6:
            raise BadInput(f"a step of {3600.0 * step_h:g} s: the network takes multiples of {3600.0 * STEP_H:g} s")
        if traits.shape != (len(stems.count), len(TRAITS)):
            raise ValueError(f"traits of shape {traits.shape}; expected ({len(stems.count)}, {len(TRAITS)})")
        w = self.weights
        _advance(
            len(stems.count) * len(light) * parts,
            stems.length,
            stems.angle,
            stems.count,
            stems.memory,
            np.ascontiguousarray(traits, dtype=np.float64),
            w["w_ih"],
            w["w_hh"],
            w["b"],
            w["w_out"],
            w["b_out"],
            self.zone_cm,
            np.ascontiguousarray(light, dtype=np.float64),
            bias,
            growth,
            parts,
            every,
            out,
        )


def weight_shapes(members: int, hidden: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the weights."""
    return {
        "w_ih": (members, INPUTS, 4 * hidden),
        "w_hh": (members, hidden, 4 * hidden),
        "b": (members, 4 * hidden),
        "w_out": (members, hidden, OUTPUTS),
        "b_out": (members, OUTPUTS),
    }
