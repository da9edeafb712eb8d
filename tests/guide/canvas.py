"""Stems and leaves on a canvas in logarithmic code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import ByteArray
from flora_common.geometry import arc_length
from flora_common.vision.path.sampler import places_along

Floats = npt.NDArray[np.floating]
Colour = npt.NDArray[np.floating]
"""Blue, green, red in logarithmic code, shape (3,)."""

PX_PER_CM: Final = 20.0
SHIFT: Final = 4
"""Bits of a pixel's fraction in what OpenCV draws."""
_SHAPES: Final = {"ovate": 0.35, "elliptic": 0.5, "heart": 0.25, "linear": 0.5, "obovate": 0.65}
SHAPES: Final = tuple(_SHAPES)
"""Of blades, by where they are widest."""
_BLUNT: Final = {"linear": 0.6, "heart": 0.7}
_BLADE_POINTS: Final = 24


@dataclass(frozen=True, slots=True)
class Look:
    """What leaves of a plant have besides shape and colour.

    Attributes:
        two_toned: code units by which one half is brighter than the other.
        lobes: how deep the margin is cut, as a share of the half width.
        midrib: how broad it is, as a share of the blade's width, where it is seen as a stem would be.
        rib: its colour.
    """

    two_toned: float = 0.0
    lobes: float = 0.0
    midrib: float = 0.0
    rib: Colour | None = None


PLAIN: Final = Look()


def corners(places: Floats) -> list[npt.NDArray[np.int32]]:
    """Places (n, 2) as OpenCV draws them to a sixteenth of a pixel."""
    return [np.round(np.asarray(places) * (1 << SHIFT)).astype(np.int32)]


def patches(rng: np.random.Generator, shape: tuple[int, int], cell_px: float, size: float) -> Floats:
    """Noise that is smooth over cells, shape (height, width)."""
    cells = [max(2, int(v / cell_px) + 2) for v in shape]
    noise = rng.normal(size=cells).astype(np.float32)
    return cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_CUBIC) * size


def along(line: Floats, share: float) -> Floats:
    """The place at a share of a line's length."""
    s = arc_length(line)
    return places_along(line, s, np.array([share * s[-1]]))[0]


