"""Terms that a simulated plant lacks until something is found: what they do to a step of the mechanistic law, compiled.

Every term has a value at which it does nothing (:data:`NEUTRAL`), so that one loop serves every combination of them.
What is found about real plants is put into words and ranges in :mod:`flora_lab.effects`; here is what it means for a
step:

- the light comes later, by a pure delay (``DELAY_H``) of at most two hours;
- a lamp's pull is a factor on what it does to the stem, not on its brightness, whose logarithm hardly feels a factor:
  ``RIGHT_TO_LEFT`` for the right lamp; both lose ``AGEING_PER_H`` of it per hour; while a lamp is on, its pull falls by
  up to ``ADAPTATION``, with ``ADAPTATION_H`` as time constant, and comes back with the same one while it is off;
- a steady ``PUSH`` to the right, 1/(cm h), beside the law's other stimuli, or one ``SIDEWAYS``, which does the less the
  more the stem lies in its direction;
- growth follows a rhythm of ``DIURNAL`` about its mean that is highest ``PEAK_H`` after the start, and is
  ``exp(PER_DEGREE)`` times as fast with each degree. Bending follows growth to the power of ``ACTIVITY``: 0 where it
  does not care, 1 where both are one activity, as in Bastien et al. 2015;
- the stem sags: weight above a joint, about ``SAG`` per cm^3 of softness at the tip, which falls e-fold within
  ``SOFTNESS_CM``, bends it elastically, with ``SETTLING_H`` as time constant, and the stem feels that bend as any
  other; a ``WIND`` to the right, in the same unit, does the same, pushing as hard on each cm as weight pulls;
- the law itself may be of another form, see :class:`flora_lab.simulator.tropism_form.Form`: ``BRIGHTNESS_MORE``,
  ``LEAN_MORE``, ``EDGE_MORE``, ``SPURT_MORE``, ``SIDE_ALONE``, ``EVEN_LIGHT``, ``APICAL``, ``BY_AGE``,
  ``BY_HOURS``, ``SIGNAL_H_PER_CM``;
- a stem that leans towards a camera, or from it, looks longer: by a share of ``NEARER`` at the length of 22 cm, and
  not at all up to that of 6.5 cm.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numba
import numpy as np

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.simulator import sag
from flora_lab.simulator.apex_signal import SENT
from flora_lab.simulator.fast_functions import fast_exp, fast_log1p, inlined
from flora_lab.simulator.fast_scratch import scratch
from flora_lab.simulator.law import Stems
from flora_lab.simulator.rod import CAPACITY, EARLY_CM, LATE_CM, LONGEST_STEP_H, in_lanes, jit, points_lane, split
from flora_lab.simulator.tropism import LIGHT_HALF, TropismLaw, driven_step_lane
from flora_lab.simulator.tropism_form import Form

DELAY_H, RIGHT_TO_LEFT, AGEING_PER_H, ADAPTATION, ADAPTATION_H, PUSH = range(6)
DIURNAL, PEAK_H, PER_DEGREE, ACTIVITY, SAG = range(6, 11)
BRIGHTNESS_MORE, LEAN_MORE, EDGE_MORE, SPURT_MORE, NEARER, SIDEWAYS, SIDE_ALONE, EVEN_LIGHT = range(11, 19)
SOFTNESS_CM, SETTLING_H, WIND, APICAL, BY_AGE, BY_HOURS, SIGNAL_H_PER_CM = range(19, 26)
"""Columns of the terms."""
TERMS: Final = 26
NEUTRAL: Final = np.array([0.0, 1.0, 0.0, 0.0, 2.0, *np.zeros(14), sag.SOFTNESS_CM, sag.SETTLING_H, *np.zeros(5)])
"""Values at which nothing is changed, shape (26,)."""
NEUTRAL.flags.writeable = False

LONGEST_DELAY_H: Final = 2.0
_SLOTS: Final = 25
"""Five minutes each in the longest delay, and one that is being written."""
_ADAPTED, _CLOCK, _LINE, _BENT = 2, 3, 4, 4 + _SLOTS
_SENT: Final = _BENT + sag.BENT[0]
"""Rows of the memory, after what is seen of the lamps: how far each lamp is adapted to; hours since the start, and
hours of which the delay line was told; the delay line, one row of lamp levels per five minutes; bends under weight;
signals of the apex."""
MEMORY: Final = (_SENT + SENT[0], 2)

_DAY_H: Final = 24.0
_LIT: Final = 1e-6
_ROUNDING: Final = 1e-9
"""Parts of five minutes that sums of steps may be off."""
_LEAST_GROWTH: Final = 0.02


@inlined
def _between(before: float, after: float, share: float) -> float:
    """The level that is seen as much as the mean of two, of which the later one lasts for a share of the time."""
    if before == after:
        return before
    seen = (1.0 - share) * fast_log1p(before / LIGHT_HALF) + share * fast_log1p(after / LIGHT_HALF)
    return float(LIGHT_HALF * (fast_exp(seen) - 1.0))


@inlined
def _delayed(memory: Array, left: float, right: float, delay_h: float, dt_h: float) -> tuple[float, float]:
    """The levels over this step as they were ``delay_h`` ago, by the mean of what is seen of them; the step's own ones
    are noted.

    Before the first step that it is told of, the lamps are taken to have been as they were in it. Of several steps in
    five minutes the last is noted, so that a change of light within them may act that much too early.
    """
    told_h = memory[_CLOCK, 1]
    if told_h == 0.0:
        for slot in range(_SLOTS):
            memory[_LINE + slot, 0], memory[_LINE + slot, 1] = left, right
    slots = told_h / LONGEST_STEP_H
    at = int(slots + _ROUNDING)
    memory[_LINE + at % _SLOTS, 0], memory[_LINE + at % _SLOTS, 1] = left, right
    memory[_CLOCK, 1] = told_h + dt_h
    if delay_h <= 0.0:
        return left, right
    begin, width = slots - at - min(delay_h, LONGEST_DELAY_H) / LONGEST_STEP_H, dt_h / LONGEST_STEP_H
    far = int(np.floor(begin + _ROUNDING))
    share = min(max((begin + width - far - 1.0) / width, 0.0), 1.0)
    near, far = _LINE + (at + min(far + 1, 0)) % _SLOTS, _LINE + (at + min(far, 0)) % _SLOTS
    return (
        _between(memory[far, 0], memory[near, 0], share),
        _between(memory[far, 1], memory[near, 1], share),
    )


@inlined
def _pull(memory: Array, lamp: int, level: float, t: Array, dt_h: float) -> float:
    """What is left of a lamp's pull after ageing and adaptation."""
    gain = 1.0 - fast_exp(-dt_h / t[ADAPTATION_H])
    wanted = 1.0 if level > _LIT else 0.0
    memory[_ADAPTED, lamp] += gain * (wanted - memory[_ADAPTED, lamp])
    aged = max(0.0, 1.0 - t[AGEING_PER_H] * memory[_CLOCK, 0])
    own = t[RIGHT_TO_LEFT] if lamp == 1 else 1.0
    return float(own * aged * (1.0 - t[ADAPTATION] * memory[_ADAPTED, lamp]))


