"""What else is in the drawn setups: seams, cables, dust, screws, stains, bars, the pot and its soil."""

from __future__ import annotations

import math

import cv2
import numpy as np

from drawings.stem import ToPx
from drawings.textures import Picture, Rng, bgr, cloud, wandering_line


def odds_and_ends(rng: Rng, reflectance: Picture, to_px: ToPx) -> None:
    """Draw into the setup's reflectance what happens to be there."""
    height, width = reflectance.shape[:2]
    cm = to_px.px_per_cm

    def across() -> tuple[float, float]:
        return float(rng.uniform(0, width)), float(rng.uniform(0, height))

    for _ in range(int(rng.integers(0, 4))):  # seams
        upright = rng.random() < 0.5
        a, b = ((across()[0], -5.0), (0.0, height + 5.0)) if upright else ((-5.0, across()[1]), (width + 5.0, 0.0))
        b = (a[0] + rng.normal(0, 10), b[1]) if upright else (b[0], a[1] + rng.normal(0, 10))
        _line(reflectance, np.array([a, b]), rng.uniform(0.05, 0.3) * cm, rng.choice([0.3, 0.5, 1.7]))
    for _ in range(int(rng.integers(0, 4))):  # stains
        spot = np.zeros((height // 8, width // 8), np.float32)
        x, y = across()
        size = rng.uniform(0.5, 4.0) * cm / 8
        cv2.ellipse(
            spot,
            (int(x / 8), int(y / 8)),
            (int(size) + 1, int(size * rng.uniform(0.3, 1)) + 1),
            rng.uniform(0, 180),
            0,
            360,
            1.0,
            -1,
        )
        spot = cv2.resize(cv2.GaussianBlur(spot, None, max(1.0, 0.3 * size)), (width, height))
        reflectance *= (1 + spot * (rng.uniform(-0.5, 0.6)))[..., None]
    if rng.random() < 0.45:  # a bar or pipe
        tones = (bgr(0.7, 0.7, 0.68), bgr(0.45, 0.45, 0.47), bgr(0.55, 0.30, 0.16), bgr(0.75, 0.68, 0.40))
        tone = tones[int(rng.integers(4))]
        thick = rng.uniform(0.4, 2.0) * cm
        at = across()
        upright = rng.random() < 0.5
        for k in np.linspace(-1, 1, 15):  # round: bright in the middle
            shade = (1 - 0.75 * k * k) * tone
            if upright:
                a, b = (at[0] + k * thick / 2, -5.0), (at[0] + k * thick / 2 + 8, height + 5.0)
            else:
                a, b = (-5.0, at[1] + k * thick / 2), (width + 5.0, at[1] + k * thick / 2 + 8)
            _line(reflectance, np.array([a, b]), thick / 12, None, shade)
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.4, 0.3, 0.2, 0.1]))):  # cables
        start, end = (float(rng.uniform(0, width)), -10.0), (float(rng.choice([-10, width + 10])), across()[1])
        tone = bgr(*(rng.uniform(0.02, 0.06, 3) if rng.random() < 0.6 else rng.uniform(0.25, 0.6, 3)))
        line = wandering_line(rng, start, end, 0.08 * width)
        thick = rng.uniform(0.15, 0.5) * cm
        _line(reflectance, line, thick, None, tone)
        _line(reflectance, line - [0.2 * thick, 0.2 * thick], thick * 0.25, 1.6)
    for _ in range(int(rng.integers(0, 7))):  # screws
        x, y = (round(v) for v in across())
        size = max(1, round(rng.uniform(0.15, 0.4) * cm))
        cv2.circle(reflectance, (x, y), size, (0.28, 0.28, 0.27), -1)
        cv2.line(reflectance, (x - size, y), (x + size, y + size // 2), (0.05, 0.05, 0.05), max(1, size // 4))
    for _ in range(int(rng.choice([0, 20, 120]))):  # dust
        x, y = (round(v) for v in across())
        reflectance[min(y, height - 1), min(x, width - 1)] += np.float32(rng.uniform(0.02, 0.25))


def pot(rng: Rng, reflectance: Picture, slope_x: Picture, front: Picture, to_px: ToPx) -> None:
    """Draw pot and soil; what of them stands before the plant goes into ``front``."""
    height, width = reflectance.shape[:2]
    cm = to_px.px_per_cm
    x0, y0 = to_px.anchor_px
    radius = rng.uniform(4.0, 8.0) if rng.random() < 0.75 else rng.uniform(12, 22)
    x0 = x0 + rng.uniform(-0.4, 0.4) * radius * cm
    flatness = rng.uniform(0.08, 0.22) if radius < 10 else rng.uniform(0.04, 0.09)
    hides = rng.uniform(0.0, 0.6) if rng.random() < 0.5 else -rng.uniform(0.1, 0.4 * flatness * radius + 0.1)
    dx = (to_px.anchor_px[0] - x0) / (radius * cm)
    lip = hides + flatness * radius * math.sqrt(1 - dx * dx)
    tones = (
        bgr(0.75, 0.75, 0.73),
        bgr(0.03, 0.03, 0.03),
        bgr(0.42, 0.17, 0.08),
        bgr(0.08, 0.12, 0.40),
        bgr(0.25, 0.25, 0.24),
    )
    tone = tones[int(rng.integers(5))] * rng.uniform(0.7, 1.1)
    a, b = radius * cm, flatness * radius * cm
    centre = (x0, y0 - lip * cm)
    # outside, back to front
    turn = np.linspace(0, 2 * np.pi, 120)
    ring = np.column_stack([centre[0] + a * np.cos(turn), centre[1] + b * np.sin(turn)])
    body = np.zeros((height, width), np.uint8)
    foot = height + 10
    sides = np.array([(x0 - a, centre[1]), (x0 + a, centre[1]), (x0 + 0.8 * a, foot), (x0 - 0.8 * a, foot)])
    for outline in (sides, ring):
        cv2.fillPoly(body, [np.rint(outline * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    inner = np.zeros((height, width), np.uint8)
    cv2.fillPoly(inner, [np.rint(ring * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    soil = np.zeros((height, width), np.uint8)
    level = ring * [0.97, 1.0] + [0.03 * centre[0], (y0 - 0.02 * cm) - centre[1]]
    cv2.fillPoly(soil, [np.rint(level * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    column = np.clip((np.arange(width) - x0) / a, -1, 1).astype(np.float32)
    outside, inside = (body > 0) & (inner == 0), (inner > 0) & (soil == 0)
    wall = tone * (1 + 0.03 * cloud(rng, (height, width), (6, 6), 3))[..., None]
    reflectance[outside] = wall[outside]
    slope_x[outside] = np.broadcast_to(0.9 * column, (height, width))[outside]
    reflectance[inside] = 0.35 * wall[inside]
    slope_x[inside] = np.broadcast_to(-0.7 * column, (height, width))[inside]
    earth = bgr(*rng.choice(np.array([(0.05, 0.035, 0.025), (0.11, 0.075, 0.05), (0.03, 0.03, 0.03)])))
    ground = earth * np.exp(0.45 * cloud(rng, (height, width), (height / 10, width / 14), 3, 0.8))[..., None]
    seen = (soil > 0) & (inner > 0)
    reflectance[seen] = ground[seen]
    slope_x[seen] = 0.0
    if rng.random() < 0.5:  # perlite, stones
        for _ in range(int(rng.integers(20, 150))):
            t, r = rng.uniform(0, 2 * np.pi), math.sqrt(rng.uniform(0, 0.95))
            x, y = round(centre[0] + a * r * math.cos(t)), round(y0 + b * r * math.sin(t))
            size = max(1, round(rng.uniform(0.08, 0.3) * cm))
            if 0 <= x < width and 0 <= y < height and seen[y, x]:
                cv2.ellipse(
                    reflectance, (x, y), (size, max(1, size // 2)), 0, 0, 360, (rng.uniform(0.25, 0.75),) * 3, -1
                )
    # the rim: a ring of its own, and its near half before the plant
    thick = max(2, round(rng.uniform(0.15, 0.5) * cm))
    near = turn <= np.pi
    for part, shade in ((ring[~near], 0.7), (ring[near], 1.15)):
        edge = tone * shade
        cv2.polylines(reflectance, [np.rint(part * 16).astype(np.int32)], False, edge.tolist(), thick, cv2.LINE_8, 4)
    rim = np.zeros((height, width), np.uint8)
    hidden = np.vstack([ring[near], [(x0 - a, foot), (x0 + a, foot)]])
    cv2.fillPoly(rim, [np.rint(hidden * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    shift = np.array([0, thick / 2 if hides > 0 else thick * 0.5])
    cv2.polylines(rim, [np.rint((ring[near] + shift) * 16).astype(np.int32)], False, 1, thick, cv2.LINE_8, 4)
    front[rim > 0] = 1.0
    ax, ay = to_px.anchor_px
    for _ in range(int(rng.integers(2, 7))):  # crumbs at the foot
        x, y = round(ax + rng.normal(0, 0.3 * cm)), round(ay + 0.12 * cm + rng.uniform(0, 0.1) * cm)
        if 0 <= x < width and 0 <= y < height and seen[y, x]:
            size = max(1, round(rng.uniform(0.05, 0.12) * cm))
            cv2.circle(reflectance, (x, y), size, (earth * rng.uniform(0.7, 2.0)).tolist(), -1)
            cv2.circle(front, (x, y), size, 1.0, -1)


def _line(picture: Picture, line: Picture, thick: float, factor: float | None, tone: Picture | None = None) -> None:
    """Draw a line; it takes a colour of its own, or darkens or brightens what is there."""
    points = [np.rint(line * 16).astype(np.int32)]
    if factor is None and tone is not None:
        cv2.polylines(picture, points, False, [float(v) for v in tone], max(1, round(thick)), cv2.LINE_8, 4)
        return
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.polylines(mask, points, False, 1, max(1, round(thick)), cv2.LINE_8, 4)
    picture[mask > 0] *= np.float32(factor if factor is not None else 1.0)
