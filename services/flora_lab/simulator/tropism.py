"""The mechanistic law: a stem senses light, gravity and its own curvature.

After Bastien et al. 2015 ("A unified model of shoot tropism in plants: photo-, gravi- and proprio-ception"), with theta
the angle from the vertical (positive to the right), kappa the curvature and d the distance from the tip:

    D(kappa)/Dt = w(d) * ( nu * S * l_n - beta * sin(theta) - gamma * kappa + b(t) + g(t) * (1 - 2 d / mature) )

- ``l_n`` is the part of the light's direction across the stem: the sum over the lit lamps, each falling with the square
  of its distance. S is the logarithm of its brightness (Weber-Fechner), 1 for one full lamp at the anchor; it lags
  behind the lamps by two equal stages.
- ``w(d) = exp(-d / stiffening) / (1 + exp((d - mature) / 0.8 cm))``: older tissue responds less, then not at all, and
  keeps the curvature that it had. Ohad et al.: the modulus grows e-fold in 5.0 cm (3.5-6.3) from the tip.
- ``b(t)`` is a bias that the caller gives: noise, circumnutation, or an effect under test. ``g(t)``, of the same unit,
  bends the upper half of the tissue that bends to one side and the lower half to the other; below, its factor stays -1.
- Elongation depends on the stem's length.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator.apex_signal import arrived, send
from flora_lab.simulator.fast_functions import fast_exp, fast_log1p, inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.law import Stems
from flora_lab.simulator.rod import (
    CAPACITY,
    LONGEST_STEP_H,
    along,
    directions,
    elongate,
    in_lanes,
    jit,
    lateness,
    points_lane,
    split,
    whole_registers,
)
from flora_lab.simulator.tropism_form import AS_WRITTEN, Form
from flora_lab.simulator.tropism_traits import NAMES

MATURE_EDGE_CM: Final = 0.8
LIGHT_HALF: Final = 0.02
"""Light, relative to one full lamp at the anchor, at which the logarithmic response sets in."""
_RESPONSE: Final = float(np.log1p(1.0 / LIGHT_HALF))
_NO_RESPONSE: Final = 1e-5
_DARK: Final = 1e-9
_LEAST_STRENGTH: Final = 0.05
_USUAL_LEAN_2: Final = 0.25
"""Square of the sine of 30 degrees."""
COURSE_H: Final = 72.0
"""From the early to the late rate of growth, where it follows the hours."""
_NEAREST_CM: Final = 5.0
"""A lamp gets no brighter when a stem comes nearer than that."""

GROWTH_EARLY, GROWTH_LATE, GROWTH_ZONE, STIFFENING, MATURE, PHOTO, GRAVI, PROPRIO, LATENCY = range(9)
"""Columns of the constants; what they are stands in :mod:`flora_lab.simulator.tropism_traits`."""


@inlined
def _see(seen: Array, left: float, right: float, latency_min: float, dt_h: float) -> None:
    """Two stages of delay behind the logarithm of brightness; ``seen`` is (stage, lamp)."""
    gain = 1.0 - fast_exp(-dt_h * 120.0 / latency_min)
    for lamp in range(2):
        level = left if lamp == 0 else right
        seen[0, lamp] += gain * (fast_log1p(level / LIGHT_HALF) / _RESPONSE - seen[0, lamp])
        seen[1, lamp] += gain * (seen[0, lamp] - seen[1, lamp])


@inlined
def _acting(seen: float) -> float:
    """The level of a lamp that acts, from the logarithm that is seen."""
    level = LIGHT_HALF * (fast_exp(seen * _RESPONSE) - 1.0)
    return float(level) if level > _DARK else 0.0


@inlined
def _light_across(
    x: float,
    y: float,
    sin: float,
    cos: float,
    left: float,
    right: float,
    left_pull: float,
    right_pull: float,
    form: Form,
    lamps_cm: Array,
) -> float:
    """S * l_n at a place, for the levels that act; each lamp's part of it times its pull."""
    near = 1.0 - form.even_light
    up = lamps_cm[1] - near * y
    to_left, to_right = -lamps_cm[0] - near * x, lamps_cm[0] - near * x
    left_2 = max(to_left * to_left + up * up, _NEAREST_CM**2)
    right_2 = max(to_right * to_right + up * up, _NEAREST_CM**2)
    left_3, right_3 = left_2 * np.sqrt(left_2), right_2 * np.sqrt(right_2)
    # The light times the cubes of both distances: they fall out of its direction.
    by_left, by_right = left * right_3, right * left_3
    fx, fy = to_left * by_left + to_right * by_right, up * (by_left + by_right)
    size = np.sqrt(fx * fx + fy * fy)
    by_left, by_right = left_pull * by_left, right_pull * by_right
    pull_x, pull_y = to_left * by_left + to_right * by_right, up * (by_left + by_right)
    brightness = (lamps_cm[0] ** 2 + lamps_cm[1] ** 2) * size / (left_3 * right_3)
    strength = fast_log1p(brightness / LIGHT_HALF) / _RESPONSE
    strength *= max(1.0 + form.brightness_more * _RESPONSE * (strength - 1.0), _LEAST_STRENGTH)
    on_the_stem = pull_x * cos - pull_y * sin
    across = strength * (on_the_stem + form.side_alone * (pull_x - on_the_stem)) / size
    return 0.0 if brightness < _DARK else float(across)