@inlined
def _growth_factor(time_h: float, warmth_c: float, t: Array) -> float:
    rhythm = 1.0 + t[DIURNAL] * np.cos(2.0 * np.pi * (time_h - t[PEAK_H]) / _DAY_H)
    return float(max(_LEAST_GROWTH, rhythm * fast_exp(t[PER_DEGREE] * warmth_c)))


@jit
def extended_step_lane(
    length: Array,
    angle: Array,
    n: int,
    memory: Array,
    p: Array,
    t: Array,
    lamps_cm: Array,
    left: float,
    right: float,
    bias: float,
    gradient: float,
    growth: float,
    gain: float,
    warmth_c: float,
    dt_h: float,
) -> int:
    """One step of at most :data:`LONGEST_STEP_H` of one plant, in place; returns its number of segments.

    Args:
        length, angle, n, p, lamps_cm, left, right, bias, growth, dt_h: see
            :func:`flora_lab.simulator.tropism.step_lane`.
        memory: shape :data:`MEMORY`.
        t: the terms, shape (26,).
        gradient: see :mod:`flora_lab.simulator.tropism`, 1/(cm h).
        gain: factor on the pull of both lamps.
        warmth_c: how much warmer it is than in the runs that the simulator was learned from, degrees Celsius.
    """
    time_h, told_h = memory[_CLOCK, 0], memory[_CLOCK, 1]
    left_late, right_late = _delayed(memory, left, right, t[DELAY_H], dt_h)
    left_pull, right_pull = _pull(memory, 0, left_late, t, dt_h), _pull(memory, 1, right_late, t, dt_h)
    factor = _growth_factor(time_h, warmth_c, t)
    activity = 1.0 if t[ACTIVITY] == 0.0 else float(factor ** t[ACTIVITY])
    memory[_CLOCK, 0] = time_h + dt_h
    elastic = scratch(np.float64, CAPACITY)
    is_loaded = t[SAG] != 0.0 or t[WIND] != 0.0
    if is_loaded:
        sag.recall(length, angle, n, t[SAG], t[WIND], t[SOFTNESS_CM], memory[_BENT:_SENT], elastic)
    driven_step_lane(
        length,
        angle,
        n,
        memory,
        memory[_SENT:],
        told_h,
        p,
        lamps_cm,
        left_late,
        right_late,
        gain * left_pull,
        gain * right_pull,
        bias + t[PUSH],
        gradient,
        t[SIDEWAYS],
        growth * factor,
        activity,
        time_h,
        Form(
            t[BRIGHTNESS_MORE],
            t[LEAN_MORE],
            t[EDGE_MORE],
            t[SPURT_MORE],
            t[SIDE_ALONE],
            t[EVEN_LIGHT],
            t[APICAL],
            t[BY_AGE],
            t[BY_HOURS],
            t[SIGNAL_H_PER_CM],
        ),
        dt_h,
    )
    if not is_loaded:
        return int(split(length, angle, n))
    sag.settle(length, angle, n, t[SAG], t[WIND], t[SOFTNESS_CM], t[SETTLING_H], dt_h, elastic)
    return int(sag.split_and_remember(length, angle, n, elastic, memory[_BENT:_SENT]))


