"""The parts of :mod:`flora_lab.train.fused_law`: one step of several stems, and the way back, compiled.

Arrays are float32. ``length`` and ``angle`` have shape (rows, SEGMENTS), cm and rad.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from flora_lab.simulator.fast_tanh import fast_tanh
from flora_lab.simulator.neural_law import FADE_CM, INPUTS, NODES_CM, RATE_PER_CM_H, STEP_H
from flora_lab.simulator.rod import ZONE_EDGE_CM, jit
from flora_lab.train.windows import PLACES, SEGMENTS

# Python's own numbers would make everything float64.
f = np.float32
ZERO, HALF, ONE = f(0.0), f(0.5), f(1.0)
NODES: Final = len(NODES_CM)
WIDE: Final = 16
"""Nodes, filled up to whole SIMD registers."""
_EDGE = f(ZONE_EDGE_CM)
_NO_TISSUE = f(1e-3)
_BEND = f(STEP_H * RATE_PER_CM_H)
_PRODUCTS: Final = 1 << 18
"""Of a matrix product at a time. OpenBLAS takes a second thread from twice as many on, if it may: sums would then
depend on the machine's processors."""

# The weight of a node at a distance d from the tip is the lesser of (d - low) / rise and (high - d) / fall, from 0 to
# 1; that of what fills up is 0, and the first node's does not fall towards the tip.
_ENDS: Final = np.array([NODES_CM[0] - 1e6, *NODES_CM, NODES_CM[-1] + FADE_CM])
_GAPS: Final = np.diff(_ENDS)
_LOW, _PER_RISE = np.zeros(WIDE, dtype=np.float32), np.zeros(WIDE, dtype=np.float32)
_HIGH, _PER_FALL = np.full(WIDE, -1.0, dtype=np.float32), np.ones(WIDE, dtype=np.float32)
_LOW[:NODES], _HIGH[:NODES] = _ENDS[:NODES], _ENDS[2:]
_PER_RISE[:NODES], _PER_FALL[:NODES] = 1.0 / _GAPS[:-1], 1.0 / _GAPS[1:]
_PER_RISE[0] = 1.0


# Helpers go through the rows themselves: a view of an array costs more than the work on one row.
@jit
def refresh(length, count, zone, span, look, look_t, bend, bend_t, share, slope):  # type: ignore[no-untyped-def]
    """What depends on the lengths of the stems' segments, at ``[span, row]`` of the results.

    ``look`` (SEGMENTS, WIDE) gives the angles at nodes, ``bend`` (WIDE, SEGMENTS) the turn of each segment for rates
    at nodes, ``share`` (SEGMENTS,) where it grows; ``slope`` is the derivative of the last for the zone, times the
    sum that it was divided by; ``_t`` are the transposed.
    """
    middle, below = np.empty(SEGMENTS, dtype=np.float32), np.empty(SEGMENTS, dtype=np.float32)
    tissue = np.empty(WIDE, dtype=np.float32)
    for r in range(count):
        distance, whole = ZERO, ZERO
        for j in range(SEGMENTS - 1, -1, -1):
            middle[j] = distance + HALF * length[r, j]
            distance += length[r, j]
            below[j] = distance
        tissue[:] = _NO_TISSUE
        for j in range(SEGMENTS):
            here = length[r, j]
            reach = _BEND * (here if j == 0 else HALF * (here + length[r, j - 1]))
            for n in range(WIDE):
                rising = min((middle[j] - _LOW[n]) * _PER_RISE[n], ONE)
                look[span, r, j, n] = max(min(rising, (_HIGH[n] - middle[j]) * _PER_FALL[n]), ZERO) * here
            for n in range(WIDE):
                rising = min((below[j] - _LOW[n]) * _PER_RISE[n], ONE)
                bend_t[span, r, j, n] = max(min(rising, (_HIGH[n] - below[j]) * _PER_FALL[n]), ZERO) * reach
            for n in range(WIDE):
                tissue[n] += look[span, r, j, n]
        for n in range(WIDE):
            tissue[n] = ONE / tissue[n]
        for j in range(SEGMENTS):
            for n in range(WIDE):
                look[span, r, j, n] *= tissue[n]
        for j in range(1, SEGMENTS):
            for n in range(WIDE):
                bend_t[span, r, j, n] += bend_t[span, r, j - 1, n]
        for n in range(NODES):
            for j in range(SEGMENTS):
                look_t[span, r, n, j] = look[span, r, j, n]
                bend[span, r, n, j] = bend_t[span, r, j, n]
        for j in range(SEGMENTS):
            soft = max(HALF + HALF * fast_tanh((HALF / _EDGE) * (zone - middle[j])), ZERO)
            share[span, r, j] = length[r, j] * soft
            slope[span, r, j] = share[span, r, j] * (ONE - soft) / _EDGE
        for j in range(SEGMENTS):
            whole += share[span, r, j]
        for j in range(SEGMENTS):
            share[span, r, j] /= whole
            slope[span, r, j] /= whole


@jit
def at_nodes(values, weights, span, out):  # type: ignore[no-untyped-def]
    """out[r, n] = sum over segments of values[r, j] weights[span, r, j, n]."""
    for r in range(out.shape[0]):
        for n in range(WIDE):
            total = ZERO
            for j in range(SEGMENTS):
                total += values[r, j] * weights[span, r, j, n]
            out[r, n] = total


@jit
def add_at_segments(values, weights, span, into):  # type: ignore[no-untyped-def]
    """into[r, j] += sum over nodes of values[r, n] weights[span, r, n, j]."""
    for r in range(values.shape[0]):
        for j in range(SEGMENTS):
            total = into[r, j]
            for n in range(NODES):
                total += values[r, n] * weights[span, r, n, j]
            into[r, j] = total


