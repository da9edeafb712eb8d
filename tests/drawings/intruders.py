"""What gets into a picture that should show one plant: a second plant, a hand, fog, or quite another subject."""

from __future__ import annotations

import math

import cv2
import numpy as np

from drawings.growth import Growth, light_schedule
from drawings.plant import Plant, extent_cm
from drawings.stem import Canvas, Lit, ToPx
from drawings.textures import Rng, bgr, cloud
from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection


def another_plant(rng: Rng, picture: np.ndarray, camera: CameraSection) -> np.ndarray:
    """The picture with a second plant 1.5 to 8 cm beside the first."""
    height, width = picture.shape[:2]
    aside = float(rng.choice([-1, 1]) * rng.uniform(1.5, 8.0) * camera.px_per_cm)
    to_px = ToPx((camera.anchor_px[0] + aside, camera.anchor_px[1] + float(rng.uniform(-0.2, 0.3))), camera.px_per_cm)
    growth = Growth(rng, light_schedule(rng, 72.0), 72.0)
    plant = Plant(rng, growth)
    posture = growth.at(float(rng.uniform(5, 71) * 3600.0))
    corners = to_px(extent_cm(posture, plant.placed(posture)))
    low, high = corners.min(axis=0) - 10, corners.max(axis=0) + 10
    canvas = Canvas.empty(max(0, int(low[0])), max(0, int(low[1])), min(width, int(high[0])), min(height, int(high[1])))
    # as bright as what stands at the first one's foot is not known: about as bright as the picture's brighter parts
    level = float(np.clip(np.quantile((picture[::8, ::8] / 255.0) ** 2, 0.9), 0.1, 0.6))
    even = np.ones((2, 2), np.float32)
    towards = np.array([0.3 * float(rng.choice([-1, 1])), 0.5, 0.8])
    light = Lit(towards / np.linalg.norm(towards), np.full(3, 1.5 * level, np.float32), even, 0.0)
    plant.draw(canvas, posture, [light], to_px)
    rows = slice(canvas.top, canvas.top + canvas.cover.shape[0])
    columns = slice(canvas.left, canvas.left + canvas.cover.shape[1])
    colour, cover = (cv2.GaussianBlur(a, None, 0.8) for a in (canvas.colour, canvas.cover))
    out = picture.astype(np.float32)
    linear = (out[rows, columns] / 255.0) ** 2 * (1.0 - cover)[..., None] + colour
    out[rows, columns] = 255.0 * np.sqrt(np.clip(linear, 0.0, 1.0))
    return out