class Canvas:
    """What is painted on.

    Args:
        empty: shape (height, width, 3), logarithmic code.
        grain: shape (height, width), what leaves have besides their colour.

    Attributes:
        code: the picture so far.
        covered: shape (height, width), 0..1, where a plant has been painted.
    """

    def __init__(self, empty: Floats, grain: Floats) -> None:
        self.code = empty.astype(np.float32)
        self.covered = np.zeros(empty.shape[:2], np.float32)
        self._grain = grain[..., None]
        self.shape = empty.shape[:2]

    def shadow(self, line: Floats, width_px: int, blur_px: float, depth: float) -> None:
        """A stem's shadow: darker by so many code units."""
        mask = np.zeros(self.shape, np.uint8)
        cv2.polylines(mask, corners(line), False, 255, width_px, cv2.LINE_8, SHIFT)
        self.code -= cv2.GaussianBlur(mask, (0, 0), blur_px)[..., None].astype(np.float32) / 255.0 * depth

    def band(
        self, line: Floats, widths_cm: tuple[float, float], colour: Callable[[float], Colour], shade: float
    ) -> None:
        """A stem or stalk: a band along a line (n, 2), lit from one side.

        Args:
            line: px.
            widths_cm: at its beginning and end.
            colour: at a share of its length.
            shade: code units by which one side is brighter than the middle, and the other darker.
        """
        width = np.linspace(*widths_cm, len(line)) * PX_PER_CM
        tangent = np.gradient(line, axis=0)
        tangent /= np.hypot(*tangent.T)[:, None] + 1e-9
        across = np.column_stack([-tangent[:, 1], tangent[:, 0]]) * width[:, None]
        mask, painted = np.zeros(self.shape, np.uint8), np.zeros((*self.shape, 3), np.float32)
        painted[:] = colour(1.0)
        for k in range(len(line) - 1):
            here, there = line[k], line[k + 1]
            cv2.fillPoly(
                mask,
                corners(
                    np.array(
                        [
                            here + across[k] / 2,
                            here - across[k] / 2,
                            there - across[k + 1] / 2,
                            there + across[k + 1] / 2,
                        ]
                    )
                ),
                255,
                cv2.LINE_8,
                SHIFT,
            )
            for third in range(3):
                low, high = third / 3 - 0.5, (third + 1) / 3 - 0.5
                part = [
                    here + across[k] * low,
                    here + across[k] * high,
                    there + across[k + 1] * high,
                    there + across[k + 1] * low,
                ]
                lit = colour(k / (len(line) - 1)) + shade * (third - 1)
                cv2.fillPoly(painted, corners(np.array(part)), lit.tolist(), cv2.LINE_8, SHIFT)
        end = tuple(int(v) for v in corners(line[-1:])[0][0])
        for canvas, value in ((mask, 255), (painted, colour(1.0).tolist())):
            cv2.circle(canvas, end, int(width[-1] / 2 * (1 << SHIFT)), value, -1, cv2.LINE_8, SHIFT)
        self._lay(mask, painted, 1.0)

    def blade(
        self,
        rng: np.random.Generator,
        base: Floats,
        direction: float,
        size_cm: tuple[float, float],
        shape: str,
        colour: Colour,
        curl: float,
        fold: float,
        look: Look = PLAIN,
    ) -> None:
        """A leaf's blade.

        Args:
            rng: of its margin, halves and veins.
            base: where it begins, px.
            direction: rad, x right, y down.
            size_cm: length and width.
            shape: of :data:`SHAPES`.
            colour: of its middle.
            curl: by how much it turns from base to end, rad.
            fold: 0..1, how much narrower one half looks, which is turned away.
            look: of all leaves of its plant.
        """
        u = np.linspace(0.0, 1.0, _BLADE_POINTS)
        widest = _SHAPES[shape]
        outline = u ** (widest / (1.0 - widest)) * (1.0 - u)
        half = (outline / outline.max()) ** _BLUNT.get(shape, 0.85) * size_cm[1] / 2 * PX_PER_CM
        if rng.random() < 0.3:
            half = half * (1.0 + 0.08 * np.sin(u * rng.uniform(20, 50)))
        if look.lobes:
            half = half * (1.0 - look.lobes * (0.5 + 0.5 * np.sin(u * rng.uniform(15, 45))))
        angle = direction + curl * u
        step = size_cm[0] / (_BLADE_POINTS - 1) * PX_PER_CM
        middle = base + np.concatenate(
            [np.zeros((1, 2)), np.cumsum(step * np.column_stack([np.cos(angle[1:]), np.sin(angle[1:])]), axis=0)]
        )
        aside = np.column_stack([-np.sin(angle), np.cos(angle)]) * half[:, None]
        narrow = int(rng.random() < 0.5)
        for k, side in enumerate((1.0, -1.0)):
            rim = middle + side * aside * ((1.0 - fold) if k == narrow else 1.0)
            tone = rng.normal() * 6.0 * (1.0 + 2.0 * fold) + 0.5 * side * look.two_toned
            self._fill(np.concatenate([middle, rim[::-1]]), colour + tone)
        if look.rib is not None and look.midrib:
            self._stroke([middle[:-3]], max(1, round(look.midrib * size_cm[1] * PX_PER_CM)), look.rib, 0.9)
        if rng.random() < 0.7:
            self._veins(rng, middle, aside, size_cm[0], colour + rng.uniform(-4, 14))

    def _veins(self, rng: np.random.Generator, middle: Floats, aside: Floats, length_cm: float, colour: Colour) -> None:
        self._stroke([middle[:-2]], int(rng.integers(1, 3)), colour, 0.6)
        if length_cm > 2.0 and rng.random() < 0.6:
            at = range(3, _BLADE_POINTS - 4, 3)
            veins = [np.array([middle[k], middle[k + 3] + side * aside[k + 3]]) for k in at for side in (0.8, -0.8)]
            self._stroke(veins, 1, colour, 0.4)

    def _stroke(self, lines: Sequence[Floats], width_px: int, colour: Colour, share: float) -> None:
        mask = np.zeros(self.shape, np.uint8)
        for line in lines:
            cv2.polylines(mask, corners(line), False, 255, width_px, cv2.LINE_8, SHIFT)
        self._lay(mask, colour, share)

    def _fill(self, outline: Floats, colour: Colour) -> None:
        mask = np.zeros(self.shape, np.uint8)
        cv2.fillPoly(mask, corners(outline), 255, cv2.LINE_8, SHIFT)
        self._lay(mask, colour + self._grain, 1.0)

    def lit(self, light: Floats) -> None:
        """More or less light on what has been painted, shape (height, width, 1 or 3), code units."""
        self.code += self.covered[..., None] * light.astype(np.float32)

    def _lay(self, mask: ByteArray, colour: Floats, share: float) -> None:
        cover = mask.astype(np.float32) / 255.0 * share
        np.maximum(self.covered, cover, out=self.covered)
        self.code += cover[..., None] * (colour - self.code)