@jit
def distances(  # type: ignore[no-untyped-def]
    rows,
    telling,
    length,
    angle,
    lines,
    line_lengths,
    known,
    near,
    near_length,
    length_weight,
    weight,
    loss,
    into,
    told_length,
    told_angle,
):
    """Losses of stems beside measured ones, and their gradient times ``weight``, at ``[into, row]``."""
    sin, cos = np.empty(SEGMENTS, dtype=np.float32), np.empty(SEGMENTS, dtype=np.float32)
    x, y, roots = np.empty_like(sin), np.empty_like(sin), np.empty_like(sin)
    per_near = ONE / (near[telling] * near[telling])
    for r in range(len(rows)):
        w = rows[r]
        if not known[w, telling]:
            told_length[into, r] = ZERO
            told_angle[into, r] = ZERO
            continue
        tellings = 0
        for k in range(known.shape[1]):
            tellings += known[w, k]
        share = ONE / f(tellings)
        whole, arc, at_x, at_y, total = ZERO, ZERO, ZERO, ZERO, ZERO
        for j in range(SEGMENTS):
            whole += length[r, j]
            sin[j], cos[j] = math.sin(angle[r, j]), math.cos(angle[r, j])
        for j in range(SEGMENTS):
            at_x += length[r, j] * sin[j]
            at_y += length[r, j] * cos[j]
            arc += length[r, j]
            place = arc / whole * f(PLACES - 1)
            below = min(int(place), PLACES - 2)
            rest = place - f(below)
            x[j] = at_x - (lines[w, telling, below, 0] * (ONE - rest) + lines[w, telling, below + 1, 0] * rest)
            y[j] = at_y - (lines[w, telling, below, 1] * (ONE - rest) + lines[w, telling, below + 1, 1] * rest)
        scale = weight[w] * share * per_near / f(SEGMENTS)
        for j in range(SEGMENTS):
            roots[j] = np.sqrt(ONE + (x[j] * x[j] + y[j] * y[j]) * per_near)
            x[j] *= scale / roots[j]
            y[j] *= scale / roots[j]
        for j in range(SEGMENTS):
            total += roots[j] - ONE
        off = (whole - line_lengths[w, telling]) / near_length[telling]
        root = np.sqrt(ONE + off * off)
        loss[w] += share * (total / f(SEGMENTS) + length_weight * (root - ONE))
        longer = weight[w] * share * length_weight * off / (root * near_length[telling])
        push_x, push_y = ZERO, ZERO
        for j in range(SEGMENTS - 1, -1, -1):
            push_x += x[j]
            push_y += y[j]
            told_length[into, r, j] = push_x * sin[j] + push_y * cos[j] + longer
            told_angle[into, r, j] = length[r, j] * (push_x * cos[j] - push_y * sin[j])


@jit
def activate(gates, b, factor, offset):  # type: ignore[no-untyped-def]
    """Add the bias; then sigmoid of i, f and o, tanh of g: both are tanh, scaled."""
    for r in range(gates.shape[0]):
        for j in range(gates.shape[1]):
            gates[r, j] = offset[j] + factor[j] * fast_tanh(factor[j] * (gates[r, j] + b[j]))


@jit
def cell(gates, c_before, c, squashed, here, h, seen, after):  # type: ignore[no-untyped-def]
    """The LSTM's memory and output from its gates; ``seen`` from row ``after`` on tells the next step."""
    hidden = c.shape[1]
    for r in range(c.shape[0]):
        for j in range(hidden):
            c[r, j] = gates[r, hidden + j] * c_before[r, j] + gates[r, j] * gates[r, 2 * hidden + j]
        for j in range(hidden):
            t = fast_tanh(c[r, j])
            squashed[here + r, j] = t
            h[r, j] = gates[r, 3 * hidden + j] * t
        for j in range(hidden):
            seen[after + r, INPUTS + j] = h[r, j]


@jit
def cell_back(gates, c_before, squashed, here, dh, d_seen, dc, d_b):  # type: ignore[no-untyped-def]
    """``gates`` becomes the gradient of their sums, ``dc`` that of the memory before."""
    hidden = dc.shape[1]
    for r in range(dc.shape[0]):
        for j in range(hidden):
            i, f, g, o = gates[r, j], gates[r, hidden + j], gates[r, 2 * hidden + j], gates[r, 3 * hidden + j]
            t, d = squashed[here + r, j], dh[r, j] + d_seen[r, INPUTS + j]
            e = dc[r, j] + d * o * (ONE - t * t)
            gates[r, j] = e * g * i * (ONE - i)
            gates[r, hidden + j] = e * c_before[r, j] * f * (ONE - f)
            gates[r, 2 * hidden + j] = e * i * (ONE - g * g)
            gates[r, 3 * hidden + j] = d * t * o * (ONE - o)
            dc[r, j] = e * f
        for j in range(4 * hidden):
            d_b[j] += gates[r, j]


@jit
def add_product(into, a, z):  # type: ignore[no-untyped-def]
    """into += a^T z, some rows at a time."""
    part = np.empty_like(into)
    rows = max(1, _PRODUCTS // (into.shape[0] * into.shape[1]))
    for start in range(0, a.shape[0], rows):
        end = min(start + rows, a.shape[0])
        np.dot(a[start:end].T, z[start:end], part)
        for k in range(into.shape[0]):
            for j in range(into.shape[1]):
                into[k, j] += part[k, j]