@jit
def _growth_cm_per_h(total_cm: float, time_h: float, p: Array, form: Form) -> float:
    """Elongation of the whole stem."""
    late = lateness(total_cm)
    if form.by_hours != 0.0:
        late += form.by_hours * (min(time_h / COURSE_H, 1.0) - late)
    linear = p[GROWTH_EARLY] + (p[GROWTH_LATE] - p[GROWTH_EARLY]) * late
    return float(linear * (1.0 + 4.0 * form.spurt_more * late * (1.0 - late)) / 24.0)


@jit
def _quickness(growth_cm_per_h: float, p: Array) -> float:
    """How many times faster than usual a stem grows."""
    return float(growth_cm_per_h * 48.0 / (p[GROWTH_EARLY] + p[GROWTH_LATE]))


@inlined
def _bend(
    length: Array,
    angle: Array,
    n: int,
    arc: Array,
    reach: Array,
    total_cm: float,
    longer: float,
    seen: Array,
    sent: Array,
    told_h: float,
    p: Array,
    lamps_cm: Array,
    left_pull: float,
    right_pull: float,
    bias: float,
    gradient: float,
    sideways: float,
    form: Form,
    dt_h: float,
) -> None:
    sin, cos = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    x, y = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    soft, pull = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    left, right = _acting(seen[1, 0]), _acting(seen[1, 1])
    directions(length, angle, n, sin, cos, x, y)
    edge_cm = MATURE_EDGE_CM if form.edge_more == 0.0 else MATURE_EDGE_CM * fast_exp(form.edge_more)
    shorter = 1.0 / longer
    for j in range(whole_registers(n)):
        d = (total_cm - arc[j]) * shorter
        share = fast_exp(-d / p[STIFFENING]) / (1.0 + fast_exp((d - p[MATURE]) / edge_cm))
        soft[j] = share * dt_h if share > _NO_RESPONSE else 0.0
    by_apex = scratch(np.float64, CAPACITY)
    at_apex = 0.0
    if form.apical != 0.0:
        a = n - 1
        at_apex = form.apical * _light_across(
            x[a], y[a], sin[a], cos[a], left, right, left_pull, right_pull, form, lamps_cm
        )
    if form.signal_h_per_cm == 0.0:
        for j in range(whole_registers(n)):
            by_apex[j] = at_apex
    else:
        at = send(sent, at_apex, told_h)
        for j in range(whole_registers(n)):
            by_apex[j] = arrived(sent, at, max(total_cm - arc[j], 0.0) * form.signal_h_per_cm)
    for j in range(whole_registers(n)):
        light = _light_across(x[j], y[j], sin[j], cos[j], left, right, left_pull, right_pull, form, lamps_cm)
        light = (1.0 - form.apical) * light + by_apex[j]
        weight = p[GRAVI] * sin[j] * (1.0 + form.lean_more * (sin[j] * sin[j] - _USUAL_LEAN_2))
        higher = max(1.0 - 2.0 * (total_cm - arc[j]) / p[MATURE], -1.0)
        stimulus = p[PHOTO] * light - weight + (bias + gradient * higher) + sideways * cos[j]
        pull[j] = reach[j] * stimulus
    turn = below = 0.0
    for j in range(n):
        old = angle[j]
        turn += soft[j] * (pull[j] - p[PROPRIO] * (old - below))
        angle[j] = old + turn
        below = old


