"""Plants that look like none in particular: anything that a stem with leaves may look like.

Drawn at once as what the finder sees of a photograph, evidence and logarithmic code, at 20 px per cm. Every trait is
drawn widely and by itself: stems of 1.5 to 24 cm, straight, bent or hooked; leaves of any shape, size and place,
simple, threefold or pinnate, before and behind the stem, also just where a hook's top is; leaves greener than stems or
not; light from one side, shadows of leaves; any board.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.vision.path.survey import CLEAR, LEAST_EVIDENCE, plant_score
from guide.canvas import PLAIN, PX_PER_CM, SHAPES, Canvas, Colour, Floats, along, patches
from guide.examples import Example

UP: Final = -np.pi / 2
AROUND_CM: Final = 7.0, 5.0
"""So much beside and above a stem is in the picture, at most."""
BELOW_CM, HANGS_CM = 1.2, 3.0
"""So much below the anchor, or below a stem that hangs lower."""
REACH_PX: Final = 25
"""What is nearer hangs together."""
FORMS, SHARES_OF_FORMS = ("simple", "threefold", "pinnate"), (0.62, 0.23, 0.15)
"""Of leaves, and how many are of each."""
ROUND_END: Final = 0.4, 1.0
"""A stem's end is round; its apex lies between these shares of its half width beyond its axis' end."""


@dataclass(frozen=True, slots=True)
class Colours:
    """Of a plant and what is behind it."""

    board: Colour
    stem: Colour
    upwards: Colour
    leaf: Colour
    young: Colour
    stalk: Colour
    cotyledon: Colour

    def of_stem(self, share: float) -> Colour:
        """At a share of its length."""
        return self.stem + self.upwards * share**2


def draw_colours(rng: np.random.Generator) -> Colours:
    """A plant that stands out from its board, its leaves greener than its stem in most cases."""
    tint = rng.normal(size=3) * 8.0
    board = rng.uniform(60, 190) + rng.normal(size=3) * rng.choice([4, 15]) + tint

    def a_stem() -> Colour:
        bright = rng.uniform(90, 190)
        return np.array([bright - rng.uniform(15, 70), bright, bright - rng.uniform(-12, 25)]) + tint

    stem = a_stem()
    while np.abs(stem - board).max() < rng.uniform(4, 25):
        stem = a_stem()
    greener = rng.uniform(0, 26) if rng.random() < 0.85 else rng.normal() * 6.0
    leaf = stem + [rng.normal() * 8.0, 0.0, -greener] + rng.normal() * 16.0 - 4.0

    def between(most: float, spread: float) -> Colour:
        share = rng.uniform(0, most)
        return leaf * share + stem * (1.0 - share) + rng.normal() * spread

    young, stalk = between(1.0, 8.0), between(0.8, 4.0)
    cotyledon = stem + [-rng.uniform(0, 25), rng.normal() * 5.0, rng.uniform(-5, 18)] + rng.normal() * 10.0
    upwards = np.array([rng.normal() * 4.0, 0.0, -rng.uniform(-3, 12)]) + rng.normal() * 6.0
    return Colours(board, stem, upwards, leaf, young, stalk, cotyledon)


def curve(
    rng: np.random.Generator, heading: float, length_cm: float, wander: float, hook: tuple[float, float], upwards: float
) -> tuple[Floats, Floats]:
    """A line from (0, 0), px, and its direction at each point, rad.

    Args:
        rng: of where it wanders.
        heading: at its beginning.
        length_cm: of it.
        wander: how much its bend changes.
        hook: rad by which it turns, cm from its end over which it does.
        upwards: how much it is drawn upwards, rad per cm.
    """
    count = max(8, int(length_cm * 8))
    step_cm = length_cm / (count - 1)
    bend = np.cumsum(rng.normal(size=count)) * wander * np.sqrt(step_cm)
    bend = cv2.GaussianBlur(bend[:, None], (1, 31), 4)[:, 0] if count > 31 else 0.5 * bend
    over_cm = min(hook[1], length_cm)
    bend = bend + np.where(np.arange(count) * step_cm > length_cm - over_cm, hook[0] / over_cm, 0.0)
    angle = np.empty(count)
    angle[0] = heading
    for k in range(1, count):
        angle[k] = angle[k - 1] + step_cm * (bend[k] + upwards * np.sin(UP - angle[k - 1]))
    moves = step_cm * PX_PER_CM * np.column_stack([np.cos(angle[1:]), np.sin(angle[1:])])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)]), angle


def draw_stem(rng: np.random.Generator) -> tuple[Floats, Floats, float]:
    """A stem's line, px, its direction at each point, and its length in cm."""
    length = float(np.exp(rng.uniform(np.log(1.5), np.log(24.0))))
    wander = abs(rng.normal()) * 0.09 + 0.01
    turn = rng.choice([-1, 1]) * rng.uniform(0.5, 3.3) if rng.random() < 0.4 else rng.normal() * 0.25
    over = float(rng.uniform(0.8, min(5.0, max(1.0, 0.5 * length))))
    line, angle = curve(rng, UP + rng.normal() * 0.35, length, wander, (turn, over), float(rng.uniform(0, 0.25)))
    return line, angle, length