@jit
def _told(length: Array, angle: Array, n: int, turn_rad: float, scale: float, nearer: float, out: Array) -> None:
    """Ten points as a camera shows them that is rolled, takes a centimetre for ``scale`` of them, and to which the stem
    leans."""
    if turn_rad == 0.0 and scale == 1.0 and nearer == 0.0:
        points_lane(length, angle, n, out)
        return
    shown_length, shown_angle = scratch(np.float64, CAPACITY), scratch(np.float64, CAPACITY)
    arc = 0.0
    for j in range(n):
        high = max(0.0, (arc + 0.5 * length[j] - EARLY_CM) / (LATE_CM - EARLY_CM))
        arc += length[j]
        shown_length[j], shown_angle[j] = scale * length[j] * (1.0 + nearer * high), angle[j] + turn_rad
    points_lane(shown_length, shown_angle, n, out)


def _lanes(
    length: Array,
    angle: Array,
    count: Array,
    memory: Array,
    parameters: Array,
    terms: Array,
    lamps_cm: Array,
    light: Array,
    bias: Array,
    gradient: Array,
    growth: Array,
    gain: Array,
    warmth_c: Array,
    turn_rad: Array,
    scale: Array,
    dt_h: float,
    every: int,
    out: Array,
) -> None:
    parts = int(np.ceil(dt_h / LONGEST_STEP_H - 1e-9))
    for b in numba.prange(length.shape[0]):
        n = count[b]
        for k in range(light.shape[0]):
            for _ in range(parts):
                n = extended_step_lane(
                    length[b],
                    angle[b],
                    n,
                    memory[b],
                    parameters[b],
                    terms[b],
                    lamps_cm,
                    light[k, b, 0],
                    light[k, b, 1],
                    bias[k, b],
                    gradient[k, b],
                    growth[k, b],
                    gain[k, b],
                    warmth_c[k, b],
                    dt_h / parts,
                )
            if (k + 1) % every == 0:
                row = (k + 1) // every - 1
                _told(length[b], angle[b], n, turn_rad[row, b], scale[b], terms[b, NEARER], out[row, b])
        count[b] = n