def hand(rng: Rng, picture: np.ndarray, line_px: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """The picture with a hand that reaches in from a side, over the plant or beside it; and what it covers (h, w)."""
    height, width = picture.shape[:2]
    part = 4  # drawn small: skin has no fine edges
    cover = np.zeros((height // part, width // part), np.float32)
    aim = line_px[int(rng.integers(len(line_px)))] + rng.normal(0, 0.06 * width, 2)
    aim = np.array([np.clip(aim[0], 0, width), np.clip(aim[1], 0, height)]) / part
    side = int(rng.integers(3))
    start = np.array(
        [
            (-40.0, rng.uniform(0.2, 0.9) * height / part),
            ((width + 160) / part, rng.uniform(0.2, 0.9) * height / part),
            (rng.uniform(0.1, 0.9) * width / part, -40.0),
        ][side]
    )
    arm = aim - start
    reach = float(np.hypot(*arm))
    ahead = arm / reach
    across = np.array([-ahead[1], ahead[0]])
    span = rng.uniform(0.05, 0.11) * width / part
    palm = aim - ahead * 1.3 * span
    shade = np.zeros_like(cover)

    def limb(a: FloatArray, b: FloatArray, thick: float) -> None:
        ends = [np.rint(p * 16).astype(int).tolist() for p in (a, b)]
        cv2.line(cover, *ends, 1.0, max(1, round(thick)), cv2.LINE_8, 4)
        cv2.line(shade, *ends, 1.0, max(1, round(0.4 * thick)), cv2.LINE_8, 4)

    limb(start, palm, 1.2 * span)
    cv2.circle(cover, np.rint(palm).astype(int).tolist(), max(1, round(0.75 * span)), 1.0, -1)
    cv2.circle(shade, np.rint(palm).astype(int).tolist(), max(1, round(0.4 * span)), 1.0, -1)
    spread = rng.uniform(0.1, 0.35)
    for k, long in enumerate((1.1, 1.4, 1.5, 1.35)):
        turn = (k - 1.5) * spread
        way = ahead * math.cos(turn) + across * math.sin(turn)
        foot = palm + across * (k - 1.5) * 0.36 * span
        limb(foot, foot + way * long * span * rng.uniform(0.6, 1.1), 0.32 * span)
    way = ahead * 0.4 + across * float(rng.choice([-1, 1]))
    limb(palm, palm + way * span, 0.36 * span)
    skin = bgr(*rng.choice(np.array([(0.60, 0.40, 0.31), (0.45, 0.27, 0.18), (0.22, 0.12, 0.08)])))
    light = float(np.clip(np.quantile((picture[::8, ::8] / 255.0) ** 2, 0.8) * 1.8, 0.15, 1.2))
    cover = np.clip(
        cv2.resize(cv2.GaussianBlur(cover, None, 0.8), (width, height), interpolation=cv2.INTER_CUBIC), 0, 1
    )
    round_ = cv2.resize(cv2.GaussianBlur(shade, None, 0.1 * span), (width, height), interpolation=cv2.INTER_LINEAR)
    lit = skin * (light * (0.35 + 0.65 * round_) * (1 + 0.05 * cloud(rng, (height, width), (12, 16), 4)))[..., None]
    linear = (picture / np.float32(255)) ** 2 * (1 - cover)[..., None] + lit * cover[..., None]
    return 255.0 * np.sqrt(np.clip(linear, 0.0, 1.0)), cover


def fog(rng: Rng, picture: np.ndarray) -> np.ndarray:
    """The picture through a pane with condensation on part of it."""
    height, width = picture.shape[:2]
    turn = rng.uniform(0, 2 * np.pi)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / np.float32(width)
    place = (x - 0.5) * np.float32(math.cos(turn)) + (y - 0.37) * np.float32(math.sin(turn))
    edge = place + 0.06 * cloud(rng, (height, width), (3, 4), 3)
    thick = np.clip(0.5 + edge / np.float32(rng.uniform(0.05, 0.4)), 0, 1) * np.float32(rng.uniform(0.6, 0.98))
    blurred = cv2.GaussianBlur(picture, None, rng.uniform(4, 14)).astype(np.float32)
    milk = np.float32(rng.uniform(90, 190))
    behind = blurred * np.float32(0.5) + milk * np.float32(0.5)
    return picture * (1 - thick)[..., None] + behind * thick[..., None]


def something_else(rng: Rng, shape: tuple[int, ...]) -> np.ndarray:
    """A picture of anything but the setup: random shapes on a random ground."""
    height, width = shape[:2]
    out = np.empty((height, width, 3), np.float32)
    out[:] = rng.uniform(20, 230, 3) + 20 * cloud(rng, (height, width), (3, 4), 4)[..., None]
    for _ in range(int(rng.integers(3, 40))):
        tone = rng.uniform(0, 255, 3).tolist()
        at = rng.uniform(0, 1, (int(rng.integers(2, 6)), 2)) * (width, height)
        at = np.rint(at[:1] + (at - at[:1]) * rng.uniform(0.1, 1.0)).astype(np.int32)
        pick = rng.random()
        if pick < 0.4:
            cv2.fillPoly(out, [at], tone)
        elif pick < 0.7:
            cv2.ellipse(
                out,
                at[0].tolist(),
                np.abs(rng.normal(60, 50, 2)).astype(int).tolist(),
                rng.uniform(0, 180),
                0,
                360,
                tone,
                -1,
            )
        else:
            cv2.polylines(out, [at], False, tone, int(rng.integers(1, 30)))
    return cv2.GaussianBlur(out, None, rng.uniform(0.5, 2.0)) + rng.uniform(0, 5) * rng.standard_normal(
        out.shape, np.float32
    )
