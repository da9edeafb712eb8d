"""A growing stem in three dimensions, compiled; the laws are arguments.

The stem is a chain of elements. Each has a length and two curvatures, ``ku`` towards its own side u and ``kv`` towards
its other side v; the frame (t, u, v) is carried along the chain from the soil, turning with the curvatures and, where
the stem is twisted, about its own axis. With d the distance from the tip, each curvature follows

    dk/dt = activity(d) * (photo * light + gravity * up + drives - proprioception * k)

where each vector is taken across the stem, along u for ``ku`` and along v for ``kv``. That is the law of Bastien et al.
(2013, 2015). Elements that grow long are halved, and both halves keep the curvature. A plant whose forces all lie in
the picture stays in the picture, exactly.

All compiled functions live in this one file: Numba renews its cache when the file of a function changes, and does not
look at the files of the functions that it calls.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

MOST_ELEMENTS = 400
NEW_CM = 0.25
LONG_CM = 0.5
SAG_SOFT_CM = 5.0
"""Stiffness e-fold with distance from the tip: Ohad et al. data, 54 plants."""

# Columns of a plant, of the laws, of the series and of the events; scene.py fills them in this order.
(INITIAL, LEAN, EARLY, LATE, GROWTH_ZONE, BENDING_ZONE, PHOTO, GRAVITY, PROPRIO, LATENCY, CURVE_U, CURVE_V) = range(12)
(STIFFENING, ELONGATION, GROWTH_LAW, RESPONSE, FALL, HALF, PULL, DILUTION, TWIST, LAMP_X, LAMP_Y, LAMP_Z) = range(12)
(LEFT, RIGHT, GROWTH, GAIN, BENDING, ZONE, DRIVE_X, DRIVE_Z, GRADIENT) = range(9)
(DELAY, ADAPT, FLOOR, SAG, WALL, KICK_H, KICK, SHY, HISTORY, HISTORY_H) = range(10)

BOX, EXPONENTIAL, POWER, RAMP = range(4)
LINEAR, SATURATING, LOGARITHM = range(3)
CLOSED_LOOP = -1


@njit(cache=True)
def activity(law, d_cm, zone_cm):
    """Share of the full bending rate at a distance from the tip; ``zone_cm`` is the law's own length."""
    if law == BOX:
        return 1.0 / (1.0 + math.exp(min((d_cm - zone_cm) / 0.7, 60.0)))
    if law == EXPONENTIAL:
        return math.exp(-d_cm / zone_cm)
    if law == POWER:
        return 1.0 / (1.0 + (d_cm / zone_cm) ** 3)
    return max(0.0, 1.0 - d_cm / zone_cm)


@njit(cache=True)
def _elongating(law, d_cm, zone_cm):
    """Relative elongation at a distance from the tip, before scaling: a plateau, or a hump below the tip."""
    if law == 0:
        return 1.0 / (1.0 + math.exp(min((d_cm - zone_cm) / 0.6, 60.0)))
    hump = 2.5 * d_cm / zone_cm
    return 0.15 * math.exp(-d_cm / zone_cm) + hump * math.exp(1.0 - hump)


@njit(cache=True)
def _growth_cm_per_h(law, length_cm, early, late):
    """Elongation of the whole stem: straight in its length, or a saturating curve through the same points."""
    if law == 0:
        share = min(max((length_cm - 6.5) / 15.5, -0.5), 1.3)
        return (early + (late - early) * share) / 24.0
    # v L / (L + h) with v and h such that it is `early` at 6.5 cm and `late` at 22 cm.
    half = (late - early) / (early / 6.5 - late / 22.0)
    return early * (6.5 + half) / 6.5 * length_cm / (length_cm + half) / 24.0


