"""A drawn plant: its growth, its leaves and where they hang, what lies before what, and its picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from drawings.growth import Growth, Posture
from drawings.hiding import fair, inside
from drawings.leaves import SHAPES, Blade, draw_blade, grow_blade, place, vein_lines
from drawings.stem import Canvas, Lit, ToPx, draw_strip
from drawings.textures import Picture, Rng, bgr
from flora_common.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Leaf:
    """One leaf and its life; a leaf with three blades is three of these on one petiole."""

    node: int
    side: int
    blade: Blade
    blade_cm: float
    petiole_cm: float
    petiole_mm: float
    angle_rad: float
    turn_rad: float
    flat: float
    grown_h: float
    born_h: float
    before: bool
    at_tip_cm: float
    """For the small leaves round the apex: how far below the tip they sit; negative for leaves on a node."""
    sway: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Placed:
    """A leaf at one time: petiole (n, 2), and the two halves of its blade, in cm; ``before`` the stem or behind it."""

    leaf: Leaf
    petiole_cm: FloatArray
    petiole_half_cm: float
    upper_cm: FloatArray
    lower_cm: FloatArray
    veins_cm: list[FloatArray]
    before: bool


class Plant:
    """All that is one plant's own."""

    def __init__(self, rng: Rng, growth: Growth, shapes: tuple[str, ...] | None = None) -> None:
        self.growth = growth
        self.base_cm = float(rng.uniform(0.20, 0.50))
        self.tip_cm = float(min(rng.uniform(0.12, 0.25), self.base_cm))
        self.taper = float(rng.uniform(0.7, 1.5))
        foot, top = rng.choice(4, p=[0.35, 0.25, 0.25, 0.15]), rng.random()
        tones = (bgr(0.62, 0.62, 0.30), bgr(0.36, 0.48, 0.15), bgr(0.50, 0.24, 0.20), bgr(0.36, 0.19, 0.28))
        self.foot_tone = tones[int(foot)] * rng.uniform(0.8, 1.1)
        self.top_tone = (tones[0] * top + tones[1] * (1 - top)) * rng.uniform(0.8, 1.1)
        self.gloss = float(rng.uniform(0.0, 0.10))
        self.leaf_tone = bgr(rng.uniform(0.10, 0.26), rng.uniform(0.28, 0.46), rng.uniform(0.05, 0.14))
        kinds = shapes or tuple(s for s in SHAPES[:-1] if s != "lens")
        self.shape = str(rng.choice(kinds))
        self.leaves = self._sprout(rng, shapes)

    def _sprout(self, rng: Rng, shapes: tuple[str, ...] | None) -> list[Leaf]:
        leaves: list[Leaf] = []
        sizes = (0.0, rng.uniform(2.5, 7.5), *rng.uniform(2.0, 6.5, 5))
        turned = bool(rng.integers(2))
        pale = (self.leaf_tone + self.foot_tone) / 2

        def add(
            node: int,
            side: int,
            shape: str,
            size: float,
            petiole: float,
            *,
            turn: float = 0.0,
            tip: float = -1.0,
            like: Leaf | None = None,
        ) -> Leaf:
            hangs = tip < 0 and petiole > 0.3 and rng.random() < 0.35
            if hangs:  # short-stalked, down along the stem and before it
                petiole = rng.uniform(0.3, 1.1)
                turn += rng.uniform(1.3, 2.2) * side
            born = 0.0 if node < 2 or tip >= 0 else float(self.growth.births_h[node])
            leaf = Leaf(
                node=node,
                side=side,
                blade=grow_blade(shape, rng, pale if shape == "seed leaf" else self.leaf_tone),
                blade_cm=size * rng.uniform(0.85, 1.15),
                petiole_cm=petiole,
                petiole_mm=float(np.clip(self.tip_cm * 10 * rng.uniform(0.6, 1.0), 0.8, 2.2)),
                angle_rad=math.radians(rng.uniform(40, 85)),
                turn_rad=turn + rng.normal(0, 0.25),
                flat=1.0
                if shape in ("lens", "seed leaf")
                else float(rng.choice([0.12, rng.uniform(0.3, 1.0)], p=[0.2, 0.8])),
                grown_h=float(rng.uniform(16, 40)),
                born_h=born,
                before=bool(hangs or rng.random() < 0.5),
                at_tip_cm=tip,
                sway=(float(rng.uniform(0.03, 0.25)), float(rng.uniform(0, 24))),
            )
            if like is not None:
                leaf = replace(
                    leaf, angle_rad=like.angle_rad, petiole_mm=like.petiole_mm, grown_h=like.grown_h, sway=like.sway
                )
            leaves.append(leaf)
            return leaf

        for side in (-1, 1):
            if rng.random() < 0.8:
                add(0, side, "seed leaf", rng.uniform(0.9, 1.8), rng.uniform(0.02, 0.3))
        for side in (-1, 1):
            shape = str(rng.choice(shapes)) if shapes else (self.shape if rng.random() < 0.85 else "lens")
            add(1, side, shape, sizes[1], rng.uniform(0.6, 3.5))
        for node in range(2, self.growth.births_h.size):
            petiole = rng.uniform(0.8, 4.5)
            side = 1 if (node % 2 == 0) == turned else -1
            shape = str(rng.choice(shapes)) if shapes else (self.shape if rng.random() < 0.8 else "lens")
            if rng.random() < 0.6:
                middle = add(node, side, shape, sizes[node] * 0.8, petiole)
                for turn in (-1.1, 1.1):
                    add(node, side, shape, sizes[node] * 0.8, petiole, turn=turn, like=middle)
            else:
                add(node, side, shape, sizes[node], petiole)
        for _ in range(int(rng.integers(1, 5))):
            add(
                -1,
                int(rng.choice([-1, 1])),
                str(rng.choice(["lens", "ellipse", "ovate"])),
                rng.uniform(0.3, 1.1),
                0.0,
                tip=rng.uniform(0.02, 0.5),
            )
        return leaves

    def width_cm(self, posture: Posture) -> FloatArray:
        """Width along the stem; it ends round at the tip."""
        s, length = posture.along_cm, posture.length_cm
        aged = min(1.0, 0.55 + 0.45 * posture.time_s / (72 * 3600.0))
        base = max(self.tip_cm, self.base_cm * aged)
        width = self.tip_cm + (base - self.tip_cm) * (1 - s / length) ** self.taper
        end = np.clip((length - s) / (0.5 * self.tip_cm), 0.0, 1.0)
        return np.asarray(width * np.sqrt(1 - (1 - end) ** 2))

    def placed(self, posture: Posture) -> list[Placed]:
        """Where the leaves are; those that would hide too much of the stem hang behind it."""
        out: list[Placed] = []
        hidden = np.zeros(len(posture.line_cm), bool)
        for leaf in self.leaves:
            at = posture.length_cm - leaf.at_tip_cm if leaf.at_tip_cm >= 0 else posture.node_cm[leaf.node]
            hour = posture.time_s / 3600.0
            if math.isnan(at) or hour < leaf.born_h:
                continue
            put = self._put(leaf, posture, float(at), hour)
            if leaf.before:
                more = hidden | inside(posture.line_cm, put.upper_cm) | inside(posture.line_cm, put.lower_cm)
                if fair(posture, more):
                    hidden = more
                    put = replace(put, before=True)
            out.append(put)
        return out

    def _put(self, leaf: Leaf, posture: Posture, at_cm: float, hour: float) -> Placed:
        s = posture.along_cm
        foot = np.array([np.interp(at_cm, s, posture.line_cm[:, k]) for k in range(2)])
        heading = float(np.interp(at_cm, s, posture.heading_rad))
        size = 1.0 if leaf.at_tip_cm >= 0 else 1.0 / (1.0 + math.exp(-(hour - leaf.born_h - leaf.grown_h) / 8.0))
        size = max(size, 0.06)
        if leaf.blade.shape == "seed leaf":
            size = 1.0 - 0.5 * min(hour / 90.0, 1.0)
        swing, phase = leaf.sway
        open_rad = leaf.angle_rad * (0.7 + 0.3 * size) + swing * math.sin((hour + phase) * math.pi / 12)
        angle = heading + leaf.side * open_rad
        length = leaf.petiole_cm * size
        t = np.linspace(0.0, 1.0, 16)
        # a petiole sags outward
        turn = angle + leaf.side * 0.5 * size * t
        steps = np.column_stack([np.sin(turn), np.cos(turn)]) * (length / (t.size - 1))
        petiole = foot + np.vstack([np.zeros(2), np.cumsum(steps[:-1], axis=0)])
        blade_angle = float(turn[-1]) + leaf.turn_rad

        def where(points: FloatArray) -> FloatArray:
            return place(points, leaf.blade, petiole[-1], blade_angle, leaf.blade_cm * size, leaf.flat)

        veins = [where(v) for v in vein_lines(leaf.blade)]
        half_cm = 0.05 * leaf.petiole_mm * (0.45 + 0.55 * size)
        return Placed(leaf, petiole, half_cm, where(leaf.blade.upper), where(leaf.blade.lower), veins, False)

    def draw(self, canvas: Canvas, posture: Posture, lights: list[Lit], to_px: ToPx) -> None:
        """Draw leaves behind, stem, leaves before."""
        placed = self.placed(posture)
        for before in (False, True):
            if before:
                self._draw_stem(canvas, posture, lights, to_px)
            for put in placed:
                if put.before == before:
                    draw_leaf(canvas, put, self.top_tone, lights, to_px)

    def _draw_stem(self, canvas: Canvas, posture: Posture, lights: list[Lit], to_px: ToPx) -> None:
        share = np.clip(posture.along_cm / (0.6 * self.growth.end_cm), 0.0, 1.0)[:, None]
        tone = (self.foot_tone * (1 - share) + self.top_tone * share).astype(np.float32)
        half = 0.5 * self.width_cm(posture) * to_px.px_per_cm
        draw_strip(canvas, to_px(posture.line_cm), half, tone, lights, self.gloss)


def draw_leaf(canvas: Canvas, put: Placed, tone: Picture, lights: list[Lit], to_px: ToPx) -> None:
    """A petiole and its blade."""
    if put.leaf.petiole_cm > 0.05:
        line = to_px(put.petiole_cm)
        half = np.full(len(line), put.petiole_half_cm * to_px.px_per_cm)
        draw_strip(canvas, line, half, np.repeat(tone[None], len(line), 0), lights)
    veins = [to_px(v) for v in put.veins_cm]
    draw_blade(canvas, to_px(put.upper_cm), to_px(put.lower_cm), put.leaf.blade, lights, veins)


def extent_cm(posture: Posture, placed: list[Placed]) -> FloatArray:
    """Corners of all that is drawn, [[left, bottom], [right, top]]."""
    points = np.vstack([posture.line_cm, *(p.upper_cm for p in placed), *(p.lower_cm for p in placed)])
    return np.vstack([points.min(axis=0), points.max(axis=0)])
