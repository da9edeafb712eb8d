"""Shoots in three dimensions, whose leaves unfold from the apex as they age.

What wild plants lack: leaves that are seen from all sides and shade each other, youngest ones that stand round the apex
and hide it, petioles in every direction, hooks that turn towards the camera. Every trait is drawn by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from guide.canvas import Floats
from guide.surfaces import Surfaces

STEP_CM: Final = 0.12
UP: Final = np.array([0.0, 1.0, 0.0])
ALONG, ACROSS = 11, 9
"""Points of a blade."""
ROUND_END: Final = 0.7
"""Where the apex lies in its rounded end, as a share of the half width."""


@dataclass(frozen=True, slots=True)
class Leafage:
    """What all leaves of a plant have in common."""

    form: str
    size_cm: float
    aspect: float
    widest: float
    stalk: float
    young_at: float
    old_at: float
    droop: float
    curl: float
    fold: float
    wave: float
    teeth: float
    teeth_count: float
    front: Floats
    back: Floats
    rib: Floats
    rib_width: float
    margin: Floats
    margin_width: float
    mottled: float
    stalk_colour: Floats


class Shoot:
    """A shoot of any habit.

    Args:
        rng: of everything.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.surfaces = Surfaces()

    def grow(self) -> Floats:
        """Its surfaces, and its stem's axis, shape (n, 3), anchor first, apex last."""
        rng = self._rng
        length = float(np.exp(rng.uniform(np.log(1.2), np.log(21.0))))
        habit = str(
            rng.choice(
                ["leafy", "grass", "bare", "seedling"],
                p=[0.7, 0.1, 0.07, 0.13] if length < 9 else [0.8, 0.12, 0.08, 0.0],
            )
        )
        axis, tangent = self._axis(length, is_hooked=rng.random() < (0.8 if habit == "seedling" else 0.35))
        width = min(float(rng.uniform(0.12, 0.65)), 0.15 + 0.12 * length)
        leaf = self._leafage(habit, length)
        stem = self._stem_colour(leaf)
        radius = 0.5 * width * np.linspace(1.0, rng.uniform(0.35, 0.95), len(axis))
        end = radius[-1]
        to_end = np.cumsum(np.linalg.norm(np.diff(axis[::-1], axis=0, prepend=axis[-1:]), axis=1))[::-1]
        inside = np.clip(1.0 - to_end / (1.6 * end), 0.0, 1.0)
        self.surfaces.tube(
            axis, np.maximum(0.02, radius * np.sqrt(1.0 - 0.95 * inside**2)), stem(np.linspace(0, 1, len(axis)))
        )
        if habit != "bare":
            self._leaves(axis, tangent, to_end, radius, leaf, habit)
        if rng.random() < (0.85 if habit == "seedling" else 0.35):
            self._cotyledons(axis, tangent, to_end, radius, leaf, habit)
        if rng.random() < (0.4 if habit == "bare" else 0.06):
            self._flowers(axis, tangent, end, leaf)
        return axis[to_end >= (1.0 - ROUND_END) * end]

    def _axis(self, length: float, *, is_hooked: bool) -> tuple[Floats, Floats]:
        """A stem's axis, and its direction at each point."""
        rng = self._rng
        count = max(12, int(length / STEP_CM))
        step = length / (count - 1)
        wander = np.cumsum(rng.normal(size=(count, 3)), axis=0) * np.sqrt(step) * (abs(rng.normal()) * 0.06 + 0.01)
        wander -= wander.mean(axis=0) * rng.random()
        turn, over = 0.0, 1.0
        if is_hooked:
            turn, over = float(rng.uniform(0.6, 3.3)), float(rng.uniform(0.5, min(4.0, 0.7 * length)))
        lean = rng.normal(size=2) * (0.25 if rng.random() < 0.85 else 0.9)
        tangent = np.array([lean[0], 1.0, lean[1]])
        azimuth = rng.normal() * 0.6 + np.pi * (rng.random() < 0.5) if rng.random() < 0.7 else rng.uniform(0, 2 * np.pi)
        towards = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
        upwards, lit = float(rng.uniform(0, 0.25)), float(rng.normal() * 0.08)
        zigzag = float(rng.uniform(0.1, 0.5)) * (rng.random() < 0.15)
        node = float(rng.uniform(1.0, 3.0))
        directions = np.empty((count, 3))
        for k in range(count):
            tangent = tangent / np.linalg.norm(tangent)
            directions[k] = tangent
            change = wander[k] + upwards * UP + lit * towards
            if (count - 1 - k) * step < over and turn:
                plane = np.cross(tangent, np.cross(tangent, towards + 0.3 * tangent))
                ahead = -plane if np.linalg.norm(plane) > 0.15 else self._hook_side(tangent, towards)
                change = change + turn / over * (ahead / (np.linalg.norm(ahead) + 1e-9))
                towards = towards - 0.9 * step * turn / over * tangent
            if zigzag and int(k * step / node) != int((k - 1) * step / node):
                change = change + (1 if int(k * step / node) % 2 else -1) * zigzag / step * np.array([1.0, 0.0, 0.2])
            tangent = tangent + step * change
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(directions[:-1] * step, axis=0)])
        return places, directions

    @staticmethod
    def _hook_side(tangent: Floats, towards: Floats) -> Floats:
        return np.cross(np.cross(tangent, towards + np.array([0.01, 0.02, 0.03])), tangent)

    def _leafage(self, habit: str, length: float) -> Leafage:
        rng = self._rng
        green = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
        front = green * np.array([rng.uniform(0.1, 0.6), 1.0, rng.uniform(0.25, 0.95)])
        if rng.random() < 0.08:
            front = front[[1, 0, 2]] * [rng.uniform(0.2, 0.8), 0.4, rng.uniform(1.0, 1.6)]
        pale = front * rng.uniform(1.0, 1.9) + rng.uniform(0, 0.08)
        back = pale if rng.random() < 0.9 else pale * [0.9, 0.5, 1.2]
        stalk = (
            front + (pale - front) * rng.random()
            if rng.random() < 0.6
            else front * [1.0, rng.uniform(0.4, 1.0), rng.uniform(1.0, 2.5)]
        )
        is_grass = habit == "grass"
        size = float(rng.uniform(3, 11) if is_grass else rng.uniform(0.8, 7.5)) * min(1.0, 0.4 + length / 9.0)
        form = str(
            rng.choice(["simple", "threefold", "pinnate", "palmate", "peltate"], p=[0.58, 0.13, 0.16, 0.07, 0.06])
        )
        aspect = float(rng.uniform(0.25, 1.05)) if rng.random() < 0.8 else float(rng.uniform(0.08, 0.25))
        return Leafage(
            form="simple" if is_grass or habit == "seedling" else form,
            size_cm=size,
            aspect=float(rng.uniform(0.03, 0.12)) if is_grass else aspect,
            widest=float(rng.uniform(0.2, 0.7)),
            stalk=0.0 if is_grass or rng.random() < 0.15 else float(rng.uniform(0.1, 1.6) * size),
            young_at=float(rng.uniform(0.05, 0.5)),
            old_at=float(rng.uniform(0.25, 1.0) if is_grass else rng.uniform(0.35, 1.8)),
            droop=float(rng.uniform(0, 0.35)),
            curl=float(rng.normal() * 0.5 + 0.5),
            fold=float(rng.uniform(0, 0.9)),
            wave=float(rng.uniform(0, 0.25) * (rng.random() < 0.4)),
            teeth=float(rng.uniform(0.05, 0.5) * (rng.random() < 0.4)),
            teeth_count=float(rng.uniform(15, 60)),
            front=front,
            back=back,
            rib=pale * rng.uniform(0.8, 1.6),
            rib_width=float(rng.uniform(0, 0.2)),
            margin=front * np.exp(rng.normal(size=3) * 0.6),
            margin_width=float(rng.uniform(0.15, 0.5)) * (rng.random() < 0.12),
            mottled=float(rng.uniform(0.1, 0.6) * (rng.random() < 0.2)),
            stalk_colour=np.clip(stalk, 0.01, 0.9),
        )

    def _stem_colour(self, leaf: Leafage) -> Callable[[Floats], Floats]:
        """Colours at shares of its length."""
        rng = self._rng
        kind = rng.random()
        if kind < 0.4:
            low = leaf.stalk_colour * np.exp(rng.normal() * 0.15)
        elif kind < 0.7:
            low = leaf.front * rng.uniform(1.0, 2.2) + rng.uniform(0.0, 0.25) * np.array([0.7, 0.95, 1.0])
        else:
            low = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4)))) * np.array(
                [rng.uniform(0.2, 0.8), rng.uniform(0.3, 0.9), 1.0]
            )
        high = low + (leaf.stalk_colour - low) * rng.random()
        mottle = 1.0 + rng.uniform(0, 0.15) * rng.normal(size=400)

        def of(share: Floats) -> Floats:
            colours = low + (high - low) * share[:, None]
            return np.clip(colours * mottle[: len(share), None], 0.01, 0.9)

        return of

    def _leaves(self, axis: Floats, tangent: Floats, to_end: Floats, radius: Floats, leaf: Leafage, habit: str) -> None:
        rng = self._rng
        length, below = to_end[0], float(rng.uniform(0.0, 0.25))
        full_cm, zone = float(rng.uniform(0.7, 6.0)), float(rng.uniform(0.3, 3.0))
        around = str(rng.choice(["alternate", "spiral", "opposite", "whorl"], p=[0.3, 0.3, 0.3, 0.1]))
        azimuth, lowest = (
            float(rng.uniform(0, 2 * np.pi)),
            float(rng.uniform(0.1, 0.6) if rng.random() < 0.5 else 0.93) * length,
        )
        lowest, ripe = max(lowest, 0.6), float(rng.uniform(0.3, max(0.8, 0.4 * length)))
        smallest = float(rng.uniform(0.05, 0.4))
        number = 0
        while below < lowest and number < 18:
            age = 1.0 - np.exp(-((below / ripe) ** 1.3))
            if habit == "seedling":
                age *= 0.5
            at = int(np.searchsorted(-to_end, -below).clip(1, len(axis) - 1))
            for k in range({"opposite": 2, "whorl": 3}.get(around, 1)):
                if rng.random() < 0.94:
                    turn = azimuth + 2 * np.pi * k / (3 if around == "whorl" else 2)
                    self._leaf(axis[at], tangent[at], turn, radius[at], leaf, smallest + (1 - smallest) * age, age)
            azimuth += {"alternate": np.pi, "spiral": 2.4, "opposite": np.pi / 2, "whorl": np.pi / 3}[
                around
            ] + rng.normal() * 0.15
            below += float(0.06 + full_cm * (1.0 - np.exp(-(below + 0.05) / zone)) * rng.uniform(0.7, 1.3))
            number += 1
        for _ in range(rng.integers(2, 8) if rng.random() < 0.1 else 0):  # a rosette
            self._leaf(
                axis[1],
                tangent[1],
                float(rng.uniform(0, 2 * np.pi)),
                radius[1],
                leaf,
                float(rng.uniform(0.5, 1.0)),
                1.0,
            )

    def _leaf(
        self, base: Floats, stem: Floats, azimuth: float, radius: float, leaf: Leafage, size: float, age: float
    ) -> None:
        """A leaf on its stalk: of some share of its full size, and of an age from 0, folded and steep, to 1."""
        rng = self._rng
        size *= float(rng.uniform(0.8, 1.2))
        aside = _perpendicular(stem, azimuth)
        angle = leaf.young_at + (leaf.old_at - leaf.young_at) * age + rng.normal() * 0.12
        heading = np.cos(angle) * stem + np.sin(angle) * aside
        base = base + aside * radius * 0.6
        stalk = leaf.stalk * size * (0.2 + 0.8 * age)
        if stalk > 0.15:
            path = _bent(base, heading, stalk, leaf.droop * age * 0.5 - 0.12 * (1 - age), rng.normal(size=3) * 0.05)
            thick = np.linspace(1.0, 0.75, len(path)) * max(
                0.03, radius * rng.uniform(0.25, 0.6) * min(1.0, 0.4 + size)
            )
            self.surfaces.tube(path, thick, leaf.stalk_colour, sides=6)
            base, heading = path[-1], _unit(path[-1] - path[-2])
        length, fold = leaf.size_cm * size, 1.25 * (1 - age) ** 1.5 + leaf.fold * 0.5
        level = _unit(
            np.cross(heading, np.cross(UP, heading))
            + 0.25 * rng.normal(size=3)
            + 0.3 * np.cross(heading, np.cross(stem, heading))
        )
        if leaf.form in ("simple", "peltate"):
            if leaf.form == "peltate":  # its stalk stands under its middle
                heading = _unit(np.cross(np.cross(heading, aside + 0.2 * UP), heading) + (1.0 - age) * heading)
                base = base - 0.45 * length * heading
            self._blade(base, heading, level, length, leaf, fold, age)
            return
        side = np.cross(heading, level)
        if leaf.form in ("threefold", "palmate"):
            for opened in (-1.1, 0.0, 1.1) if leaf.form == "threefold" else (-1.6, -0.8, 0.0, 0.8, 1.6):
                turn = opened * (0.25 + 0.75 * age)
                self._blade(
                    base,
                    np.cos(turn) * heading + np.sin(turn) * side,
                    level,
                    length * (0.75 - 0.1 * abs(turn)),
                    leaf,
                    fold,
                    age,
                )
            return
        path = _bent(base, heading, max(0.3, length), leaf.droop * age, rng.normal(size=3) * 0.03)
        self.surfaces.tube(path, np.full(len(path), max(0.025, 0.25 * radius)), leaf.stalk_colour, sides=5)
        pairs = int(rng.integers(2, 5))
        for share in np.linspace(0.25, 0.9, pairs):
            at = int(share * (len(path) - 1))
            for sign in (-1, 1):
                turn = sign * (0.3 + 0.8 * age)
                way = _unit(path[at] - path[at - 1]) if at else heading
                self._blade(path[at], np.cos(turn) * way + np.sin(turn) * side, level, length * 0.42, leaf, fold, age)
        if rng.random() < 0.75:
            self._blade(path[-1], _unit(path[-1] - path[-2]), level, length * 0.45, leaf, fold, age)
        else:
            tendril = _bent(
                path[-1], _unit(path[-1] - path[-2]), float(rng.uniform(0.5, 3.0)), 0.0, rng.normal(size=3) * 1.5
            )
            self.surfaces.tube(tendril, np.full(len(tendril), 0.025), leaf.stalk_colour, sides=4)

    def _blade(
        self, base: Floats, heading: Floats, level: Floats, length: float, leaf: Leafage, fold: float, age: float
    ) -> None:
        rng = self._rng
        u, v = np.linspace(0.0, 1.0, ALONG), np.linspace(-1.0, 1.0, ACROSS)
        outline = u ** (leaf.widest / (1.0 - leaf.widest)) * (1.0 - u)
        half = (outline / outline.max()) ** 0.75 * 0.5 * leaf.aspect * length
        if leaf.teeth:
            half = half * (1.0 - leaf.teeth * (0.5 + 0.5 * np.sin(u * leaf.teeth_count)))
        side = _unit(np.cross(heading, level))
        level = np.cross(side, heading)
        curl = (leaf.curl + rng.normal() * 0.25) * (0.3 + age) * u
        ahead = np.cos(curl)[:, None] * heading - np.sin(curl)[:, None] * level
        over = np.sin(curl)[:, None] * heading + np.cos(curl)[:, None] * level
        middle = base + np.concatenate([np.zeros((1, 3)), np.cumsum(ahead[1:] * length / (ALONG - 1), axis=0)])
        lift = np.sin(fold) * np.abs(v)[None] + leaf.wave * np.sin(9.0 * u[:, None] + rng.uniform(0, 6)) * v[None] ** 2
        grid = middle[:, None] + half[:, None, None] * (
            np.cos(fold) * v[None, :, None] * side + lift[..., None] * over[:, None]
        )
        away = np.abs(0.5 * (v[1:] + v[:-1]))
        tone = np.exp(rng.normal() * 0.08) * (1.0 + 0.25 * (1 - age))
        front = np.broadcast_to(leaf.front * tone, (ALONG - 1, ACROSS - 1, 3)).copy()
        front[:, away > 1.0 - leaf.margin_width] = leaf.margin * tone
        if leaf.mottled:
            front *= np.exp(rng.normal(size=(ALONG - 1, ACROSS - 1, 1)) * leaf.mottled)
        back = np.broadcast_to(leaf.back * tone, front.shape).copy()
        front, back = np.clip(front, 0.01, 0.9), np.clip(back, 0.01, 0.9)
        self.surfaces.sheet(grid, front, back)
        if leaf.rib_width > 0.04:
            rib = 0.5 * leaf.rib_width * np.linspace(1.0, 0.15, ALONG) * min(0.35, half.max())
            self.surfaces.tube(middle, np.maximum(rib, 0.015), np.clip(leaf.rib * tone, 0.01, 0.9), sides=4)

    def _cotyledons(
        self, axis: Floats, tangent: Floats, to_end: Floats, radius: Floats, leaf: Leafage, habit: str
    ) -> None:
        rng = self._rng
        is_young = habit == "seedling"
        at = int(
            np.searchsorted(-to_end, -(rng.uniform(0, 0.3) if is_young else rng.uniform(0.2, 0.9) * to_end[0])).clip(
                1, len(axis) - 1
            )
        )
        azimuth, opened = (
            float(rng.uniform(0, 2 * np.pi)),
            float(abs(rng.normal()) * 0.5 if is_young else rng.uniform(0.6, 1.9)),
        )
        size, thick = float(rng.uniform(0.5, 2.0)), float(rng.uniform(0.12, 0.45))
        pale = np.array([rng.uniform(0.1, 0.5), rng.uniform(0.6, 0.95), 1.0]) * rng.uniform(0.15, 0.6)
        colour = pale + (leaf.front - pale) * rng.random()
        for turn in (azimuth, azimuth + np.pi)[: 1 if rng.random() < 0.15 else 2]:
            aside = _perpendicular(tangent[at], turn)
            heading = np.cos(opened) * tangent[at] + np.sin(opened) * aside
            base = axis[at] + aside * (radius[at] + 0.2 * thick * size * is_young)
            path = _bent(base, heading, size, rng.normal() * 0.2, np.zeros(3))
            share = np.linspace(0.0, 1.0, len(path))
            swell = np.sqrt(np.maximum(0.0, 1.0 - (2.0 * share - 1.0) ** 2)) * 0.5 * size * thick
            self.surfaces.tube(path, np.maximum(swell, 0.02), np.clip(colour, 0.01, 0.9), sides=10)

    def _flowers(self, axis: Floats, tangent: Floats, radius: float, leaf: Leafage) -> None:
        rng = self._rng
        colour = np.exp(rng.normal(size=3) * 0.5) * rng.uniform(0.1, 0.8)
        for _ in range(rng.integers(1, 12)):
            aside = _perpendicular(tangent[-1], float(rng.uniform(0, 2 * np.pi)))
            angle = float(rng.uniform(0, 1.5))
            path = _bent(
                axis[-1],
                np.cos(angle) * tangent[-1] + np.sin(angle) * aside,
                float(rng.uniform(0.15, 1.0)),
                0.1,
                np.zeros(3),
            )
            self.surfaces.tube(path, np.full(len(path), max(0.02, 0.3 * radius)), leaf.stalk_colour, sides=4)
            size, heading = float(rng.uniform(0.08, 0.3)), _unit(path[-1] - path[-2])
            bud = _bent(path[-1], heading, 2 * size, 0.0, np.zeros(3))
            share = np.linspace(0, 1, len(bud))
            lit = np.clip(leaf.stalk_colour + (colour - leaf.stalk_colour) * rng.random(), 0.01, 0.9)
            self.surfaces.tube(bud, size * np.sqrt(np.maximum(0.02, 1 - (2 * share - 1) ** 2)), lit, sides=7)


def _unit(vector: Floats) -> Floats:
    return vector / (np.linalg.norm(vector) + 1e-9)


def _perpendicular(direction: Floats, azimuth: float) -> Floats:
    """The unit vector across a direction at an angle about it."""
    across = _unit(np.cross(direction, [0.05, 0.1, 1.0]))
    return np.cos(azimuth) * across + np.sin(azimuth) * np.cross(direction, across)


def _bent(base: Floats, heading: Floats, length: float, droop: float, wander: Floats) -> Floats:
    """A line from a place in a direction, that hangs by some rad per cm, shape (n, 3)."""
    count = max(7, int(length / 0.25))
    step, places = length / (count - 1), [base]
    for _ in range(count - 1):
        heading = _unit(heading + step * (wander - droop * UP))
        places.append(places[-1] + step * heading)
    return np.array(places)
