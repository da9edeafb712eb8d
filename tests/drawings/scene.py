"""The setup round the plant: what hangs behind it, pot and soil, odds and ends, two lamps and a flash, and their light.

Values are linear: 1 is what saturates the sensor. The picture's values are 255 times the square root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from drawings.clutter import odds_and_ends, pot
from drawings.stem import Lit, ToPx
from drawings.textures import BOARDS, Picture, Rng, bgr, cloud, surface
from flora_common.runs import Light

TINTS: Final = {
    "bluish": (0.35, 0.60, 1.0),
    "purple": (0.85, 0.25, 1.0),
    "warm": (1.0, 0.72, 0.42),
    "white": (0.95, 1.0, 1.0),
}
COARSE: Final = 0.125


@dataclass(frozen=True, slots=True)
class Source:
    """A lamp or the flash, as the empty setup shows it.

    Attributes:
        picture: shape (h, w, 3), what the setup sends to the camera in this light alone.
        lit: the same light as it falls on the plant.
        shadow_cm: where the plant's shadow falls behind it, to the right and up, per cm of height and beside that.
        shadow_soft_cm: standard deviation of its edge.
        shadow_depth: 0 none, 1 black.
    """

    picture: Picture
    lit: Lit
    shadow_cm: tuple[float, float]
    shadow_soft_cm: float
    shadow_depth: float


@dataclass(frozen=True, slots=True)
class Scene:
    """The empty setup.

    Attributes:
        sources: "flash", "left" and "right".
        front: shape (h, w), what stands before the plant (the rim, crumbs of soil): 1 hides it.
        to_px: where the plant stands.
        board: which of ``BOARDS``.
    """

    sources: dict[str, Source]
    front: Picture
    to_px: ToPx
    board: str

    def shining(self, light: Light) -> list[str]:
        """Names of the sources that shine in this lamp state."""
        lamps = {"left": ["left"], "right": ["right"], "dark": [], "both": ["left", "right"]}
        return ["flash", *lamps[light]]


def make_scene(rng: Rng, size_px: tuple[int, int], to_px: ToPx, *, board: str | None = None) -> Scene:
    """A setup at random; ``board`` is one of ``BOARDS``."""
    width, height = size_px
    kind = board or str(rng.choice(BOARDS))
    behind = surface(kind, rng, (height, width), to_px.px_per_cm)
    reflectance, slope_x = behind.reflectance, behind.slope_x
    odds_and_ends(rng, reflectance, to_px)
    front = np.zeros((height, width), np.float32)
    pot(rng, reflectance, slope_x, front, to_px)

    power = float(np.exp(rng.uniform(math.log(0.12), math.log(2.5))))
    powers = {"flash": 1.0, "left": power * rng.uniform(0.7, 1.4), "right": power * rng.uniform(0.7, 1.4)}
    # Plant and board do not stand in the same plane: the board gets its own share of each light.
    shares = {"flash": rng.uniform(0.5, 1.0), "left": rng.uniform(0.3, 1.2), "right": rng.uniform(0.3, 1.2)}
    exposure = _exposure(rng, reflectance, to_px, powers, shares)

    tint = (1.0 + rng.uniform(-0.15, 0.15, 3)).astype(np.float32)
    field = _falloff(size_px, to_px, (rng.uniform(-6, 6), rng.uniform(5, 25)), rng.uniform(15, 60), 0.8)
    unit = _unit(rng.normal(0, 0.2), rng.uniform(0.1, 1.0), 1.0)
    sources = {"flash": _source(rng, reflectance, slope_x, field, exposure, tint, unit, shares["flash"], None)}
    tints = list(TINTS.values())
    shared = tints[int(rng.integers(len(tints)))]
    above, aside, size = rng.uniform(8, 40), rng.uniform(12, 40), rng.uniform(1.5, 5.0)
    look = str(rng.choice(["coil", "bulb", "bar"]))
    places = {s: (s * aside * rng.uniform(0.9, 1.1), above * rng.uniform(0.9, 1.1)) for s in (-1.0, 1.0)}
    bodies = {side: _lamp_body(rng, reflectance, to_px, at, size, look) for side, at in places.items()}
    for name, side in (("left", -1.0), ("right", 1.0)):
        colour = bgr(*(shared if rng.random() < 0.6 else tints[int(rng.integers(len(tints)))]))
        field = _falloff(size_px, to_px, places[side], rng.uniform(0.5, 1.0) * aside, 2.0)
        plant_at = to_px(np.array([[0.0, 8.0]]))[0] * COARSE
        y, x = (int(np.clip(v, 0, s - 1)) for v, s in zip(plant_at[::-1], field.shape, strict=True))
        field /= max(float(field[y, x]), 1e-6)
        unit = _unit(side, above / aside * 0.7, rng.uniform(-0.3, 0.6))
        own = exposure * powers[name]
        sources[name] = _source(rng, reflectance, slope_x, field, own, colour, unit, shares[name], bodies[side])
    return Scene(sources, front, to_px, kind)


def _exposure(rng: Rng, reflectance: Picture, to_px: ToPx, powers: dict[str, float], shares: dict[str, float]) -> float:
    """Strength of the flash at which the plant is well lit and what is behind it keeps its detail."""
    lamp = max(("left", "right"), key=powers.__getitem__)
    plant = rng.uniform(0.22, 0.60) / (0.4 * (1.0 + 0.6 * powers[lamp]))
    x, y = (int(v) for v in to_px.anchor_px)
    reach = int(12 * to_px.px_per_cm)
    board = reflectance[max(0, y - reach) : y, max(0, x - reach) : x + reach]
    brightest = float(np.quantile(board[::8, ::8], 0.9)) * (shares["flash"] + shares[lamp] * powers[lamp])
    return float(min(plant, 0.85 / max(brightest, 1e-6)))


def _source(
    rng: Rng,
    reflectance: Picture,
    slope_x: Picture,
    field: Picture,
    strength: float,
    colour: Picture,
    unit: Picture,
    board_share: float,
    body: Picture | None,
) -> Source:
    height, width = reflectance.shape[:2]
    tone = (strength * np.asarray(colour, np.float32)).astype(np.float32)
    patchy = 1.0 + 0.08 * cloud(rng, field.shape, (2, 2), 2)
    whole = cv2.resize(field * patchy, (width, height), interpolation=cv2.INTER_LINEAR)
    picture = reflectance * (whole * np.float32(board_share) * np.clip(1 + 1.2 * unit[0] * slope_x, 0.05, 3))[..., None]
    picture *= tone
    if body is not None:
        shine = np.float32(rng.uniform(1.5, 6.0))
        small = cv2.resize(body, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_AREA)
        glow = sum(cv2.GaussianBlur(small, None, height * COARSE * r) * g for r, g in ((0.02, 0.25), (0.09, 0.30)))
        glow = cv2.resize(np.asarray(glow, np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
        pure = np.asarray(colour, np.float32)
        picture += (body[..., None] + glow[..., None] * np.float32(min(1.0, strength * 2))) * (pure * shine)
    shadow = float(-unit[0] * rng.uniform(1, 5)), float(-unit[1] * rng.uniform(0.5, 3))
    soft, depth = float(rng.uniform(0.1, 0.8)), float(rng.uniform(0.15, 0.7))
    picture = picture.astype(np.float32)
    return Source(picture, Lit(unit, tone, field, COARSE), shadow, soft, depth)


def _falloff(
    size_px: tuple[int, int], to_px: ToPx, at_cm: tuple[float, float], reach_cm: float, power: float
) -> Picture:
    width, height = (math.ceil(n * COARSE) for n in size_px)
    x_px, y_px = to_px(np.array([at_cm]))[0] * COARSE
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    far2 = ((x - x_px) ** 2 + (y - y_px) ** 2) / np.float32(to_px.px_per_cm * COARSE * reach_cm) ** 2
    field: Picture = (1.0 / (1.0 + far2) ** (power / 2)).astype(np.float32)
    return field


def _lamp_body(
    rng: Rng, reflectance: Picture, to_px: ToPx, at_cm: tuple[float, float], size_cm: float, look: str
) -> Picture:
    """Draw the lamp that is off into the setup; returns where it shines, shape (h, w)."""
    body = np.zeros(reflectance.shape[:2], np.float32)
    x, y = (round(float(v)) for v in to_px(np.array([at_cm]))[0])
    size = max(2, round(size_cm * to_px.px_per_cm))
    if look == "bulb":
        cv2.circle(body, (x, y), size // 2, 1.0, -1)
    elif look == "bar":
        cv2.rectangle(body, (x - size // 4, y - size), (x + size // 4, y + size), 1.0, -1)
    else:
        for k in range(5):
            cv2.ellipse(body, (x, y + (k - 2) * size // 4), (size // 2, size // 7), 0, 0, 360, 1.0, max(1, size // 9))
    on = body > 0
    reflectance[on] = rng.uniform(0.1, 0.5)
    cv2.line(reflectance, (x, y - size), (x + int(rng.normal(0, size)), -10), (0.02, 0.02, 0.02), max(1, size // 14))
    return cv2.GaussianBlur(body, None, 1.0)


def _unit(x: float, y: float, z: float) -> Picture:
    v = np.array([x, y, z])
    return v / np.linalg.norm(v)