_advance = in_lanes(_lanes)


class Driven(NamedTuple):
    """What acts on a batch of plants while it is advanced.

    Attributes:
        light: levels of the left and right lamp, shape (steps, batch, 2).
        bias: of bending, 1/(cm h), shape (steps, batch).
        gradient: of that along the stem, see :mod:`flora_lab.simulator.tropism`, 1/(cm h), shape (steps, batch).
        growth: factor on the rate of growth, shape (steps, batch).
        gain: factor on the pull of both lamps, shape (steps, batch).
        warmth_c: see :func:`extended_step_lane`, shape (steps,), or (steps, batch) where plants differ in it.
    """

    light: Array
    bias: Array
    gradient: Array
    growth: Array
    gain: Array
    warmth_c: Array


def undriven(light: Array, warmth_c: Array) -> Driven:
    """Nothing but lamps, shape (steps, batch, 2), and warmth, see :class:`Driven`, acts."""
    still, usual = np.zeros(light.shape[:2]), np.ones(light.shape[:2])
    return Driven(light, still, still, usual, usual, warmth_c)


class Seen(NamedTuple):
    """How a camera shows a batch of plants.

    Attributes:
        turn_rad: of the picture about the anchor, positive to the right, shape (rows told, batch).
        scale: centimetres that it takes one for, shape (batch,).
    """

    turn_rad: Array
    scale: Array


class ExtendedLaw(TropismLaw):
    """The mechanistic law with terms.

    Args:
        lamps: where they hang.
        terms: shape (26,).
        warmth_c: see :func:`extended_step_lane`, from the first step on; shape (steps, batch), or (steps, 1). Without
            it, it is as warm as in the runs that the simulator was learned from.
    """

    memory_shape = MEMORY

    def __init__(self, lamps: LampsSection, terms: Array = NEUTRAL, warmth_c: Array | None = None) -> None:
        super().__init__(lamps)
        self.terms = np.array(terms, dtype=np.float64)
        self._warmth_c = warmth_c

    def when(self, warmth_c: Array) -> ExtendedLaw:
        """The same law where it is so warm, see the class."""
        return ExtendedLaw(self.lamps, self.terms, warmth_c)

    @staticmethod
    def at_start(memory: Array) -> Array:
        """What plants remember, shape (batch, ...), if their run starts only now: the clock reads 0."""
        started = memory.copy()
        started[:, _CLOCK, 0] = 0.0
        return started

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
        steps, batch = bias.shape
        warmth_c = np.zeros(steps) if self._warmth_c is None else self._warmth_c[:steps]
        driven = undriven(light, warmth_c)._replace(bias=bias, growth=growth)
        terms = np.repeat(self.terms[None], batch, axis=0)
        seen = Seen(np.zeros((len(out), batch)), np.ones(batch))
        self.advance_with(stems, traits, terms, driven, seen, step_h, every, out)

    def advance_with(
        self,
        stems: Stems,
        traits: Array,
        terms: Array,
        driven: Driven,
        seen: Seen,
        step_h: float,
        every: int,
        out: Array,
    ) -> None:
        """As :meth:`advance`, each plant with terms of its own.

        Args:
            stems, traits, step_h, every, out: see :meth:`flora_lab.simulator.law.Law.advance`.
            terms: shape (batch, 26).
            driven: what acts on them.
            seen: how they are shown in ``out``.
        """
        self.check_traits(stems, traits)
        warmth_c = driven.warmth_c if driven.warmth_c.ndim == 2 else driven.warmth_c[:, None]
        _advance(
            len(stems.count) * len(driven.light),
            stems.length,
            stems.angle,
            stems.count,
            stems.memory,
            np.exp(np.ascontiguousarray(traits, dtype=np.float64)),
            np.ascontiguousarray(terms, dtype=np.float64),
            self.lamps_cm,
            np.ascontiguousarray(driven.light, dtype=np.float64),
            driven.bias,
            driven.gradient,
            driven.growth,
            driven.gain,
            np.ascontiguousarray(np.broadcast_to(warmth_c, driven.bias.shape), dtype=np.float64),
            seen.turn_rad,
            seen.scale,
            step_h,
            every,
            out,
        )
