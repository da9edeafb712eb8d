"""Plants made to be mistaken: what a stem is told from looks like one, and what it ends in does not.

Five kinds, each seen to mislead on plants that were not drawn for learning, and mixed here with whatever else a wild
plant has:

- a hook from whose beginning a leaf goes on where the stem went;
- blades of two tones, or with a broad midrib, that hang along the stem, behind it;
- a stalk from the side of a pot, which bends up or back, with nothing at its end or with buds;
- a seedling, whose hook bears cotyledons that are still closed;
- a thin end, straight or hooked and hardly told from the board, that reaches past the youngest leaves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from guide.canvas import SHAPES, Floats, Look
from guide.examples import Example
from guide.wild import FORMS, SHARES_OF_FORMS, UP, Plant, curve, draw_colours, draw_stem, photographed

KINDS: Final = ("heir", "two_toned", "stalk", "seedling", "end")
SHARES: Final = (0.26, 0.2, 0.14, 0.16, 0.24)
"""How many are of each."""


def misleading_example(seed: int) -> Example:
    """The plant of a seed, as the finder sees it."""
    rng = np.random.default_rng([seed, 11])
    kind = str(rng.choice(KINDS, p=SHARES))
    return {"heir": _heir, "two_toned": _two_toned, "stalk": _stalk, "seedling": _seedling, "end": _end}[kind](rng)


def _heir(rng: np.random.Generator) -> Example:
    """A hooked stem, and a leaf that goes on where it went before it turned."""
    length = float(np.exp(rng.uniform(np.log(2.5), np.log(20.0))))
    over = float(rng.uniform(0.7, min(4.0, 0.6 * length)))
    turn = rng.choice([-1, 1]) * rng.uniform(0.9, 3.3)
    wander, upwards = abs(rng.normal()) * 0.09 + 0.01, float(rng.uniform(0, 0.25))
    line, angle = curve(rng, UP + rng.normal() * 0.3, length, wander, (turn, over), upwards)

    def bears(plant: Plant) -> None:
        _any_look(plant, 0.4)
        if rng.random() < 0.5:
            plant.leaves()
        if rng.random() < 0.6:
            plant.cotyledons()
        for _ in range(rng.integers(1, 3)):
            below = max(0.15, over * rng.uniform(0.5, 1.0) + rng.normal() * 0.2)
            plant.leaf(
                float(below),
                int(-np.sign(turn)),
                float(rng.uniform(0.6, 4.0)),
                plant.colours.young if rng.random() < 0.5 else plant.colours.leaf,
                float(rng.uniform(0.3, 5.0)),
                str(rng.choice(SHAPES)),
                form=str(rng.choice(FORMS, p=SHARES_OF_FORMS)),
                leaves_at=float(rng.normal() * 0.3),
                is_stiff=bool(rng.random() < 0.6),
                is_behind=bool(rng.random() < 0.75),
                stalk_share=(0.3, 0.9),
            )
        for _ in range(rng.integers(0, 4)):
            _young(plant)

    return photographed(_plant(rng, line, angle, length, stalk_is_stem=0.7), bears)


def _two_toned(rng: np.random.Generator) -> Example:
    """Blades whose halves differ, along the stem and behind it."""
    line, angle, length = draw_stem(rng)

    def bears(plant: Plant) -> None:
        _any_look(plant, 1.0)
        plant.bear_leaves()
        for _ in range(rng.integers(1, 4)):
            at = float(np.pi - abs(rng.normal()) * 0.45 if rng.random() < 0.6 else abs(rng.normal()) * 0.3)
            plant.leaf(
                float(rng.uniform(0.1, 0.8)) * length,
                int(rng.choice([-1, 1])),
                float(rng.uniform(0.15, 0.6)) * min(length, 12.0),
                plant.colours.leaf,
                float(rng.uniform(0.1, 1.0)),
                str(rng.choice(["ovate", "elliptic", "linear", "obovate"])),
                leaves_at=at,
                is_stiff=True,
                is_behind=bool(rng.random() < 0.8),
            )

    return photographed(_plant(rng, line, angle, length), bears)


def _stalk(rng: np.random.Generator) -> Example:
    """A thin stalk that comes from anywhere and bends, bare or with buds at its end and small leaves below."""
    length = float(np.exp(rng.uniform(np.log(1.5), np.log(16.0))))
    heading = UP + float(np.clip(rng.normal() * 1.0, -1.9, 1.9))
    turn, over = rng.choice([-1, 1]) * rng.uniform(0, 3.0) * (rng.random() < 0.7), rng.uniform(0.4, 1.0) * length
    line, angle = curve(rng, heading, length, abs(rng.normal()) * 0.06 + 0.01, (turn, over), rng.uniform(0, 0.5))

    def bears(plant: Plant) -> None:
        pale = plant.colours.stem + rng.uniform(0, 50) + rng.normal(size=3) * 15.0
        for _ in range(rng.integers(0, 9) if rng.random() < 0.6 else 0):
            bud = plant.colours.stem + (pale - plant.colours.stem) * rng.uniform(0, 1)
            plant.leaf(
                float(abs(rng.normal()) * 0.25),
                int(rng.choice([-1, 1])),
                float(rng.uniform(0.12, 0.5)),
                bud,
                float(rng.uniform(0.0, 0.35)),
                str(rng.choice(["elliptic", "ovate", "obovate", "heart"])),
                leaves_at=float(rng.uniform(0, 1.4)),
                is_stiff=True,
            )
        for _ in range(rng.integers(0, 4)):
            size, stalk_cm = float(rng.uniform(0.3, 1.5)), float(rng.uniform(0.0, 0.3))
            below = float(rng.uniform(0.2, 0.95)) * length
            plant.leaf(below, int(rng.choice([-1, 1])), size, plant.colours.leaf, stalk_cm, str(rng.choice(SHAPES)))

    plant = _plant(rng, line, angle, length)
    plant.width_cm = float(rng.uniform(0.08, 0.35))
    return photographed(plant, bears)


def _seedling(rng: np.random.Generator) -> Example:
    """A short stem with a sharp hook, and cotyledons that are closed, or open a little."""
    length, over = float(rng.uniform(0.8, 5.0)), float(rng.uniform(0.3, 1.2))
    turn = rng.choice([-1, 1]) * rng.uniform(0.6, 3.6)
    line, angle = curve(rng, UP + rng.normal() * 0.35, length, 0.05, (turn, min(over, 0.7 * length)), 0.1)

    def bears(plant: Plant) -> None:
        opened, size = float(abs(rng.normal()) * 0.35), float(rng.uniform(0.5, 2.2))
        shape = str(rng.choice(["elliptic", "obovate", "ovate", "heart"]))
        colour = plant.colours.cotyledon if rng.random() < 0.7 else plant.colours.leaf
        for side in (1, -1)[: 1 if rng.random() < 0.25 else 2]:
            stalk_cm = float(rng.uniform(0, 0.5)) * (rng.random() < 0.5)
            below = float(abs(rng.normal()) * 0.08)
            plant.leaf(below, side, size, colour + rng.normal() * 4.0, stalk_cm, shape, leaves_at=opened, is_stiff=True)
        for _ in range(rng.integers(0, 3)):
            _young(plant)

    plant = _plant(rng, line, angle, length)
    plant.width_cm = float(rng.uniform(0.12, 0.4))
    return photographed(plant, bears)


def _end(rng: np.random.Generator) -> Example:
    """A stem whose end goes on past its youngest leaves, thin and as pale as the board."""
    length, over = float(np.exp(rng.uniform(np.log(1.5), np.log(22.0)))), float(rng.uniform(0.4, 2.0))
    turn = rng.choice([-1, 1]) * rng.uniform(0.3, 2.8) * (rng.random() < 0.7)
    wander, upwards = abs(rng.normal()) * 0.07 + 0.01, float(rng.uniform(0, 0.25))
    line, angle = curve(rng, UP + rng.normal() * 0.3, length, wander, (turn, min(over, 0.7 * length)), upwards)

    def bears(plant: Plant) -> None:
        _any_look(plant, 0.15)
        if rng.random() < 0.7:
            plant.leaves()
        if rng.random() < 0.5:
            plant.cotyledons()
        for _ in range(rng.integers(1, 4)):
            plant.leaf(
                float(rng.uniform(0.25, 1.0)) * min(over, 0.5 * length),
                int(rng.choice([-1, 1])),
                float(rng.uniform(0.4, 1.8)),
                plant.colours.leaf if rng.random() < 0.5 else plant.colours.young,
                float(rng.uniform(0.0, 0.5)),
                str(rng.choice(SHAPES)),
                leaves_at=float(rng.uniform(0.0, 1.9)),
                is_behind=bool(rng.random() < 0.35),
            )

    plant = _plant(rng, line, angle, length)
    if rng.random() < 0.6:
        paler = (plant.colours.board - plant.colours.stem) * rng.uniform(0.0, 0.6)
        plant.colours = replace(plant.colours, upwards=paler + rng.normal() * 3.0)
    plant.width_cm *= float(rng.uniform(0.6, 1.0))
    return photographed(plant, bears)


def _plant(
    rng: np.random.Generator, line: Floats, angle: Floats, length_cm: float, *, stalk_is_stem: float = 0.2
) -> Plant:
    """A plant of any width and colours, whose stalks have its stem's colour in a share of all."""
    colours = draw_colours(rng)
    if rng.random() < stalk_is_stem:
        colours = replace(colours, stalk=colours.stem + rng.normal() * 3.0)
    return Plant(rng, line, angle, length_cm, float(rng.uniform(0.12, 0.5)), colours)


def _any_look(plant: Plant, share: float) -> None:
    """Blades of two tones, cut margins, or broad midribs, for a share of all plants."""
    rng = plant.rng
    if rng.random() >= share:
        return
    plant.look = Look(
        two_toned=float(rng.uniform(8, 55)) if rng.random() < 0.7 else 0.0,
        lobes=float(rng.uniform(0.2, 0.6)) if rng.random() < 0.3 else 0.0,
        midrib=float(rng.uniform(0.05, 0.18)) if rng.random() < 0.4 else 0.0,
        rib=plant.colours.stem + rng.normal() * 8.0,
    )


def _young(plant: Plant) -> None:
    """A small leaf at the apex."""
    rng = plant.rng
    plant.leaf(
        float(rng.uniform(0, 0.3)),
        int(rng.choice([-1, 1])),
        float(rng.uniform(0.2, 1.2)),
        plant.colours.young,
        float(rng.uniform(0, 0.4)),
        str(rng.choice(SHAPES)),
        leaves_at=float(rng.uniform(0, 1.5)),
    )
