"""The mechanistic law: a stem senses light, gravity and its own curvature.

After Bastien et al. 2015 ("A unified model of shoot tropism in plants: photo-, gravi- and proprio-ception"), with theta
the angle from the vertical (positive to the right), kappa the curvature and d the distance from the tip:

    D(kappa)/Dt = w(d) * ( nu * S * l_n - beta * sin(theta) - gamma * kappa + b(t) )

- ``l_n`` is the part of the light's direction across the stem: the sum over the lit lamps, each falling with the square
  of its distance. S is the logarithm of its brightness (Weber-Fechner), 1 for one full lamp at the anchor; it lags
  behind the lamps by two equal stages.
- ``w(d) = exp(-d / stiffening) / (1 + exp((d - mature) / 0.8 cm))``: older tissue responds less, then not at all, and
  keeps the curvature that it had. Ohad et al.: the modulus grows e-fold in 5.0 cm (3.5-6.3) from the tip.
- ``b(t)`` is a bias that the caller gives: noise, circumnutation, or an effect under test.
- Elongation depends on the stem's length.
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

from flora_common.runs import LampsSection
from flora_lab.simulator.law import Stems
from flora_lab.simulator.rod import LONGEST_STEP_H, elongate, in_lanes, jit, lateness, length_of, points_lane, split
from flora_lab.simulator.tropism_traits import NAMES

Array = npt.NDArray[Any]

MATURE_EDGE_CM: Final = 0.8
LIGHT_HALF: Final = 0.02
"""Light, relative to one full lamp at the anchor, at which the logarithmic response sets in."""
_RESPONSE: Final = float(np.log1p(1.0 / LIGHT_HALF))
_NO_RESPONSE: Final = 1e-5

GROWTH_EARLY, GROWTH_LATE, GROWTH_ZONE, STIFFENING, MATURE, PHOTO, GRAVI, PROPRIO, LATENCY = range(9)
"""Columns of the constants; what they are stands in :mod:`flora_lab.simulator.tropism_traits`."""


@jit
def _see(seen: Array, left: float, right: float, latency_min: float, dt_h: float) -> None:
    """Two stages of delay behind the logarithm of brightness; ``seen`` is (stage, lamp)."""
    gain = -np.expm1(-dt_h * 120.0 / latency_min)
    for lamp in range(2):
        level = left if lamp == 0 else right
        seen[0, lamp] += gain * (np.log1p(level / LIGHT_HALF) / _RESPONSE - seen[0, lamp])
        seen[1, lamp] += gain * (seen[0, lamp] - seen[1, lamp])


@jit
def _light_across(x: float, y: float, sin: float, cos: float, left: float, right: float, lamps_cm: Array) -> float:
    """S * l_n at a place, for the levels that act."""
    fx = fy = 0.0
    reference2 = lamps_cm[0] ** 2 + lamps_cm[1] ** 2
    for lamp in range(2):
        level = left if lamp == 0 else right
        if level > 1e-9:
            rx = (-lamps_cm[0] if lamp == 0 else lamps_cm[0]) - x
            ry = lamps_cm[1] - y
            r2 = max(rx * rx + ry * ry, 25.0)
            share = reference2 * level / (r2 * np.sqrt(r2))
            fx += rx * share
            fy += ry * share
    size = np.sqrt(fx * fx + fy * fy)
    if size < 1e-9:
        return 0.0
    return float(np.log1p(size / LIGHT_HALF) / _RESPONSE * (fx * cos - fy * sin) / size)


@jit
def _bend(
    length: Array,
    angle: Array,
    n: int,
    total_cm: float,
    seen: Array,
    p: Array,
    lamps_cm: Array,
    bias: float,
    dt_h: float,
) -> None:
    left = LIGHT_HALF * np.expm1(seen[1, 0] * _RESPONSE)
    right = LIGHT_HALF * np.expm1(seen[1, 1] * _RESPONSE)
    x = y = arc = turn = below = below_cm = 0.0
    for j in range(n):
        sin, cos = np.sin(angle[j]), np.cos(angle[j])
        x += sin * length[j]
        y += cos * length[j]
        d = total_cm - arc
        old = angle[j]
        soft = np.exp(-d / p[STIFFENING]) / (1.0 + np.exp(min((d - p[MATURE]) / MATURE_EDGE_CM, 60.0)))
        if soft > _NO_RESPONSE:
            reach = length[j] if j == 0 else 0.5 * (length[j] + below_cm)
            stimulus = p[PHOTO] * _light_across(x, y, sin, cos, left, right, lamps_cm) - p[GRAVI] * sin + bias
            turn += soft * dt_h * (reach * stimulus - p[PROPRIO] * (old - below))
        angle[j] = old + turn
        below, below_cm = old, length[j]
        arc += length[j]


@jit
def _growth_cm_per_h(total_cm: float, p: Array) -> float:
    """Elongation of the whole stem."""
    return float((p[GROWTH_EARLY] + (p[GROWTH_LATE] - p[GROWTH_EARLY]) * lateness(total_cm)) / 24.0)


@jit
def step_lane(
    length: Array,
    angle: Array,
    n: int,
    seen: Array,
    p: Array,
    lamps_cm: Array,
    left: float,
    right: float,
    bias: float,
    growth: float,
    dt_h: float,
) -> int:
    """One step of at most :data:`LONGEST_STEP_H` of one plant, in place; returns its number of segments."""
    total = length_of(length, n)
    _see(seen, left, right, p[LATENCY], dt_h)
    _bend(length, angle, n, total, seen, p, lamps_cm, bias, dt_h)
    elongate(length, n, total, p[GROWTH_ZONE], max(0.0, growth) * _growth_cm_per_h(total, p) * dt_h)
    return int(split(length, angle, n))


def _lanes(
    length: Array,
    angle: Array,
    count: Array,
    seen: Array,
    parameters: Array,
    lamps_cm: Array,
    light: Array,
    bias: Array,
    growth: Array,
    dt_h: float,
    every: int,
    out: Array,
) -> None:
    """See :meth:`flora_lab.simulator.law.Law.advance`; ``lamps_cm`` is (distance to either side, height)."""
    parts = int(np.ceil(dt_h / LONGEST_STEP_H - 1e-9))
    for b in numba.prange(length.shape[0]):
        n = count[b]
        for k in range(light.shape[0]):
            for _ in range(parts):
                n = step_lane(
                    length[b],
                    angle[b],
                    n,
                    seen[b],
                    parameters[b],
                    lamps_cm,
                    light[k, b, 0],
                    light[k, b, 1],
                    bias[k, b],
                    growth[k, b],
                    dt_h / parts,
                )
            if (k + 1) % every == 0:
                points_lane(length[b], angle[b], n, out[(k + 1) // every - 1, b])
        count[b] = n


_advance = in_lanes(_lanes)


class TropismLaw:
    """The mechanistic law. Traits are the logarithms of the constants.

    Args:
        lamps: where they hang.
    """

    traits: Final = NAMES
    memory_shape: Final = (2, 2)
    """What is seen of the lamps: stage, lamp."""

    def __init__(self, lamps: LampsSection) -> None:
        self.lamps = lamps
        self._lamps_cm = np.array([lamps.distance_cm, lamps.height_cm])

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
        """See :meth:`flora_lab.simulator.law.Law.advance`."""
        if traits.shape != (len(stems.count), len(NAMES)):
            raise ValueError(f"traits of shape {traits.shape}; expected ({len(stems.count)}, {len(NAMES)})")
        constants = np.exp(np.ascontiguousarray(traits, dtype=np.float64))
        _advance(
            len(stems.count) * len(light),
            stems.length,
            stems.angle,
            stems.count,
            stems.memory,
            constants,
            self._lamps_cm,
            np.ascontiguousarray(light, dtype=np.float64),
            bias,
            growth,
            step_h,
            every,
            out,
        )
