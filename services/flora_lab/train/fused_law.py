"""The learned law run free as one compiled loop: every window's loss, and on request its gradient.

:mod:`flora_lab.train.sequence_net` is the same in a readable form, and tests hold the two together; it also serves
where there is an accelerator. On networks as small as these nearly all of a library's time goes into calling it.

Windows do not influence each other. Some of them at a time (``ROWS``) go through all their steps and back, so that what
the way back needs stays in the processor's cache. Windows of weight zero (plants that a member must not learn from, or
is not judged by) are left out.

Three things are written otherwise than in the readable form, and mean the same: the bends of the joints are summed
along the stem once per refresh instead of at each step, the length of a stem is carried along, and the gradient of the
distances is taken where they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.neural_law import GROWTH_OFFSET, INPUTS, LENGTH_MIDDLE_CM, LENGTH_SCALE_CM, OUTPUTS
from flora_lab.simulator.rod import jit
from flora_lab.train.fused_law_parts import (
    HALF,
    NODES,
    ONE,
    WIDE,
    ZERO,
    activate,
    add_at_segments,
    add_product,
    at_nodes,
    cell,
    cell_back,
    distances,
    f,
    refresh,
)
from flora_lab.train.windows import REFRESH, SEGMENTS, Windows

ROWS: Final = 18
"""Windows that go through all steps together."""


_MIDDLE, _PER_LENGTH = f(LENGTH_MIDDLE_CM), f(1.0 / LENGTH_SCALE_CM)
_OFFSET = f(GROWTH_OFFSET)
_LENGTH, _LAMPS = NODES, NODES + 1


@dataclass(frozen=True, slots=True)
class Gradient:
    """Of the weighted sum of the losses; ``factors`` has shape (members, windows, 3)."""

    w_ih: Array
    w_hh: Array
    b: Array
    w_out: Array
    b_out: Array
    log_zone: Array
    factors: Array


@dataclass(frozen=True, slots=True)
class Weights:
    """Of the members, as in :class:`flora_lab.train.sequence_net.LawNet`, float32."""

    w_ih: Array
    w_hh: Array
    b: Array
    w_out: Array
    b_out: Array
    log_zone: Array


def losses(weights: Weights, factors: Array, windows: Windows, weight: Array) -> Array:
    """Mean loss of each window.

    Args:
        weights: the members.
        factors: of the plants, shape (members, windows, 3), float32: of the growth in a step (cm), of the angles that
            are told, of the bending rates.
        windows: where from, and what the plants did.
        weight: shape (members, windows); where it is zero nothing is run, and the loss is 0.

    Returns:
        Shape (members, windows), float32.
    """
    return _all_members(weights, factors, windows, weight, learn=False)[0]


def losses_and_gradient(weights: Weights, factors: Array, windows: Windows, weight: Array) -> tuple[Array, Gradient]:
    """As :func:`losses`; and the gradient of the sum of ``weight`` times the losses."""
    return _all_members(weights, factors, windows, weight, learn=True)


def _all_members(
    weights: Weights, factors: Array, windows: Windows, weight: Array, *, learn: bool
) -> tuple[Array, Gradient]:
    members, count = factors.shape[:2]
    loss = np.zeros((members, count), dtype=np.float32)
    both = np.concatenate([weights.w_ih, weights.w_hh], axis=1)
    d_both, d_b, d_out = np.zeros_like(both), np.zeros_like(weights.b), np.zeros_like(weights.w_out)
    d_b_out, d_zone = np.zeros_like(weights.b_out), np.zeros(members, dtype=np.float32)
    d_factors = np.zeros(factors.shape, dtype=np.float32)
    _run(
        both,
        weights.b,
        weights.w_out,
        weights.b_out,
        weights.log_zone,
        factors,
        np.asarray(weight, dtype=np.float32),
        windows.length,
        windows.angle,
        windows.light,
        windows.line_cm,
        windows.line_length_cm,
        windows.known,
        windows.near_cm,
        windows.near_length_cm,
        np.float32(windows.length_weight),
        windows.every,
        learn,
        loss,
        d_both,
        d_b,
        d_out,
        d_b_out,
        d_zone,
        d_factors,
    )
    return loss, Gradient(d_both[:, :INPUTS].copy(), d_both[:, INPUTS:].copy(), d_b, d_out, d_b_out, d_zone, d_factors)


@jit
def _run(  # type: ignore[no-untyped-def]
    both,
    b,
    w_out,
    b_out,
    log_zone,
    factors,
    weight,
    lengths,
    angles,
    light,
    lines,
    line_lengths,
    known,
    near,
    near_length,
    length_weight,
    every,
    learn,
    loss,
    d_both,
    d_b,
    d_out,
    d_b_out,
    d_zone,
    d_factors,
):
    """Losses of all members, and the gradient."""
    steps, hidden = len(light), w_out.shape[1]
    wide, depth, tellings = INPUTS + hidden, steps if learn else 1, lines.shape[1]
    factor, offset = np.full(4 * hidden, HALF), np.full(4 * hidden, HALF)
    factor[2 * hidden : 3 * hidden], offset[2 * hidden : 3 * hidden] = ONE, ZERO
    seen = np.empty(((depth + 1) * ROWS, wide), dtype=np.float32)
    gates = np.empty((depth * ROWS, 4 * hidden), dtype=np.float32)
    c = np.empty(((depth + 1) * ROWS, hidden), dtype=np.float32)
    h, squashed = np.empty((depth * ROWS, hidden), dtype=np.float32), np.empty((depth * ROWS, hidden), dtype=np.float32)
    said = np.empty((depth * ROWS, OUTPUTS), dtype=np.float32)
    growing, rising = np.empty((depth, ROWS), dtype=np.float32), np.empty((depth, ROWS), dtype=np.float32)
    spans = (depth + REFRESH - 1) // REFRESH
    look = np.zeros((spans, ROWS, SEGMENTS, WIDE), dtype=np.float32)
    look_t = np.zeros((spans, ROWS, WIDE, SEGMENTS), dtype=np.float32)
    bend_t, bend = np.zeros_like(look), np.zeros_like(look_t)
    share = np.empty((spans, ROWS, SEGMENTS), dtype=np.float32)
    slope = np.empty_like(share)
    told_length = np.empty((tellings if learn else 1, ROWS, SEGMENTS), dtype=np.float32)
    told_angle = np.empty_like(told_length)
    length, angle = np.empty((ROWS, SEGMENTS), dtype=np.float32), np.empty((ROWS, SEGMENTS), dtype=np.float32)
    total = np.empty(ROWS, dtype=np.float32)
    nodes = np.empty((ROWS, WIDE), dtype=np.float32)
    for m in range(len(both)):
        own = factors[m]
        rows, zone = np.nonzero(weight[m])[0], f(math.exp(log_zone[m]))
        both_t, w_out_t = both[m].T.copy(), w_out[m].T.copy()
        for start in range(0, len(rows), ROWS):
            count = min(ROWS, len(rows) - start)
            mine = rows[start : start + count]
            seen[:count] = ZERO
            c[:count] = ZERO
            for r in range(count):
                total[r] = ZERO
                for j in range(SEGMENTS):
                    length[r, j], angle[r, j] = lengths[mine[r], j], angles[mine[r], j]
                    total[r] += length[r, j]
            for k in range(steps):
                at = k if learn else 0
                here, after = at * count, ((at + 1) * count if learn else 0)
                span = at // REFRESH
                x, z, spoken = seen[here : here + count], gates[here : here + count], said[here : here + count]
                now = h[here : here + count]
                if k % REFRESH == 0:
                    refresh(length, count, zone, span, look, look_t, bend, bend_t, share, slope)
                at_nodes(angle, look, span, nodes[:count])
                for r in range(count):
                    w = mine[r]
                    for n in range(NODES):
                        x[r, n] = nodes[r, n] * own[w, 1]
                    x[r, _LENGTH] = (total[r] - _MIDDLE) * _PER_LENGTH
                    x[r, _LAMPS], x[r, _LAMPS + 1] = light[k, w, 0], light[k, w, 1]
                np.dot(x, both[m], z)
                activate(z, b[m], factor, offset)
                cell(z, c[here : here + count], c[after : after + count], squashed, here, now, seen, after)
                np.dot(now, w_out[m], spoken)
                for r in range(count):
                    w = mine[r]
                    for n in range(OUTPUTS):
                        spoken[r, n] += b_out[m, n]
                    for n in range(NODES):
                        nodes[r, n] = spoken[r, n] * own[w, 2]
                    s = spoken[r, NODES] + _OFFSET
                    e = f(math.exp(-abs(s)))
                    growing[at, r] = (max(s, ZERO) + f(math.log1p(e))) * own[w, 0]
                    rising[at, r] = (ONE if s >= ZERO else e) / (ONE + e)
                    for j in range(SEGMENTS):
                        length[r, j] += share[span, r, j] * growing[at, r]
                    total[r] += growing[at, r]
                add_at_segments(nodes[:count], bend, span, angle)
                if (k + 1) % every == 0:
                    telling = (k + 1) // every - 1
                    distances(
                        mine,
                        telling,
                        length,
                        angle,
                        lines,
                        line_lengths,
                        known,
                        near,
                        near_length,
                        length_weight,
                        weight[m],
                        loss[m],
                        telling if learn else 0,
                        told_length,
                        told_angle,
                    )
            if learn:
                _back(
                    both_t,
                    w_out_t,
                    mine,
                    own,
                    seen,
                    gates,
                    c,
                    squashed,
                    said,
                    growing,
                    rising,
                    look_t,
                    bend_t,
                    share,
                    slope,
                    told_length,
                    told_angle,
                    every,
                    zone,
                    d_b[m],
                    d_b_out[m],
                    d_zone[m : m + 1],
                    d_factors[m],
                )
                add_product(d_both[m], seen[: steps * count], gates[: steps * count])
                add_product(d_out[m], h[: steps * count], said[: steps * count])


@jit
def _back(  # type: ignore[no-untyped-def]
    both_t,
    w_out_t,
    rows,
    factors,
    seen,
    gates,
    c,
    squashed,
    said,
    growing,
    rising,
    look_t,
    bend_t,
    share,
    slope,
    told_length,
    told_angle,
    every,
    zone,
    d_b,
    d_b_out,
    d_zone,
    d_factors,
):
    """From the last step to the first; ``gates`` and ``said`` become the gradients of their sums."""
    count, steps, hidden = len(rows), growing.shape[0], c.shape[1]
    d_seen = np.zeros((count, INPUTS + hidden), dtype=np.float32)
    dh, dc = np.zeros((count, hidden), dtype=np.float32), np.zeros((count, hidden), dtype=np.float32)
    d_length, d_angle = np.zeros((count, SEGMENTS), dtype=np.float32), np.zeros((count, SEGMENTS), dtype=np.float32)
    d_share = np.zeros((count, SEGMENTS), dtype=np.float32)
    nodes = np.empty((count, WIDE), dtype=np.float32)
    for k in range(steps - 1, -1, -1):
        here = k * count
        span, telling = k // REFRESH, (k + 1) // every - 1
        z, spoken = gates[here : here + count], said[here : here + count]
        if (k + 1) % every == 0:
            for r in range(count):
                for j in range(SEGMENTS):
                    d_length[r, j] += told_length[telling, r, j]
                    d_angle[r, j] += told_angle[telling, r, j]
        at_nodes(d_angle, bend_t, span, nodes)
        for r in range(count):
            w = rows[r]
            d_growing = ZERO
            for j in range(SEGMENTS):
                d_growing += share[span, r, j] * d_length[r, j]
            for j in range(SEGMENTS):
                d_share[r, j] += growing[k, r] * d_length[r, j]
            for n in range(NODES):
                d_factors[w, 2] += nodes[r, n] * spoken[r, n]
                spoken[r, n] = nodes[r, n] * factors[w, 2]
            spoken[r, NODES] = d_growing * factors[w, 0] * rising[k, r]
            d_factors[w, 0] += d_growing * growing[k, r] / factors[w, 0]
            for n in range(OUTPUTS):
                d_b_out[n] += spoken[r, n]
        np.dot(spoken, w_out_t, dh)
        cell_back(z, c[here : here + count], squashed, here, dh, d_seen, dc, d_b)
        np.dot(z, both_t, d_seen)
        for r in range(count):
            w = rows[r]
            for n in range(NODES):
                nodes[r, n] = d_seen[r, n] * factors[w, 1]
                d_factors[w, 1] += d_seen[r, n] * seen[here + r, n] / factors[w, 1]
            for j in range(SEGMENTS):
                d_length[r, j] += d_seen[r, _LENGTH] * _PER_LENGTH
        add_at_segments(nodes, look_t, span, d_angle)
        if k % REFRESH == 0:
            for r in range(count):
                mean = ZERO
                for j in range(SEGMENTS):
                    mean += d_share[r, j] * share[span, r, j]
                for j in range(SEGMENTS):
                    d_zone[0] += (d_share[r, j] - mean) * slope[span, r, j] * zone
                    d_share[r, j] = ZERO
