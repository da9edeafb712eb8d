"""The lens: blur that grows towards the corners, colours of slightly different size, fall of brightness."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from flora_common.arrays import Float32Array
from flora_twin.box import PinholeCamera

BLUR_PX: Final = 0.80
CORNER_BLUR_PX: Final = 1.7
"""Standard deviations of the point spread in the middle and at the corners. Estimate for the Pi camera v2."""
RED_SCALE: Final = 1.0 + 6e-4
BLUE_SCALE: Final = 1.0 - 5e-4
"""Size of the red and blue picture relative to the green one: half a pixel at the corners. Estimate."""
_NEARLY_MIDDLE: Final = 0.12


def vignette(camera: PinholeCamera) -> Float32Array:
    """Fall of brightness towards the corners, shape (height, width)."""
    ray = camera.rays()
    r2 = ray[..., 0] ** 2 + ray[..., 1] ** 2
    return np.asarray(1.0 / (1.0 + 0.85 * r2), dtype=np.float32)


def whole_picture(light: Float32Array, camera: PinholeCamera) -> Float32Array:
    """Blur and colour fringes for a whole picture (height, width, 3)."""
    sharp = cv2.GaussianBlur(light, (0, 0), BLUR_PX)
    soft = cv2.GaussianBlur(light, (0, 0), CORNER_BLUR_PX)
    weight = _softness((slice(0, camera.height_px), slice(0, camera.width_px)), camera)[..., None]
    out = np.asarray(sharp + weight * (soft - sharp), dtype=np.float32)
    for channel, scale in ((0, BLUE_SCALE), (2, RED_SCALE)):
        out[..., channel] = _scaled(np.ascontiguousarray(out[..., channel]), scale, 0, 0, camera)
    return out


def through_lens(
    drawn: Float32Array, window: tuple[slice, slice], camera: PinholeCamera
) -> tuple[Float32Array, Float32Array]:
    """The same for a part of the picture.

    Args:
        drawn: shape (h, w, 4): blue, green, red, cover.
        window: rows and columns of the picture.
        camera: whose lens it is.

    Returns:
        Light (h, w, 3) and cover (h, w, 3).
    """
    out = cv2.GaussianBlur(drawn, (0, 0), BLUR_PX)
    weight = _softness(window, camera)
    if weight.max() > _NEARLY_MIDDLE:
        soft = cv2.GaussianBlur(drawn, (0, 0), CORNER_BLUR_PX)
        out = out + weight[..., None] * (soft - out)
    blue, green, red, alpha = (np.asarray(plane, dtype=np.float32) for plane in cv2.split(out))
    x0, y0 = window[1].start, window[0].start
    light = cv2.merge([_scaled(blue, BLUE_SCALE, x0, y0, camera), green, _scaled(red, RED_SCALE, x0, y0, camera)])
    cover = cv2.merge([_scaled(alpha, BLUE_SCALE, x0, y0, camera), alpha, _scaled(alpha, RED_SCALE, x0, y0, camera)])
    return np.asarray(light, dtype=np.float32), np.asarray(cover, dtype=np.float32)


def _softness(window: tuple[slice, slice], camera: PinholeCamera) -> Float32Array:
    """Share of the corner's blur, 0 in the middle and 1 at the corners."""
    x = np.arange(window[1].start, window[1].stop, dtype=np.float32) - np.float32((camera.width_px - 1) / 2)
    y = np.arange(window[0].start, window[0].stop, dtype=np.float32) - np.float32((camera.height_px - 1) / 2)
    r2 = (x * x)[None, :] + (y * y)[:, None]
    return np.asarray(r2 * np.float32(4.0 / (camera.width_px**2 + camera.height_px**2)), dtype=np.float32)


def _scaled(plane: Float32Array, scale: float, x0: int, y0: int, camera: PinholeCamera) -> Float32Array:
    """One colour, made larger by ``scale`` about the middle of the picture."""
    cx, cy = (camera.width_px - 1) / 2 - x0, (camera.height_px - 1) / 2 - y0
    shift = np.array([[1.0 / scale, 0.0, cx * (1.0 - 1.0 / scale)], [0.0, 1.0 / scale, cy * (1.0 - 1.0 / scale)]])
    size = (plane.shape[1], plane.shape[0])
    moved = cv2.warpAffine(
        plane, shift, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(moved, dtype=np.float32)
