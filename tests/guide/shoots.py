"""Shoots in three dimensions, whose leaves unfold from the apex as they age.

What wild plants lack: leaves that are seen from all sides and shade each other, youngest ones that stand round the apex
and hide it, petioles in every direction, hooks that turn towards the camera. Every trait is drawn by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from guide.canvas import Floats
from guide.surfaces import Surfaces
from guide.vectors import UP, Stem, across, bent, perpendicular, unit

STEP_CM: Final = 0.12
ALONG, ACROSS = 11, 9
"""Points of a blade."""
MOST_NODES: Final = 18
LEAST_AHEAD: Final = 0.15
OFF_LINE: Final = np.array([0.01, 0.02, 0.03])
"""A hook that would turn to where it points already turns a little beside that."""
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
    stalk_width: float
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

    slenderest: ClassVar = 0.35
    """The stem's end is no slenderer than that share of its foot."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.surfaces = Surfaces()

    def grow(self) -> Floats:
        """Its surfaces, and its stem's axis, shape (n, 3), anchor first, apex last."""
        rng = self._rng
        length = float(np.exp(rng.uniform(np.log(1.2), np.log(21.0))))
        habit = self._habit(length)
        lean = rng.normal(size=2) * (0.25 if rng.random() < 0.85 else 0.9)
        hook = 0.0, 1.0
        if rng.random() < (0.8 if habit == "seedling" else 0.35):
            hook = float(rng.uniform(0.6, 3.3)), float(rng.uniform(0.5, min(4.0, 0.7 * length)))
        azimuth = rng.normal() * 0.6 + np.pi * (rng.random() < 0.5) if rng.random() < 0.7 else rng.uniform(0, 2 * np.pi)
        towards = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
        axis, tangent = self._axis(length, np.array([lean[0], 1.0, lean[1]]), hook, towards)
        width = min(float(rng.uniform(0.12, 0.65)), 0.15 + 0.12 * length)
        leaf = self._leafage(habit, length)
        stem, to_apex = self._stem(axis, tangent, width, leaf)
        if habit != "bare":
            self._leaves(stem, leaf, habit)
        if habit == "leafy" and rng.random() < 0.5:
            self._closed(stem, leaf)
        if rng.random() < (0.85 if habit == "seedling" else 0.35):
            self._cotyledons(stem, leaf, habit)
        return to_apex

    def _habit(self, length: float) -> str:
        """What it looks like, for a stem of that length, cm."""
        chances = [0.7, 0.1, 0.07, 0.13] if length < 9 else [0.8, 0.12, 0.08, 0.0]
        return str(self._rng.choice(["leafy", "grass", "bare", "seedling"], p=chances))

    def _stem(self, axis: Floats, tangent: Floats, width: float, leaf: Leafage) -> tuple[Stem, Floats]:
        """What leaves stand on, with its surface, and its axis as far as the apex."""
        rng, colour = self._rng, self._stem_colour(leaf)
        radius = 0.5 * width * np.linspace(1.0, rng.uniform(self.slenderest, 0.95), len(axis))
        end = radius[-1]
        to_end = np.cumsum(np.linalg.norm(np.diff(axis[::-1], axis=0, prepend=axis[-1:]), axis=1))[::-1]
        inside = np.clip(1.0 - to_end / (1.6 * end), 0.0, 1.0)
        self.surfaces.tube(
            axis, np.maximum(0.02, radius * np.sqrt(1.0 - 0.95 * inside**2)), colour(np.linspace(0, 1, len(axis)))
        )
        return Stem(axis, tangent, to_end, radius), axis[to_end >= (1.0 - ROUND_END) * end]

    def _axis(
        self, length: float, tangent: Floats, hook: tuple[float, float], towards: Floats
    ) -> tuple[Floats, Floats]:
        """A stem's axis, and its direction at each point, both shape (n, 3).

        Args:
            length: of it, cm.
            tangent: its direction at the anchor.
            hook: rad by which it turns, cm from its end over which it does.
            towards: where its hook turns to.
        """
        rng = self._rng
        count = max(12, int(length / STEP_CM))
        step = length / (count - 1)
        wander = np.cumsum(rng.normal(size=(count, 3)), axis=0) * np.sqrt(step) * (abs(rng.normal()) * 0.06 + 0.01)
        wander -= wander.mean(axis=0) * rng.random()
        turn, over = hook
        upwards, lit = float(rng.uniform(0, 0.25)), float(rng.normal() * 0.08)
        zigzag = float(rng.uniform(0.1, 0.5)) * (rng.random() < 0.15)
        node = float(rng.uniform(1.0, 3.0))
        directions = np.empty((count, 3))
        for k in range(count):
            tangent = tangent / np.linalg.norm(tangent)
            directions[k] = tangent
            change = wander[k] + upwards * UP + lit * towards
            if (count - 1 - k) * step < over and turn:
                ahead = across(towards, tangent)
                if np.linalg.norm(ahead) <= LEAST_AHEAD:
                    ahead = across(towards + OFF_LINE, tangent)
                change = change + turn / over * unit(ahead)
                towards = towards - 0.9 * step * turn / over * tangent
            if zigzag and int(k * step / node) != int((k - 1) * step / node):
                change = change + (1 if int(k * step / node) % 2 else -1) * zigzag / step * np.array([1.0, 0.0, 0.2])
            tangent = tangent + step * change
        places = np.concatenate([np.zeros((1, 3)), np.cumsum(directions[:-1] * step, axis=0)])
        return places, directions

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
            stalk_width=float(rng.uniform(0.25, 0.6) if rng.random() < 0.75 else rng.uniform(0.6, 1.0)),
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

    def _leaves(self, stem: Stem, leaf: Leafage, habit: str) -> None:
        rng = self._rng
        length, below = stem.to_end_cm[0], float(rng.uniform(0.0, 0.25))
        full_cm, zone = float(rng.uniform(0.7, 6.0)), float(rng.uniform(0.3, 3.0))
        count, onwards = self._around()
        azimuth = float(rng.uniform(0, 2 * np.pi))
        lowest = max(0.6, float(rng.uniform(0.1, 0.6) if rng.random() < 0.5 else 0.93) * length)
        ripe, smallest = float(rng.uniform(0.3, max(0.8, 0.4 * length))), float(rng.uniform(0.05, 0.4))
        number = 0
        while below < lowest and number < MOST_NODES:
            age = (1.0 - np.exp(-((below / ripe) ** 1.3))) * (0.5 if habit == "seedling" else 1.0)
            self._node(stem, below, azimuth, leaf, count, smallest + (1 - smallest) * age, age)
            azimuth += onwards + rng.normal() * 0.15
            below += float(0.06 + full_cm * (1.0 - np.exp(-(below + 0.05) / zone)) * rng.uniform(0.7, 1.3))
            number += 1
        if rng.random() < 0.1:
            self._rosette(stem, leaf, int(rng.integers(2, 8)))

    def _around(self) -> tuple[int, float]:
        """Leaves of a node, and by how much the next node is turned, rad."""
        around = str(self._rng.choice(["alternate", "spiral", "opposite", "whorl"], p=[0.3, 0.3, 0.3, 0.1]))
        onwards = {"alternate": np.pi, "spiral": 2.4, "opposite": np.pi / 2, "whorl": np.pi / 3}[around]
        return {"opposite": 2, "whorl": 3}.get(around, 1), onwards

    def _node(
        self, stem: Stem, below_cm: float, azimuth: float, leaf: Leafage, count: int, size: float, age: float
    ) -> None:
        """The leaves of a node so far below the end, of which now and then one is missing."""
        for k in range(count):
            if self._rng.random() < 0.94:
                self._leaf(stem, stem.at(below_cm), azimuth + 2 * np.pi * k / max(2, count), leaf, size, age)

    def _closed(self, stem: Stem, leaf: Leafage) -> None:
        """The youngest leaves, closed upon each other over the apex, which lies at their foot."""
        rng = self._rng
        count, azimuth, together = int(rng.integers(1, 5)), float(rng.uniform(0, 2 * np.pi)), abs(rng.normal()) * 0.2
        young = replace(
            leaf,
            form=leaf.form if rng.random() < 0.5 else "simple",
            size_cm=float(np.exp(rng.uniform(np.log(0.25), np.log(2.2)))),
            stalk=0.0,
            aspect=float(rng.uniform(0.2, 0.8)),
            young_at=together,
            old_at=together + 0.4,
            curl=-abs(rng.normal()) * 0.5,
        )
        for k in range(count):
            below, age = float(rng.uniform(0.0, 0.1)), float(rng.uniform(0.0, 0.4))
            turn = azimuth + 2 * np.pi * k / count
            self._leaf(stem, stem.at(below), turn, young, float(rng.uniform(0.5, 1.1)), age)

    def _rosette(self, stem: Stem, leaf: Leafage, count: int) -> None:
        for _ in range(count):
            self._leaf(stem, 1, float(self._rng.uniform(0, 2 * np.pi)), leaf, float(self._rng.uniform(0.5, 1.0)), 1.0)

    def _leaf(self, stem: Stem, at: int, azimuth: float, leaf: Leafage, size: float, age: float) -> None:
        """A leaf on its stalk: of some share of its full size, and of an age from 0, folded and steep, to 1."""
        rng = self._rng
        size *= float(rng.uniform(0.8, 1.2))
        tangent, radius = stem.tangent[at], stem.radius_cm[at]
        aside = perpendicular(tangent, azimuth)
        angle = leaf.young_at + (leaf.old_at - leaf.young_at) * age + rng.normal() * 0.12
        heading = np.cos(angle) * tangent + np.sin(angle) * aside
        base = stem.axis[at] + aside * radius * 0.6
        stalk = leaf.stalk * size * (0.2 + 0.8 * age)
        if stalk > 0.15:
            path = bent(base, heading, stalk, leaf.droop * age * 0.5 - 0.12 * (1 - age), rng.normal(size=3) * 0.05)
            thick = np.linspace(1.0, 0.75, len(path)) * max(
                0.03, radius * leaf.stalk_width * rng.uniform(0.8, 1.1) * min(1.0, 0.4 + size)
            )
            self.surfaces.tube(path, thick, leaf.stalk_colour, sides=6)
            base, heading = path[-1], unit(path[-1] - path[-2])
        length = leaf.size_cm * size
        level = unit(
            np.cross(heading, np.cross(UP, heading))
            + 0.25 * rng.normal(size=3)
            + 0.3 * np.cross(heading, np.cross(tangent, heading))
        )
        if leaf.form in ("simple", "peltate"):
            if leaf.form == "peltate":  # its stalk stands under its middle
                heading = unit(np.cross(np.cross(heading, aside + 0.2 * UP), heading) + (1.0 - age) * heading)
                base = base - 0.45 * length * heading
            self._blade(base, heading, level, length, leaf, age)
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
                    age,
                )
            return
        path = bent(base, heading, max(0.3, length), leaf.droop * age, rng.normal(size=3) * 0.03)
        self.surfaces.tube(path, np.full(len(path), max(0.025, 0.25 * radius)), leaf.stalk_colour, sides=5)
        pairs = int(rng.integers(2, 5))
        for share in np.linspace(0.25, 0.9, pairs):
            at = int(share * (len(path) - 1))
            for sign in (-1, 1):
                turn = sign * (0.3 + 0.8 * age)
                way = unit(path[at] - path[at - 1]) if at else heading
                self._blade(path[at], np.cos(turn) * way + np.sin(turn) * side, level, length * 0.42, leaf, age)
        if rng.random() < 0.75:
            self._blade(path[-1], unit(path[-1] - path[-2]), level, length * 0.45, leaf, age)
        else:
            tendril = bent(
                path[-1], unit(path[-1] - path[-2]), float(rng.uniform(0.5, 3.0)), 0.0, rng.normal(size=3) * 1.5
            )
            self.surfaces.tube(tendril, np.full(len(tendril), 0.025), leaf.stalk_colour, sides=4)

    def _blade(self, base: Floats, heading: Floats, level: Floats, length: float, leaf: Leafage, age: float) -> None:
        rng, fold = self._rng, 1.25 * (1 - age) ** 1.5 + leaf.fold * 0.5
        u, v = np.linspace(0.0, 1.0, ALONG), np.linspace(-1.0, 1.0, ACROSS)
        outline = u ** (leaf.widest / (1.0 - leaf.widest)) * (1.0 - u)
        half = (outline / outline.max()) ** 0.75 * 0.5 * leaf.aspect * length
        if leaf.teeth:
            half = half * (1.0 - leaf.teeth * (0.5 + 0.5 * np.sin(u * leaf.teeth_count)))
        side = unit(np.cross(heading, level))
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

    def _cotyledons(self, stem: Stem, leaf: Leafage, habit: str) -> None:
        rng = self._rng
        is_young = habit == "seedling"
        at = stem.at(rng.uniform(0, 0.3) if is_young else rng.uniform(0.2, 0.9) * stem.to_end_cm[0])
        azimuth = float(rng.uniform(0, 2 * np.pi))
        opened = float(abs(rng.normal()) * 0.5 if is_young else rng.uniform(0.6, 1.9))
        size, thick = float(rng.uniform(0.5, 2.0)), float(rng.uniform(0.12, 0.45))
        pale = np.array([rng.uniform(0.1, 0.5), rng.uniform(0.6, 0.95), 1.0]) * rng.uniform(0.15, 0.6)
        colour = pale + (leaf.front - pale) * rng.random()
        for turn in (azimuth, azimuth + np.pi)[: 1 if rng.random() < 0.15 else 2]:
            aside = perpendicular(stem.tangent[at], turn)
            heading = np.cos(opened) * stem.tangent[at] + np.sin(opened) * aside
            base = stem.axis[at] + aside * (stem.radius_cm[at] + 0.2 * thick * size * is_young)
            path = bent(base, heading, size, rng.normal() * 0.2, np.zeros(3))
            share = np.linspace(0.0, 1.0, len(path))
            swell = np.sqrt(np.maximum(0.0, 1.0 - (2.0 * share - 1.0) ** 2)) * 0.5 * size * thick
            self.surfaces.tube(path, np.maximum(swell, 0.02), np.clip(colour, 0.01, 0.9), sides=10)