@inlined
def driven_step_lane(
    length: Array,
    angle: Array,
    n: int,
    seen: Array,
    sent: Array,
    told_h: float,
    p: Array,
    lamps_cm: Array,
    left: float,
    right: float,
    left_pull: float,
    right_pull: float,
    bias: float,
    gradient: float,
    sideways: float,
    growth: float,
    activity: float,
    time_h: float,
    form: Form,
    dt_h: float,
) -> None:
    """As :func:`step_lane`; the pull of each lamp, the rate of all bending and the form of the law can be others,
    the bias differ along the stem, and something push it ``sideways``, 1/(cm h), of which what is across it acts;
    ``time_h`` is that since the start of the run. ``sent`` is of shape
    :data:`flora_lab.simulator.apex_signal.SENT`, and has been told of ``told_h``.

    Long segments are left whole: whoever takes the step cuts them, see :func:`flora_lab.simulator.rod.split`.
    """
    arc, reach = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    total = along(length, n, arc, reach)
    _see(seen, left, right, p[LATENCY], dt_h)
    bend_h = dt_h * activity
    growth_cm_per_h = _growth_cm_per_h(total, time_h, p, form)
    longer = 1.0 if form.by_age == 0.0 else _quickness(growth_cm_per_h, p) ** form.by_age
    _bend(
        length,
        angle,
        n,
        arc,
        reach,
        total,
        longer,
        seen,
        sent,
        told_h,
        p,
        lamps_cm,
        left_pull,
        right_pull,
        bias,
        gradient,
        sideways,
        form,
        bend_h,
    )
    elongate(length, n, arc, total, longer * p[GROWTH_ZONE], max(0.0, growth) * growth_cm_per_h * dt_h)


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
    driven_step_lane(
        length,
        angle,
        n,
        seen,
        seen,
        0.0,
        p,
        lamps_cm,
        left,
        right,
        1.0,
        1.0,
        bias,
        0.0,
        0.0,
        growth,
        1.0,
        0.0,
        AS_WRITTEN,
        dt_h,
    )
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
    memory_shape: tuple[int, ...] = (2, 2)
    """What is seen of the lamps: stage, lamp."""

    def __init__(self, lamps: LampsSection) -> None:
        self.lamps = lamps
        self.lamps_cm = np.array([lamps.distance_cm, lamps.height_cm])

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
        self.check_traits(stems, traits)
        constants = np.exp(np.ascontiguousarray(traits, dtype=np.float64))
        _advance(
            len(stems.count) * len(light),
            stems.length,
            stems.angle,
            stems.count,
            stems.memory,
            constants,
            self.lamps_cm,
            np.ascontiguousarray(light, dtype=np.float64),
            bias,
            growth,
            step_h,
            every,
            out,
        )

    @staticmethod
    def check_traits(stems: Stems, traits: Array) -> None:
        """Whether there are as many traits as plants; raises ValueError."""
        if traits.shape != (len(stems.count), len(NAMES)):
            raise ValueError(f"traits of shape {traits.shape}; expected ({len(stems.count)}, {len(NAMES)})")