class Plant:
    """A plant whose leaves are decided one by one, and drawn behind or before its stem.

    Args:
        rng: of everything.
        line, angle, length_cm: of its stem.
        width_cm: of its stem at the anchor.
        colours: of all parts.

    Attributes:
        behind, before: what draws its parts, behind the stem and before it.
        look: of its leaves.
    """

    def __init__(
        self, rng: np.random.Generator, line: Floats, angle: Floats, length_cm: float, width_cm: float, colours: Colours
    ) -> None:
        self.rng, self.line, self.angle, self.length_cm, self.width_cm = rng, line, angle, length_cm, width_cm
        self.colours = colours
        self.look = PLAIN
        self.behind: list[Callable[[Canvas], None]] = []
        self.before: list[Callable[[Canvas], None]] = []

    def bear_leaves(self) -> None:
        """Cotyledons, leaves, and young leaves round the apex."""
        rng = self.rng
        if rng.random() < 0.7:
            self.cotyledons()
        self.leaves()
        for _ in range(rng.integers(0, 4)):
            self.leaf(
                float(rng.uniform(0, 0.7)),
                rng.choice([-1, 1]),
                float(rng.uniform(0.3, 2.2)),
                self.colours.young,
                float(rng.uniform(0, 0.8) * (rng.random() < 0.6)),
                str(rng.choice(SHAPES)),
                leaves_at=float(rng.uniform(0, 1.6)),
            )
        if rng.random() < 0.7:
            self._bud()
        if rng.random() < 0.25:
            self._veil()

    def _bud(self) -> None:
        """The youngest leaves, still folded: they go on from the apex as if they were the stem."""
        rng = self.rng
        for _ in range(rng.integers(1, 4)):
            share = rng.uniform(0, 1)
            colour = self.colours.young * share + self.colours.of_stem(1.0) * (1.0 - share) + rng.normal() * 6.0
            shape, length = str(rng.choice(["linear", "linear", "elliptic", "ovate"])), float(rng.uniform(0.3, 2.4))
            aside = abs(float(rng.normal())) * 0.35
            self.leaf(
                float(rng.uniform(0, 0.12)),
                rng.choice([-1, 1]),
                length,
                colour,
                0.0,
                shape,
                leaves_at=aside,
                is_stiff=True,
            )

    def _veil(self) -> None:
        """A broad leaf or two on short stalks near the end, as hooks bear them, and are hidden by."""
        rng = self.rng
        for side in (1, -1)[: rng.integers(1, 3)]:
            length, shape = float(rng.uniform(1.2, 4.0)), str(rng.choice(["heart", "ovate", "elliptic"]))
            self.leaf(float(rng.uniform(0.5, 4.0)), side, length, self.colours.young, rng.uniform(0.1, 0.6), shape)

    def cotyledons(self) -> None:
        rng = self.rng
        share = rng.uniform(0.15, 0.75) if self.length_cm > 4.0 else rng.uniform(0.4, 1.0)
        for side in (1, -1):
            if rng.random() < 0.8:
                colour = self.colours.cotyledon if rng.random() < 0.7 else self.colours.leaf
                shape = str(rng.choice(["elliptic", "obovate", "ovate"]))
                self.leaf(
                    (1.0 - share) * self.length_cm, side, rng.uniform(0.4, 2.0), colour, rng.uniform(0.05, 0.4), shape
                )

    def leaves(self) -> None:
        rng = self.rng
        below_cm, shape, size = rng.uniform(0.4, 3.0), str(rng.choice(SHAPES)), rng.uniform(0.8, 6.0)
        opposite, side = rng.random() < 0.5, rng.choice([-1, 1])
        while below_cm < 0.8 * self.length_cm:
            length = size * rng.uniform(0.5, 1.2) * min(1.0, 0.25 + below_cm / 6.0)
            colour = self.colours.leaf if below_cm > 2.0 else self.colours.young
            for here in (1, -1) if opposite or rng.random() < 0.3 else (side,):
                if rng.random() < 0.92:
                    stalk = rng.uniform(0.1, 4.0) * min(1.0, 0.15 + below_cm / 5.0)
                    # some stalks go on as the stem does
                    leaves_at = float(rng.uniform(0.0, 0.35)) if rng.random() < 0.1 else None
                    form = str(rng.choice(FORMS, p=SHARES_OF_FORMS))
                    self.leaf(below_cm, here, length, colour, stalk, shape, form=form, leaves_at=leaves_at)
            side, below_cm = -side, below_cm + rng.uniform(1.0, 6.0)

    def leaf(
        self,
        below_cm: float,
        side: int,
        length_cm: float,
        colour: Colour,
        stalk_cm: float,
        shape: str,
        *,
        form: str = "simple",
        leaves_at: float | None = None,
        is_stiff: bool = False,
        is_behind: bool | None = None,
        stalk_share: tuple[float, float] = (0.25, 0.75),
    ) -> None:
        """A leaf on its stalk.

        Args:
            below_cm: so far below the apex.
            side: -1 or 1.
            length_cm, colour, shape: of its blade.
            stalk_cm: length of its stalk.
            form: of :data:`FORMS`.
            leaves_at: angle to the stem, rad; any where it is not told.
            is_stiff: it goes on as its stalk does.
            is_behind: whether the stem hides it; by chance where it is not told.
            stalk_share: least and greatest width of its stalk, as a share of the stem's.
        """
        rng = self.rng
        stalk_cm = max(stalk_cm, 0.8 * length_cm) if form == "pinnate" else stalk_cm
        share = float(np.clip(1.0 - below_cm / self.length_cm, 0.0, 1.0))
        angle = self.angle[int(share * (len(self.angle) - 1))]
        angle += side * (rng.uniform(0.3, 1.5) if leaves_at is None else leaves_at)
        stalk, angles = curve(rng, angle, max(0.15, stalk_cm), 0.3, (0.0, 1.0), rng.normal() * 0.3)
        stalk = stalk + along(self.line, share)
        stalk_width = self.width_cm * rng.uniform(*stalk_share)
        heading = angles[-1] + rng.normal() * (0.1 if is_stiff else 0.5)
        if rng.random() < 0.5 and not is_stiff:  # it hangs
            down = (-UP - heading + np.pi) % (2 * np.pi) - np.pi
            heading += np.clip(down, -1.5, 1.5) * rng.uniform(0, 1)
        width_cm = length_cm * (rng.uniform(0.1, 0.3) if shape == "linear" else rng.uniform(0.35, 0.95))
        curl, fold, own = rng.normal() * 0.4, rng.random() ** 2 * 0.95, np.random.default_rng(rng.integers(1 << 60))

        def draw(canvas: Canvas) -> None:
            if stalk_cm > 0.15:
                canvas.band(stalk, (stalk_width, 0.8 * stalk_width), lambda _: self.colours.stalk, own.uniform(0, 6))
            lit = colour + own.normal() * 5.0
            if form == "pinnate":
                self._leaflets(canvas, own, stalk, angles, (length_cm, width_cm), lit, shape)
                return
            for turn, size in ((1.2, 0.8), (-1.2, 0.8), (0.0, 1.0)) if form == "threefold" else ((0.0, 1.0),):
                sides = (length_cm * size, width_cm * size)
                tone = lit + own.normal() * 3.0
                canvas.blade(own, stalk[-1], heading + turn, sides, shape, tone, curl, fold, self.look)

        by_chance = rng.random() >= 0.45
        (self.behind if (by_chance if is_behind is None else is_behind) else self.before).append(draw)

    def _leaflets(
        self,
        canvas: Canvas,
        rng: np.random.Generator,
        stalk: Floats,
        angles: Floats,
        size_cm: tuple[float, float],
        colour: Colour,
        shape: str,
    ) -> None:
        """Pairs of leaflets along a stalk, and a tendril, or one leaflet more, at its end."""
        shares, turn = np.linspace(rng.uniform(0.2, 0.5), 0.97, rng.integers(2, 5)), rng.uniform(0.5, 1.5)
        small = tuple(v * rng.uniform(0.25, 0.55) for v in size_cm)
        for share in shares:
            angle = float(angles[int(share * (len(angles) - 1))])
            for side in (turn, -turn):
                lit = colour + rng.normal() * 4.0
                canvas.blade(
                    rng, along(stalk, share), angle + side, small, shape, lit, 0.2, rng.random() ** 2, self.look
                )
        if rng.random() < 0.5:
            canvas.blade(rng, stalk[-1], float(angles[-1]), small, shape, colour, 0.2, rng.random() ** 2, self.look)
            return
        for _ in range(rng.integers(1, 4)):
            heading, curls = float(angles[-1] + rng.normal() * 0.5), (rng.normal() * 4.0, rng.uniform(0.5, 2.0))
            tendril, _ = curve(rng, heading, rng.uniform(0.5, 3.5), 0.6, curls, 0.0)
            canvas.band(stalk[-1] + tendril, (0.07, 0.04), lambda _: self.colours.stalk, 0.0)


