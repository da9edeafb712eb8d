"""Where the rays of the camera end: wall, floor, pot and its cloth, soil and lamp bodies, with their texture.

Done once per camera. Every surface gives the depth at which a ray meets it (infinite where it does not); the nearest
one owns the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from flora_common.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from flora_twin.box import Box, PinholeCamera
from flora_twin.render.cloth import crumpled, dust, relief, weave
from flora_twin.render.decor import Decor, cloth_radius_cm

WALL, FLOOR, POT, SOIL, LAMP, LINER, HOLDER = 0, 1, 2, 3, 4, 5, 6


@dataclass(frozen=True, slots=True)
class Front:
    """The edge of the pot's cloth on the camera's side: it hides the stem's foot.

    Attributes:
        edge_px: polygon (n, 2) of what hides, closed far below the picture.
        depth_cm: distance from the camera, along its axis, of what is just hidden.
    """

    edge_px: FloatArray
    depth_cm: float


@dataclass(frozen=True, slots=True)
class Surfaces:
    """What every pixel shows of the box without a plant.

    Attributes:
        place_cm: shape (height, width, 3).
        normal: shape (height, width, 3), unit.
        albedo: shape (height, width, 3), blue, green, red.
        kind: shape (height, width), one of the constants above.
        glow: shape (2, height, width), 1 on lit parts of the left and the right lamp.
        front: the pot's cloth where it hides the stem.
        decor: what this box has of its own.
    """

    place_cm: Float32Array
    normal: Float32Array
    albedo: Float32Array
    kind: ByteArray
    glow: Float32Array
    front: Front
    decor: Decor


def see_box(camera: PinholeCamera, box: Box, seed: int) -> Surfaces:
    """Trace all pixels of the empty box; the seed draws the textures."""
    ray = camera.rays().astype(np.float32)
    eye = camera.position_cm
    decor = Decor.draw(seed)
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
    _add_liner(ray, eye, depth, kind, normal, decor, camera, box)
    glow = np.zeros((2, *shape), np.float32)
    for i, lamp in enumerate(box.lamps_cm):
        half = box.lamp_body_cm / 2
        hit = _add_cone(
            ray, eye, depth, kind, normal, (lamp[1] - half, lamp[1] + half), box.lamp_radius_cm, 0.0, LAMP, centre=lamp
        )
        glow[i][hit] = 1.0
        cap = (float(lamp[1]) + half, float(lamp[1]) + half + 2.4)
        _add_cone(ray, eye, depth, kind, normal, cap, box.lamp_radius_cm * 0.8, 0.0, HOLDER, centre=lamp)

    place = ray * depth[..., None] + eye.astype(np.float32)
    _ruffle(normal, place, kind, decor, rng)
    albedo = _albedo(place, kind, decor, rng)
    _cables(albedo, normal, kind, camera, box, rng)
    for i, lamp in enumerate(box.lamps_cm):
        _coil(place, lamp, glow[i], albedo)
    return Surfaces(place, normal, albedo, kind, glow, _front(decor, camera, box), decor)


def _add_cone(
    ray: Float32Array,
    eye: FloatArray,
    depth: Float32Array,
    kind: ByteArray,
    normal: Float32Array,
    span_cm: tuple[float, float],
    radius_cm: float,
    slope: float,
    what: int,
    *,
    inner: bool = False,
    centre: FloatArray | None = None,
) -> BoolArray:
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


def _add_liner(
    ray: Float32Array,
    eye: FloatArray,
    depth: Float32Array,
    kind: ByteArray,
    normal: Float32Array,
    decor: Decor,
    camera: PinholeCamera,
    box: Box,
) -> None:
    """Black cloth that lines the pot and hangs over its rim, with a wavy edge."""
    hem = box.rim_above_soil_cm - 1.3
    tallest = float(decor.rim_cloth_cm(np.linspace(0.0, 2 * np.pi, 181), camera, box).max())
    outside, bottom = cloth_radius_cm(box), box.pot_top_radius_cm - 0.3
    opens = (outside - bottom) / float(decor.rim_cloth_cm(np.linspace(0.0, 2 * np.pi, 181), camera, box).mean())
    for inner, low, radius, slope in ((True, 0.0, bottom, opens), (False, hem - 0.6, outside, 0.0)):
        # Try on a copy: which of the mantle's pixels lie below the edge is known only once they are hit.
        near, what, towards = depth.copy(), kind.copy(), normal.copy()
        hit = _add_cone(ray, eye, near, what, towards, (low, tallest), radius, slope, LINER, inner=inner)
        place = ray[hit] * near[hit][:, None] + eye.astype(np.float32)
        angle = np.arctan2(place[:, 2], place[:, 0])
        lowest = low if inner else hem + 0.35 * np.sin(3.0 * angle + decor.waves[0, 2]) + 0.2 * np.sin(8.0 * angle)
        keep = (place[:, 1] < decor.rim_cloth_cm(angle, camera, box)) & (place[:, 1] > lowest)
        rows, columns = (index[keep] for index in np.nonzero(hit))
        depth[rows, columns], kind[rows, columns] = near[rows, columns], LINER
        normal[rows, columns] = towards[rows, columns]


def _front(decor: Decor, camera: PinholeCamera, box: Box) -> Front:
    angle = np.linspace(0.0, np.pi, 91)
    radius = cloth_radius_cm(box)
    height = decor.rim_cloth_cm(angle, camera, box)
    edge = camera.project(np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1))
    below = np.array([[edge[-1, 0], 3.0 * camera.height_px], [edge[0, 0], 3.0 * camera.height_px]])
    return Front(np.concatenate([edge, below]), float(camera.position_cm[2] - radius))


def _ruffle(normal: Float32Array, place: Float32Array, kind: ByteArray, decor: Decor, rng: np.random.Generator) -> None:
    """Tip the normals of the cloths by their folds."""
    on_wall = np.ascontiguousarray(place[..., :2])
    # The wall is square to the camera: its x depends on the column only, its y on the row only.
    wall_row, wall_column = np.argwhere(kind == WALL)[0]
    x = _along(on_wall[wall_row, :, 0], kind[wall_row] == WALL)
    y = _along(on_wall[:, wall_column, 1], kind[:, wall_column] == WALL)
    wall = kind == WALL
    slopes = relief(x, y, decor, rng)
    normal[wall, :2] = -slopes[wall]
    liner = kind == LINER
    rows, columns = np.nonzero(liner.any(axis=1))[0], np.nonzero(liner.any(axis=0))[0]
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    slopes = crumpled((rows[-1] + 1 - rows[0], columns[-1] + 1 - columns[0]), rng)
    inside = liner[part]
    pushed = normal[part]
    pushed[inside, :2] -= 0.65 * slopes[inside]
    for cloth in (wall, liner):
        normal[cloth] /= np.linalg.norm(normal[cloth], axis=1, keepdims=True)


def _along(value: Float32Array, known: BoolArray) -> Float32Array:
    """Continue evenly spaced values over a line where only some are known."""
    at = np.nonzero(known)[0]
    step = (value[at[-1]] - value[at[0]]) / (at[-1] - at[0])
    return np.asarray(value[at[0]] + step * (np.arange(len(value)) - at[0]), dtype=np.float32)


def _albedo(place: Float32Array, kind: ByteArray, decor: Decor, rng: np.random.Generator) -> Float32Array:
    """Reflectance in blue, green and red: cloth, dust, soil crumbs and a plastic pot."""
    shape = kind.shape
    texture = weave((shape[0], shape[1]), rng)
    specks = dust((shape[0], shape[1]), decor, rng)
    out = texture[..., None] * decor.cloth_bgr.astype(np.float32)
    if decor.skirting:
        edge = (kind == WALL) & (place[..., 1] < -11.3)
        out[edge] = decor.skirting
    floor = kind == FLOOR
    out[floor] = 1.5 * texture[floor][:, None] * decor.cloth_bgr.astype(np.float32)
    out[kind == LINER] *= 1.9  # it is lit from above, pulled smooth and shines
    soil = kind == SOIL
    grain = rng.standard_normal(shape, dtype=np.float32)
    crumbs = cv2.GaussianBlur(grain, (0, 0), 2.2) * 5.5 + 0.8 * cv2.GaussianBlur(grain, (0, 0), 1.1) * 2.6
    if not decor.soil_covered:
        out[soil] = (0.050 * np.clip(1.0 + 0.40 * crumbs[soil], 0.25, 2.6))[:, None] * np.array(
            [0.62, 0.85, 1.1], np.float32
        )
        perlite = soil & (crumbs > 2.3)
        out[perlite] += 0.25
    pot = kind == POT
    height = place[pot][:, 1]
    ring = 1.0 - 0.30 * np.exp(-(((height + 1.4) / 0.12) ** 2)) - 0.12 * np.exp(-(((height + 6.5) / 0.10) ** 2))
    out[pot] = (ring * (0.7 + 0.3 * texture[pot]))[:, None] * decor.pot_bgr.astype(np.float32)
    out[kind == HOLDER] = 0.45
    out += specks[..., None]
    return np.ascontiguousarray(np.clip(out, 0.004, 0.9), dtype=np.float32)


def _cables(
    albedo: Float32Array,
    normal: Float32Array,
    kind: ByteArray,
    camera: PinholeCamera,
    box: Box,
    rng: np.random.Generator,
) -> None:
    """The lamps' cables in front of the cloth, from above the picture to the lamps' caps."""
    for lamp in box.lamps_cm:
        side = np.sign(lamp[0])
        end = lamp + np.array([0.0, box.lamp_body_cm / 2 + 2.0, 0.0])
        start = np.array([side * rng.uniform(2.0, 24.0), 74.0, box.wall_z_cm + 1.5])
        sag = np.array([side * rng.uniform(-4.0, 4.0), -rng.uniform(3.0, 9.0), 0.0])
        t = np.linspace(0.0, 1.0, 60)[:, None]
        path = (1 - t) ** 2 * start + 2 * t * (1 - t) * (0.5 * (start + end) + sag) + t * t * end
        pixels = np.rint(camera.project(path) * 16).astype(np.int32)
        thick = 0.55 * camera.focal_px / (camera.position_cm[2] - box.wall_z_cm)
        grey = float(rng.choice([0.03, 0.10, 0.25]))
        free = kind == WALL
        shadow = np.zeros(kind.shape, np.float32)
        cv2.polylines(shadow, [pixels + np.array([0, 20 * 16])], False, 1.0, round(2 * thick), cv2.LINE_8, 4)
        albedo *= (1.0 - 0.35 * free * cv2.GaussianBlur(shadow, (0, 0), 7.0))[..., None]
        for share, lean in ((1.0, -0.6), (0.66, 0.1), (0.3, 0.8)):
            body = np.zeros(kind.shape, np.uint8)
            cv2.polylines(body, [pixels], False, 1, max(1, round(share * thick)), cv2.LINE_8, 4)
            there = (body > 0) & free
            albedo[there] = grey * (0.7 + 0.4 * (1.0 - share))
            normal[there] = np.array([0.0, lean, 1.0]) / np.hypot(1.0, lean)


def _coil(place: Float32Array, lamp: FloatArray, glow: Float32Array, albedo: Float32Array) -> None:
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
