"""Where the rays of the camera end: wall, floor, pot, soil and lamp bodies, with their texture.

Done once per camera. Every surface gives the depth at which a ray meets it (infinite where it does not); the nearest
one owns the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from flora_twin.box import Box, PinholeCamera

Float32 = npt.NDArray[np.float32]

WALL, FLOOR, POT, SOIL, LAMP = 0, 1, 2, 3, 4


@dataclass(frozen=True, slots=True)
class Surfaces:
    """What every pixel shows of the box without a plant.

    Attributes:
        place_cm: shape (height, width, 3).
        normal: shape (height, width, 3), unit.
        albedo: shape (height, width, 3), blue, green, red.
        kind: shape (height, width), one of the constants above.
        glow: shape (2, height, width), 1 on lit parts of the left and the right lamp.
    """

    place_cm: Float32
    normal: Float32
    albedo: Float32
    kind: npt.NDArray[np.uint8]
    glow: Float32


def see_box(camera: PinholeCamera, box: Box, seed: int) -> Surfaces:
    """Trace all pixels of the empty box; the seed draws the textures."""
    ray = camera.rays().astype(np.float32)
    eye = camera.position_cm
    rng = np.random.default_rng([seed, 21])
    shape = ray.shape[:2]
    depth = np.full(shape, np.float32(eye[2] - box.wall_z_cm))
    kind = np.full(shape, WALL, dtype=np.uint8)
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = 1.0

    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(ray[..., 1] < 0, (box.ground_y_cm - eye[1]) / ray[..., 1], np.inf).astype(np.float32)
        near = floor < depth
        depth[near], kind[near], normal[near] = floor[near], FLOOR, (0.0, 1.0, 0.0)

        soil = np.where(ray[..., 1] < 0, -eye[1] / ray[..., 1], np.inf).astype(np.float32)
        x, z = ray[..., 0] * soil, eye[2] - soil
        inside = (np.hypot(x, z) < box.pot_top_radius_cm - 0.25) & (soil < depth)
        depth[inside], kind[inside], normal[inside] = soil[inside], SOIL, (0.0, 1.0, 0.0)

    rim_low = box.rim_above_soil_cm - 1.9
    slope = (box.pot_top_radius_cm - box.pot_bottom_radius_cm) / box.pot_height_cm
    _add_cone(ray, eye, depth, kind, normal, (box.ground_y_cm, rim_low), box.pot_top_radius_cm, slope, POT)
    _add_cone(ray, eye, depth, kind, normal, (rim_low, box.rim_above_soil_cm), box.pot_top_radius_cm + 0.35, 0.0, POT)
    _add_cone(
        ray, eye, depth, kind, normal, (0.0, box.rim_above_soil_cm), box.pot_top_radius_cm - 0.25, 0.0, POT, inner=True
    )
    glow = np.zeros((2, *shape), np.float32)
    for i, lamp in enumerate(box.lamps_cm):
        half = box.lamp_body_cm / 2
        hit = _add_cone(
            ray, eye, depth, kind, normal, (lamp[1] - half, lamp[1] + half), box.lamp_radius_cm, 0.0, LAMP, centre=lamp
        )
        glow[i][hit] = 1.0

    place = ray * depth[..., None] + eye.astype(np.float32)
    albedo = _albedo(place, normal, kind, rng)
    for i, lamp in enumerate(box.lamps_cm):
        _coil(place, lamp, glow[i], albedo)
    return Surfaces(place, normal, albedo, kind, glow)


def _add_cone(
    ray: Float32,
    eye: npt.NDArray[np.float64],
    depth: Float32,
    kind: npt.NDArray[np.uint8],
    normal: Float32,
    span_cm: tuple[float, float],
    radius_cm: float,
    slope: float,
    what: int,
    *,
    inner: bool = False,
    centre: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.bool_]:
    """An upright cone mantle of radius ``radius_cm + slope * y``, or its inside; returns the pixels that it covers."""
    cx, cz = (0.0, 0.0) if centre is None else (float(centre[0]), float(centre[2]))
    ox, oz = float(eye[0]) - cx, float(eye[2]) - cz
    r0 = radius_cm + slope * float(eye[1])
    rx, ry, rz = ray[..., 0], ray[..., 1], ray[..., 2]
    a = rx * rx + rz * rz - (slope * ry) ** 2
    b = ox * rx + oz * rz - slope * ry * r0
    c = ox * ox + oz * oz - r0 * r0
    root = b * b - a * c
    with np.errstate(invalid="ignore"):
        t = (-b + (1.0 if inner else -1.0) * np.sqrt(root)) / a
    y = eye[1] + t * ry
    hit = (root > 0) & (t > 0) & (t < depth) & (y >= span_cm[0]) & (y <= span_cm[1])
    sign = -1.0 if inner else 1.0
    depth[hit], kind[hit] = t[hit], what
    side = np.stack([ox + t[hit] * rx[hit], np.zeros(int(hit.sum())), oz + t[hit] * rz[hit]], axis=1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    side[:, 1] = -slope
    normal[hit] = sign * side
    return np.asarray(hit)


def _albedo(place: Float32, normal: Float32, kind: npt.NDArray[np.uint8], rng: np.random.Generator) -> Float32:
    """Reflectance in blue, green and red: faint texture, seams between the boards, soil crumbs, a grey plastic pot."""
    shape = kind.shape
    grain = rng.standard_normal(shape, dtype=np.float32)
    clouds = _noise(rng, shape, 90.0) + 0.6 * _noise(rng, shape, 24.0)
    fine = cv2.GaussianBlur(grain, (0, 0), 1.1) * 2.6
    board = 0.040 * (1.0 + 0.045 * clouds + 0.09 * fine)
    for seam, width in ((-21.0, 0.10), (41.5, 0.10)):
        board *= 1.0 - 0.55 * np.exp(-(((place[..., 0] - seam) / width) ** 2))
    out = board[..., None] * np.array([1.02, 1.0, 1.04], np.float32)
    floor = kind == FLOOR
    dust = 1.0 + 0.9 * (fine[floor] > 2.4)
    out[floor] = (1.15 * board[floor] * dust)[:, None] * np.array([0.98, 1.0, 1.04], np.float32)
    soil = kind == SOIL
    crumbs = cv2.GaussianBlur(grain, (0, 0), 2.2) * 5.5 + 0.8 * fine
    out[soil] = (0.050 * np.clip(1.0 + 0.40 * crumbs[soil], 0.25, 2.6))[:, None] * np.array(
        [0.62, 0.85, 1.1], np.float32
    )
    pot = kind == POT
    height = place[pot][:, 1]
    ring = 1.0 - 0.30 * np.exp(-(((height + 1.4) / 0.12) ** 2)) - 0.12 * np.exp(-(((height + 6.5) / 0.10) ** 2))
    plastic = 0.155 * ring * (1.0 + 0.03 * clouds[pot] + 0.02 * fine[pot])
    out[pot] = plastic[:, None] * np.array([0.96, 0.98, 1.0], np.float32)
    return np.ascontiguousarray(np.clip(out, 0.008, 0.9), dtype=np.float32)


def _coil(place: Float32, lamp: npt.NDArray[np.float64], glow: Float32, albedo: Float32) -> None:
    """The strip in turns round a dark tube: pale tape with diodes."""
    body = glow > 0
    p = place[body] - lamp.astype(np.float32)
    angle = np.arctan2(p[:, 0], p[:, 2])
    turn = np.mod(p[:, 1] - 2.1 * angle / (2 * np.pi), 2.1)
    tape = turn < 1.25
    diode = tape & (np.abs(turn - 0.62) < 0.22) & (np.mod(angle * 3.6 / 0.695, 1.0) < 0.62)
    albedo[body] = np.where(tape, 0.34, 0.05)[:, None]
    albedo[body] += np.where(diode, 0.25, 0.0)[:, None] * np.array([0.7, 1.0, 1.0], np.float32)
    glow[body] = np.where(diode, 1.0, np.where(tape, 0.55, 0.25))


def _noise(rng: np.random.Generator, shape: tuple[int, int], size_px: float) -> Float32:
    """Smooth noise of unit variance with features of about ``size_px``."""
    small = rng.standard_normal((int(shape[0] / size_px) + 4, int(shape[1] / size_px) + 4)).astype(np.float32)
    large = cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(large / large.std(), dtype=np.float32)