def wild_example(seed: int, *, is_bare: bool = False) -> Example:
    """The plant of a seed, as the finder sees it; with ``is_bare`` nothing but its stem."""
    rng = np.random.default_rng([seed, 7])
    line, angle, length = draw_stem(rng)
    width = min(float(rng.uniform(0.15, 0.65)), 0.5 if length < 4.0 else 1.0)
    return photographed(
        Plant(rng, line, angle, length, width, draw_colours(rng)), (lambda _: None) if is_bare else Plant.bear_leaves
    )


def photographed(plant: Plant, bears: Callable[[Plant], None]) -> Example:
    """A plant before a board, in some light, as the finder sees it.

    Args:
        plant: whose stem is drawn.
        bears: grows its leaves.
    """
    rng, line, colours, width = plant.rng, plant.line, plant.colours, plant.width_cm
    low, high = line.min(axis=0) - np.array(AROUND_CM) * PX_PER_CM, line.max(axis=0) + np.array(AROUND_CM) * PX_PER_CM
    high[1] = min(high[1], max(line[0, 1] + BELOW_CM * PX_PER_CM, line[:, 1].max() + HANGS_CM * PX_PER_CM))
    height, across = ((high - low)[::-1]).astype(int)
    shape = int(height), int(across)
    line = line - low
    empty = np.zeros((*shape, 3), np.float32) + colours.board
    if rng.random() < 0.6:
        empty += patches(rng, shape, rng.uniform(3, 30), rng.uniform(0, 6))[..., None]
    empty += patches(rng, shape, 150, 8)[..., None]
    grain = patches(rng, shape, rng.uniform(2, 15), rng.uniform(0, 5)) + patches(rng, shape, 60, rng.uniform(0, 8))
    canvas, plant.line = Canvas(empty, grain), line
    bears(plant)
    if rng.random() < 0.5:
        off = rng.normal(size=2) * PX_PER_CM
        canvas.shadow(line + off, max(1, int(width * PX_PER_CM)), float(rng.uniform(1, 8)), float(rng.uniform(2, 25)))
    for draw in plant.behind:
        draw(canvas)
    tapers = width, width * float(rng.uniform(0.35, 0.95))
    canvas.band(line, tapers, colours.of_stem, rng.uniform(0, 9) * rng.choice([-1, 1]))
    for draw in plant.before:
        draw(canvas)
    canvas.lit(_light(rng, shape))
    if rng.random() < 0.08:  # another stem, with nothing to tell it but where it stands
        aside = (line - line[0]) * [rng.choice([-1, 1]), 1] + line[0] + [rng.choice([-1, 1]) * rng.uniform(30, 100), 0]
        canvas.band(aside, tapers, colours.of_stem, 0.0)
    onwards = line[-1] - line[-2]
    apex = line[-1] + onwards / np.hypot(*onwards) * rng.uniform(*ROUND_END) * 0.5 * tapers[1] * PX_PER_CM
    return _seen(rng, canvas.code, empty, np.concatenate([line, apex[None]]))