@njit(cache=True)
def _shape(n, length, ku, kv, elastic, twist, lean, line, middle, u, v):
    """Nodes ``line`` (n + 1, 3) and, at each element's middle, place and both side vectors."""
    t0, t1, t2 = math.sin(lean), math.cos(lean), 0.0
    u0, u1, u2 = math.cos(lean), -math.sin(lean), 0.0
    v0, v1, v2 = 0.0, 0.0, 1.0
    line[0, 0] = line[0, 1] = line[0, 2] = 0.0
    for i in range(n):
        a, b = ku[i] + elastic[i], kv[i]
        bend = math.sqrt(a * a + b * b)
        if bend > 1e-12:
            a /= bend
            b /= bend
        else:
            a, b = 1.0, 0.0
        c, s = math.cos(0.5 * bend * length[i]), math.sin(0.5 * bend * length[i])
        for half in range(2):
            e0, e1, e2 = a * u0 + b * v0, a * u1 + b * v1, a * u2 + b * v2
            p0, p1, p2 = a * v0 - b * u0, a * v1 - b * u1, a * v2 - b * u2
            f0, f1, f2 = c * e0 - s * t0, c * e1 - s * t1, c * e2 - s * t2
            t0, t1, t2 = c * t0 + s * e0, c * t1 + s * e1, c * t2 + s * e2
            u0, u1, u2 = a * f0 - b * p0, a * f1 - b * p1, a * f2 - b * p2
            v0, v1, v2 = b * f0 + a * p0, b * f1 + a * p1, b * f2 + a * p2
            if half == 0:
                u[i, 0], u[i, 1], u[i, 2] = u0, u1, u2
                v[i, 0], v[i, 1], v[i, 2] = v0, v1, v2
                line[i + 1, 0] = line[i, 0] + t0 * length[i]
                line[i + 1, 1] = line[i, 1] + t1 * length[i]
                line[i + 1, 2] = line[i, 2] + t2 * length[i]
        for k in range(3):
            middle[i, k] = 0.5 * (line[i, k] + line[i + 1, k])
        if twist != 0.0:
            c, s = math.cos(twist * length[i]), math.sin(twist * length[i])
            u0, v0 = c * u0 + s * v0, c * v0 - s * u0
            u1, v1 = c * u1 + s * v1, c * v1 - s * u1
            u2, v2 = c * u2 + s * v2, c * v2 - s * u2


@njit(cache=True)
def _light(place, left, right, laws, out):
    """The light's direction times the response to its brightness, which is 1 for one full lamp at the anchor."""
    reach = math.sqrt(laws[LAMP_X] ** 2 + laws[LAMP_Y] ** 2 + laws[LAMP_Z] ** 2)
    out[0] = out[1] = out[2] = 0.0
    for lamp in range(2):
        level = left if lamp == 0 else right
        if level > 0.0:
            x = (-laws[LAMP_X] if lamp == 0 else laws[LAMP_X]) - place[0]
            y = laws[LAMP_Y] - place[1]
            z = laws[LAMP_Z] - place[2]
            away = max(math.sqrt(x * x + y * y + z * z), 4.0)
            weight = level * (reach / away) ** laws[FALL] / away
            out[0] += weight * x
            out[1] += weight * y
            out[2] += weight * z
    if laws[RESPONSE] != LINEAR:
        size = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
        if size > 1e-9:
            half = laws[HALF]
            if laws[RESPONSE] == SATURATING:
                factor = (1.0 + half) / (size + half)
            else:
                factor = math.log1p(size / half) / math.log1p(1.0 / half) / size
            for k in range(3):
                out[k] *= factor


@njit(cache=True)
def _sag(n, length, middle, amount, elastic):
    """Elastic curvature under the own weight, half way towards what this shape asks for."""
    tip_cm = lever = above = 0.0
    for i in range(n - 1, -1, -1):
        # Moment of everything above about this place, per unit of weight and length.
        if i < n - 1:
            lever += above * (middle[i + 1, 0] - middle[i, 0])
        above += length[i]
        tip_cm += length[i]
        wanted = amount * math.exp(-(tip_cm - 0.5 * length[i]) / SAG_SOFT_CM) * lever
        elastic[i] += 0.5 * (min(max(wanted, -0.3), 0.3) - elastic[i])


@njit(cache=True)
def _behind_wall(n, length, ku, line, wall_cm, soft):
    """Bend the stem below its deepest place just so far that it lies against an upright wall."""
    side = 1.0 if wall_cm > 0.0 else -1.0
    deepest, at = 0.0, -1
    for i in range(1, n + 1):
        past = side * line[i, 0] - abs(wall_cm)
        if past > deepest:
            deepest, at = past, i
    if at < 0:
        return False
    total = 1e-9
    for i in range(at):
        lever = line[at, 1] - 0.5 * (line[i, 1] + line[i + 1, 1])
        total += soft[i] * length[i] * lever * lever
    for i in range(at):
        lever = line[at, 1] - 0.5 * (line[i, 1] + line[i + 1, 1])
        ku[i] -= side * min(deepest, 0.5) * soft[i] * lever / total
    return True


