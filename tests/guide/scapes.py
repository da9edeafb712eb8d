"""Flowering stalks in three dimensions, upright, leaning or level, that end among buds.

What leafy shoots lack: an end that is a cluster of buds, whose apex is in their midst; leaves that stand close round
it; a rosette at the foot; stalks that were laid level and turn upwards again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from guide.canvas import Floats
from guide.shoots import Leafage, Shoot
from guide.vectors import UP, Stem, bent, perpendicular, unit


class Scape(Shoot):
    """A flowering stalk.

    Args:
        rng: of everything.
    """

    def grow(self) -> Floats:
        """Its surfaces, and its axis, shape (n, 3), anchor first, apex last."""
        rng = self._rng
        is_level = rng.random() < 0.3
        length = float(np.exp(rng.uniform(np.log(1.5), np.log(10.0 if is_level else 20.0))))
        side = rng.choice([-1.0, 1.0])
        lean = np.array([rng.normal() * 0.35, 1.0, rng.normal() * 0.25])
        hook = float(rng.uniform(0.2, 2.0)), float(rng.uniform(0.3, 1.0) * length)
        towards = np.array([side, 0.0, rng.normal() * 0.4])
        if is_level:
            lean = np.array([side, rng.normal() * 0.35, rng.normal() * 0.3])
            towards = UP + rng.normal(size=3) * 0.1
            hook = float(rng.uniform(0.3, 2.6)), hook[1]
        elif rng.random() < 0.4:
            hook = 0.0, 1.0
        axis, tangent = self._axis(length, lean, hook, unit(towards))
        leaf = self._leafage("leafy", length)
        stem, to_apex = self._stem(axis, tangent, float(rng.uniform(0.08, 0.3)), leaf)
        small = float(rng.uniform(0.3, 2.0))
        bract = replace(
            leaf, form="simple", size_cm=small, stalk=0.0, aspect=max(0.2, leaf.aspect), curl=0.3, droop=0.1
        )
        if rng.random() < 0.5 and not is_level:
            size = float(rng.uniform(1.0, 5.0))
            broad = replace(leaf, size_cm=size, stalk=float(rng.uniform(0, 1)) * size)
            self._rosette(stem, broad, int(rng.integers(3, 12)))
        for _ in range(rng.integers(0, 5)):
            below, azimuth = float(rng.uniform(0.2, 0.95)) * length, float(rng.uniform(0, 2 * np.pi))
            self._leaf(stem, stem.at(below), azimuth, bract, float(rng.uniform(0.6, 1.4)), float(rng.uniform(0.3, 1.0)))
        for _ in range(rng.integers(0, 4) if rng.random() < 0.6 else 0):  # close round the buds
            below, azimuth = float(rng.uniform(0.1, 0.9)), float(rng.uniform(0, 2 * np.pi))
            self._leaf(stem, stem.at(below), azimuth, bract, float(rng.uniform(0.4, 1.0)), float(rng.uniform(0, 0.4)))
        if rng.random() < 0.85:
            top = self._buds(stem, leaf)
            return np.concatenate([to_apex, top[None]])
        return to_apex

    def _buds(self, stem: Stem, leaf: Leafage) -> Floats:
        """Buds and flowers along the end, on stalks, on ones of one height, or on none; where the youngest one ends."""
        rng = self._rng
        kind = str(rng.choice(["raceme", "corymb", "spike"], p=[0.5, 0.3, 0.2]))
        reach = min(float(np.exp(rng.uniform(np.log(0.2), np.log(4.0)))), 0.6 * stem.to_end_cm[0])
        green = leaf.stalk_colour + (leaf.front - leaf.stalk_colour) * rng.random()
        petals = np.exp(rng.normal(size=3) * 0.5) * rng.uniform(0.1, 0.8)
        ripe, opens_at = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.1, 1.5))
        stalk_cm, angle = float(rng.uniform(0.1, 1.2)), float(rng.uniform(0.2, 1.3))
        top = stem.axis[-1]
        belows = rng.uniform(0, 1, rng.integers(4, 22)) ** 1.5 * reach
        for below in (0.0, *belows):
            share = below / reach
            aside = perpendicular(stem.tangent[stem.at(below)], float(rng.uniform(0, 2 * np.pi)))
            steep = (angle * (0.2 + 0.8 * share) + rng.normal() * 0.15) * (below > 0)
            heading = np.cos(steep) * stem.tangent[stem.at(below)] + np.sin(steep) * aside
            long = {"raceme": 0.05 + stalk_cm * share, "corymb": 0.7 * below + 0.03, "spike": 0.03}[kind]
            path = bent(stem.axis[stem.at(below)], heading, long * rng.uniform(0.7, 1.2), 0.05, np.zeros(3))
            self.surfaces.tube(path, np.full(len(path), max(0.015, 0.3 * stem.radius_cm[-1])), leaf.stalk_colour, 4)
            age = min(1.0, below / opens_at)
            size = ripe * (0.3 + 0.7 * age) * rng.uniform(0.8, 1.2)
            bud = bent(path[-1], unit(path[-1] - path[-2]), 2.0 * size, 0.0, np.zeros(3))
            if not below:
                top = bud[-1]
            along = np.linspace(0.0, 1.0, len(bud))
            closed = np.sqrt(np.maximum(0.02, 1.0 - (2.0 * along - 1.0) ** 2)) * 0.6
            opened = 0.25 + 0.9 * along**2
            shown = np.clip(2.0 * along + age - 1.2, 0.0, 1.0)[:, None] * age
            colours = np.clip(green + (petals - green) * shown, 0.01, 0.9)
            self.surfaces.tube(bud, size * (closed + (opened - closed) * max(0.0, 2.0 * age - 1.0)), colours, 7)
        return top
