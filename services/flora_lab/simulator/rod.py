"""A growing, bending rod in the picture plane: the arithmetic of one step, compiled, one plant per lane.

After Bastien et al. 2015 ("A unified model of shoot tropism in plants: photo-, gravi- and proprio-ception"), with theta
the angle from the vertical (positive to the right), kappa the curvature and d the distance from the tip:

    D(kappa)/Dt = w(d) * ( nu * S * l_n - beta * sin(theta) - gamma * kappa + b(t) )

- ``l_n`` is the part of the light's direction across the stem: the sum over the lit lamps, each falling with the square
  of its distance. S is the logarithm of its brightness (Weber-Fechner), 1 for one full lamp at the anchor; it lags
  behind the lamps by two equal stages.
- ``w(d) = exp(-d / stiffening) / (1 + exp((d - mature) / 0.8 cm))``: older tissue responds less, then not at all, and
  keeps the curvature that it had. Ohad et al.: the modulus grows e-fold in 5.0 cm (3.5-6.3) from the tip.
- ``b(t)`` is a bias that the caller gives: noise, circumnutation, or an effect under test.
- Segments elongate in a zone below the tip; the rate depends on the stem's length.

The stem is a chain of straight segments. The bend of a joint turns everything above it. Segments that have grown long
are split in two. Lanes do not influence each other, and no result depends on the number of threads.
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

CAPACITY: Final = 96
"""Segments that a lane has room for; when they are used up, segments grow longer instead of being split."""
LONG_SEGMENT_CM: Final = 0.7
MATURE_EDGE_CM: Final = 0.8
ZONE_EDGE_CM: Final = 0.5
LIGHT_HALF: Final = 0.02
"""Light, relative to one full lamp at the anchor, at which the logarithmic response sets in."""
EARLY_CM: Final = 6.5
LATE_CM: Final = 22.0
"""Stem lengths at which the two rates of growth hold; between them the rate is linear, beyond them constant. Wahby et
al. 2018: first and last heights of a run."""
LONGEST_STEP_H: Final = 300.0 / 3600.0
_RESPONSE: Final = float(np.log1p(1.0 / LIGHT_HALF))
_NO_RESPONSE: Final = 1e-5

GROWTH_EARLY, GROWTH_LATE, GROWTH_ZONE, STIFFENING, MATURE, PHOTO, GRAVI, PROPRIO, LATENCY = range(9)
"""Columns of the parameters; what they are stands in :mod:`flora_lab.simulator.rod_parameters`."""

_jit = numba.njit(cache=True, error_model="numpy", nogil=True)


@_jit
def _see(seen: Array, left: float, right: float, latency_min: float, dt_h: float) -> None:
    """Two stages of delay behind the logarithm of brightness; ``seen`` is (stage, lamp)."""
    gain = -np.expm1(-dt_h * 120.0 / latency_min)
    for lamp in range(2):
        level = left if lamp == 0 else right
        seen[0, lamp] += gain * (np.log1p(level / LIGHT_HALF) / _RESPONSE - seen[0, lamp])
        seen[1, lamp] += gain * (seen[0, lamp] - seen[1, lamp])


@_jit
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


@_jit
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


@_jit
def growth_cm_per_h(total_cm: float, p: Array) -> float:
    """Elongation of the whole stem."""
    share = min(max((total_cm - EARLY_CM) / (LATE_CM - EARLY_CM), 0.0), 1.0)
    return float((p[GROWTH_EARLY] + (p[GROWTH_LATE] - p[GROWTH_EARLY]) * share) / 24.0)


@_jit
def _elongate(length: Array, n: int, total_cm: float, zone_cm: float, grown_cm: float) -> None:
    below_tip = total_cm
    whole = 0.0
    for j in range(n):
        middle = below_tip - 0.5 * length[j]
        whole += length[j] / (1.0 + np.exp(min((middle - zone_cm) / ZONE_EDGE_CM, 60.0)))
        below_tip -= length[j]
    below_tip = total_cm
    for j in range(n):
        old = length[j]
        share = old / (1.0 + np.exp(min((below_tip - 0.5 * old - zone_cm) / ZONE_EDGE_CM, 60.0)))
        length[j] = old + grown_cm * share / whole
        below_tip -= old


@_jit
def _split(length: Array, angle: Array, n: int) -> int:
    j = 0
    while j < n:
        if length[j] > LONG_SEGMENT_CM and n < length.shape[0]:
            for k in range(n, j, -1):
                length[k], angle[k] = length[k - 1], angle[k - 1]
            length[j] *= 0.5
            length[j + 1] = length[j]
            n += 1
            j += 1
        j += 1
    return n


@_jit
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
    total = 0.0
    for j in range(n):
        total += length[j]
    _see(seen, left, right, p[LATENCY], dt_h)
    _bend(length, angle, n, total, seen, p, lamps_cm, bias, dt_h)
    _elongate(length, n, total, p[GROWTH_ZONE], max(0.0, growth) * growth_cm_per_h(total, p) * dt_h)
    return int(_split(length, angle, n))


@_jit
def points_lane(length: Array, angle: Array, n: int, out: Array) -> None:
    """Ten points at even heights from anchor to tip; the convention of ``geometry.resample_by_height``."""
    xs, ys = np.zeros(n + 1), np.zeros(n + 1)
    for j in range(n):
        xs[j + 1] = xs[j] + np.sin(angle[j]) * length[j]
        ys[j + 1] = ys[j] + np.cos(angle[j]) * length[j]
    count = out.shape[0]
    out[0, 0] = out[0, 1] = 0.0
    out[count - 1, 0], out[count - 1, 1] = xs[n], ys[n]
    for i in range(1, count - 1):
        height = ys[n] * i / (count - 1)
        out[i, 1] = height
        nearest, gap = 0, np.inf
        found = False
        for k in range(n):
            low, high = ys[k] - height, ys[k + 1] - height
            if (low <= 0.0 < high) or (low >= 0.0 > high):
                out[i, 0] = xs[k] + low / (low - high) * (xs[k + 1] - xs[k])
                found = True
                break
            if abs(low) < gap:
                nearest, gap = k, abs(low)
        if not found:
            out[i, 0] = xs[nearest]


@numba.njit(cache=True, error_model="numpy", parallel=True)
def advance(
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
    """Many steps of many plants, in place.

    Args:
        length, angle: shape (batch, CAPACITY), cm and rad from the vertical.
        count: shape (batch,), segments in use.
        seen: shape (batch, 2, 2): stage, lamp.
        parameters: shape (batch, 9).
        lamps_cm: shape (batch, 2): distance of either lamp to the side, height; relative to the anchor.
        light: shape (steps, batch, 2), levels from 0.
        bias: shape (steps, batch), 1/(cm h).
        growth: shape (steps, batch), factor on the rate of growth.
        dt_h: length of a step in hours; halved until it is short enough.
        every: stems are told after every so many steps.
        out: shape (steps // every, batch, 10, 2), written.
    """
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
                    lamps_cm[b],
                    light[k, b, 0],
                    light[k, b, 1],
                    bias[k, b],
                    growth[k, b],
                    dt_h / parts,
                )
            if (k + 1) % every == 0:
                points_lane(length[b], angle[b], n, out[(k + 1) // every - 1, b])
        count[b] = n