@njit(cache=True)
def _elongate(n, length, ku, kv, elastic, added_cm, laws, zone_cm):
    """Lengthen the elements, halve those that have grown long; returns their number."""
    below, weight = 0.0, 0.0
    share = np.empty(n)
    for i in range(n - 1, -1, -1):
        share[i] = length[i] * _elongating(laws[ELONGATION], below + 0.5 * length[i], zone_cm)
        below += length[i]
        weight += share[i]
    halve = 0
    for i in range(n):
        grown = length[i] + added_cm * share[i] / weight
        if laws[DILUTION] > 0.0:  # the turn between both ends stays, so the curvature thins out
            ku[i] *= length[i] / grown
            kv[i] *= length[i] / grown
        length[i] = grown
        if grown > LONG_CM:
            halve += 1
    if halve == 0 or n + halve > MOST_ELEMENTS:
        return n
    to = n + halve - 1
    for i in range(n - 1, -1, -1):
        times = 2 if length[i] > LONG_CM else 1
        grown, a, b, e = length[i] / times, ku[i], kv[i], elastic[i]
        for _ in range(times):
            length[to], ku[to], kv[to], elastic[to] = grown, a, b, e
            to -= 1
    return n + halve


@njit(cache=True)
def grow(plant, laws, series, lamp, target_x_cm, events, dt_h, every):
    """Grow one plant.

    Args:
        plant, laws, events: constants, in the order of the names above.
        series: shape (steps, 9): what changes with time, in the order of the names above.
        lamp: shape (steps,): 0 left, 1 right, 2 dark, 3 both, -1 whichever leads the tip to ``target_x_cm``.
        target_x_cm: where a closed loop wants the tip.
        dt_h: one step.
        every: steps between two rows.

    Returns:
        Nodes, shape (steps // every + 1, most, 3) in cm; how many are used, shape (rows,); lamps, shape (steps,).
    """
    steps = lamp.shape[0]
    rows = steps // every + 1
    lines = np.zeros((rows, MOST_ELEMENTS + 1, 3))
    used = np.zeros(rows, np.int64)
    lit = lamp.copy()
    length, ku, kv = np.zeros(MOST_ELEMENTS), np.zeros(MOST_ELEMENTS), np.zeros(MOST_ELEMENTS)
    elastic, soft = np.zeros(MOST_ELEMENTS), np.zeros(MOST_ELEMENTS)
    line = np.zeros((MOST_ELEMENTS + 1, 3))
    middle, u, v = np.zeros((MOST_ELEMENTS, 3)), np.zeros((MOST_ELEMENTS, 3)), np.zeros((MOST_ELEMENTS, 3))
    seen, fresh, light = np.zeros((2, 2)), np.ones(2), np.zeros(3)
    memory = 0.0
    n = math.ceil(plant[INITIAL] / NEW_CM)
    for i in range(n):
        length[i], ku[i], kv[i] = plant[INITIAL] / n, plant[CURVE_U], plant[CURVE_V]
    stage = -math.expm1(-dt_h / (0.5 * plant[LATENCY]))
    back = events[DELAY] / dt_h
    for step in range(steps + 1):
        _shape(n, length, ku, kv, elastic, laws[TWIST], plant[LEAN], line, middle, u, v)
        if step % every == 0:
            lines[step // every, : n + 1] = line[: n + 1]
            used[step // every] = n + 1
        if step == steps:
            break
        now = series[step]
        if lamp[step] == CLOSED_LOOP:
            lit[step] = (1 if line[n, 0] < target_x_cm else 0) if step % every == 0 else lit[step - 1]
        for side in range(2):
            old = 0.0  # in the dark before the start; a delay between two steps takes its share of both
            for part in range(2):
                at = step - int(back) - part
                weight = back - int(back) if part == 1 else 1.0 - (back - int(back))
                if at >= 0 and (lit[at] == side or lit[at] == 3):
                    old += weight * series[at, LEFT + side]
            seen[0, side] += stage * (old - seen[0, side])
            seen[1, side] += stage * (seen[0, side] - seen[1, side])
            if events[ADAPT] > 0.0:
                tired = min(seen[1, side], 1.0)
                fresh[side] += (1.0 - tired * (1.0 - events[FLOOR]) - fresh[side]) * dt_h / events[ADAPT]
        left, right = seen[1, 0] * fresh[0], seen[1, 1] * fresh[1]
        turned = (1.0 if lit[step] == 1 else 0.0) - (1.0 if lit[step] == 0 else 0.0)
        memory += (turned - memory) * dt_h / events[HISTORY_H]
        if events[SAG] != 0.0:
            _sag(n, length, middle, events[SAG], elastic)

        gain = plant[PHOTO] * now[GAIN]
        if events[SHY] > 0.0:
            gain /= 1.0 + (line[n, 0] / events[SHY]) ** 2
        zone = plant[BENDING_ZONE] * now[ZONE]
        d = 0.0
        for i in range(n - 1, -1, -1):
            d += 0.5 * length[i]
            soft[i] = activity(laws[STIFFENING], d, zone)
            _light(middle[i], left, right, laws, light)
            up_u, up_v = u[i, 1], v[i, 1]
            pull = 1.0
            if laws[PULL] > 0.0:  # gravity felt as a saturating function of the lean, equal to its sine at 30 degrees
                lean = math.sqrt(up_u * up_u + up_v * up_v)
                pull = 0.5 / math.tanh(1.0) * math.tanh(2.0 * lean) / max(lean, 1e-9)
            push_x = gain * light[0] + now[DRIVE_X] + now[GRADIENT] * max(-1.0, 1.0 - 2.0 * d / zone)
            push_y = gain * light[1] + plant[GRAVITY] * pull
            push_z = gain * light[2] + now[DRIVE_Z]
            rate = soft[i] * now[BENDING] * dt_h
            resist = plant[PROPRIO]
            force_u = push_x * u[i, 0] + push_y * up_u + push_z * u[i, 2]
            force_v = push_x * v[i, 0] + push_y * up_v + push_z * v[i, 2]
            ku[i] += rate * (force_u - resist * (ku[i] + elastic[i]))
            kv[i] += rate * (force_v - resist * kv[i])
            d += 0.5 * length[i]
        hour = step * dt_h
        if hour <= events[KICK_H] < hour + dt_h:
            d = 0.0
            for i in range(n - 1, -1, -1):
                d += length[i]
                if d < 12.0:
                    ku[i] += events[KICK]
        grown = _growth_cm_per_h(laws[GROWTH_LAW], d, plant[EARLY], plant[LATE])
        grown *= max(0.0, now[GROWTH]) * max(0.0, 1.0 + events[HISTORY] * memory) * dt_h
        n = _elongate(n, length, ku, kv, elastic, grown, laws, plant[GROWTH_ZONE])
        if events[WALL] != 0.0:
            for _ in range(6):
                _shape(n, length, ku, kv, elastic, laws[TWIST], plant[LEAN], line, middle, u, v)
                if not _behind_wall(n, length, ku, line, events[WALL], soft):
                    break
    return lines, used, lit


@njit(cache=True)
def by_height(lines, used, count):
    """Points at even heights from anchor to tip, the lowest passage along the stem; shape (rows, count, 2)."""
    rows = lines.shape[0]
    out = np.zeros((rows, count, 2))
    for row in range(rows):
        last = used[row] - 1
        top = lines[row, last, 1]
        out[row, count - 1, 0], out[row, count - 1, 1] = lines[row, last, 0], top
        for i in range(1, count - 1):
            height = top * i / (count - 1)
            out[row, i, 1] = height
            out[row, i, 0] = lines[row, last, 0]
            for k in range(last):
                a, b = lines[row, k, 1] - height, lines[row, k + 1, 1] - height
                if (a <= 0.0 < b) or (b < 0.0 <= a):
                    share = a / (a - b)
                    out[row, i, 0] = lines[row, k, 0] + share * (lines[row, k + 1, 0] - lines[row, k, 0])
                    break
    return out


@njit(cache=True)
def first_order(kicks, keep):
    """A drift that keeps a share of itself each step: x[i] = keep x[i-1] + kicks[i]."""
    out = np.empty_like(kicks)
    value = 0.0
    for i in range(kicks.shape[0]):
        value = keep * value + kicks[i]
        out[i] = value
    return out