def _light(rng: np.random.Generator, shape: tuple[int, int]) -> Floats:
    """What a lamp at one side, and the shadows of leaves, do to a plant, shape (height, width, 3), code units."""
    across, up = (np.linspace(-1.0, 1.0, n, dtype=np.float32) for n in shape[::-1])
    from_side = across[None] * rng.normal() * 8.0 + up[:, None] * rng.normal() * 6.0
    light = from_side[..., None] * (1.0 + rng.normal(size=3) * 0.2)
    if rng.random() < 0.4:
        shadows = patches(rng, shape, rng.uniform(12, 60), 1.0)
        light = light - (np.clip(shadows, 0.0, 1.0) * rng.uniform(4, 28))[..., None]
    return light


def _seen(rng: np.random.Generator, code: Floats, empty: Floats, line: Floats) -> Example:
    """What a camera and the finder's evidence make of it."""
    noise, blur = rng.uniform(0.5, 5), float(rng.uniform(0.3, 1.1))
    grain = cv2.GaussianBlur(rng.normal(size=code.shape).astype(np.float32), (0, 0), 0.6)
    code = cv2.GaussianBlur(code.astype(np.float32), (0, 0), blur) + grain * np.float32(1.8 * noise)
    plant = plant_score(cv2.GaussianBlur((code - empty).astype(np.float32), (0, 0), 0.7))
    plant[plant < max(LEAST_EVIDENCE, 0.7 * CLEAR * noise)] = 0.0
    near = cv2.dilate((plant > 0).astype(np.uint8), np.ones((REACH_PX, REACH_PX), np.uint8))
    _, labels = cv2.connectedComponents(near)
    x, y = (int(np.clip(v, 0, n - 1)) for v, n in zip(line[4], code.shape[1::-1], strict=True))
    plant[labels != labels[y, x]] = 0.0
    return Example(
        np.clip(plant, 0, 127).astype(np.uint8), np.clip(code, 0, 255).astype(np.uint8), line.astype(np.float32)
    )
