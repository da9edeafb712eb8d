"""From light to a JPEG file: exposure, tone, noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from flora_common.arrays import ByteArray, Float32Array

JPEG_QUALITIES: Final = (85, 93)
"""Range of the JPEG quality, one for each box; Pi cameras are run at 85 to 93."""
REFERENCE_EXPOSURE_US: Final = 20_000.0
REFERENCE_COLOUR_GAINS: Final = (1.9, 1.6)
"""Red and blue gain at which a grey card under the flash is grey, nearly."""
LINE_US: Final = 18.904
"""One sensor line: exposures are whole multiples (IMX219 at 1640 x 1232)."""
SHOT_NOISE: Final = 1.5
"""Standard deviation in 8-bit steps at gain 1 in full light. Estimate."""
READ_NOISE: Final = 0.9
_SATURATION: Final = 1.24
_LUMA_BGR: Final = np.array([0.15, 0.55, 0.30])
COLOUR_MATRIX: Final = np.asarray(_SATURATION * np.eye(3) + (1.0 - _SATURATION) * _LUMA_BGR, dtype=np.float32)
"""From sensor colours to picture colours, rows and columns blue, green, red; grey stays grey.

Cameras amplify what tells colours apart, since the sensor's filters overlap. Estimate after photographs. It is linear:
the pictures of single lights go through it once, when they are made.
"""
_POOL_MARGIN: Final = 256


@dataclass(frozen=True, slots=True)
class Exposure:
    """What the camera is told: all locked, nothing automatic."""

    exposure_us: float = REFERENCE_EXPOSURE_US
    analogue_gain: float = 1.0
    colour_gains: tuple[float, float] = REFERENCE_COLOUR_GAINS

    def as_taken(self) -> Exposure:
        """What the sensor can do of it: whole lines, and gains of 256 / (256 - n)."""
        lines = max(1, round(self.exposure_us / LINE_US))
        step = min(232, max(0, round(256.0 - 256.0 / max(self.analogue_gain, 1.0))))
        return Exposure(lines * LINE_US, 256.0 / (256.0 - step), self.colour_gains)

    @property
    def brightness(self) -> float:
        """Relative to the reference exposure."""
        return self.exposure_us / REFERENCE_EXPOSURE_US * self.analogue_gain


class Sensor:
    """Turns linear light into 8-bit pictures and these into JPEG files.

    The noise is cut from a fixed pool of normal values at a place drawn for each picture: as good as fresh noise from
    one picture to the next, and many times faster.
    """

    def __init__(self, width_px: int, height_px: int, seed: int) -> None:
        rng = np.random.default_rng([seed, 31])
        self.jpeg_quality = int(np.random.default_rng([seed, 32]).integers(JPEG_QUALITIES[0], JPEG_QUALITIES[1] + 1))
        pool = rng.standard_normal((height_px + _POOL_MARGIN, width_px + _POOL_MARGIN, 3), dtype=np.float32)
        pool = np.asarray(
            cv2.GaussianBlur(pool, (3, 3), 0.55), np.float32
        )  # neighbouring pixels share noise after demosaicing
        self._pool = np.asarray(np.rint(pool / pool.std() * 64.0), dtype=np.int16)

    @staticmethod
    def balance(light: Float32Array, exposure: Exposure) -> None:
        """Colour gains, in place."""
        red, blue = (gain / known for gain, known in zip(exposure.colour_gains, REFERENCE_COLOUR_GAINS, strict=True))
        if red != 1.0 or blue != 1.0:
            light *= np.array([blue, 1.0, red], np.float32)

    def develop(self, light: Float32Array, exposure: Exposure, rng: np.random.Generator) -> ByteArray:
        """An 8-bit picture (height, width, 3), blue, green, red, from light as exposed; overwrites ``light``.

        The tone curve is the square root (a gamma of 2), under which shot noise is even and read noise grows in the
        dark.
        """
        np.maximum(light, 0.0, out=light)
        cv2.sqrt(light, dst=light)
        flat = cv2.convertScaleAbs(light, alpha=255.0)
        height, width = flat.shape[:2]
        y, x = (int(v) for v in rng.integers(0, _POOL_MARGIN, 2))
        pool = self._pool[y : y + height, x : x + width]
        size = cv2.LUT(flat, _noise_sizes(exposure.analogue_gain))
        noise = cv2.multiply(pool, size, scale=1.0 / (64.0 * 32.0), dtype=cv2.CV_16S)
        return np.asarray(cv2.add(flat, noise, dtype=cv2.CV_8U), dtype=np.uint8)

    def encode(self, picture: ByteArray) -> bytes:
        """A JPEG file."""
        done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])
        if not done:
            raise RuntimeError("OpenCV could not encode a picture as JPEG")
        return bytes(data.tobytes())


def _noise_sizes(gain: float) -> ByteArray:
    """Standard deviation of the noise for each 8-bit value, in 1/32 steps."""
    value = np.maximum(np.arange(256, dtype=np.float64), 6.0)
    shot = SHOT_NOISE * np.sqrt(gain)
    read = READ_NOISE * gain * 24.0 / value
    size = np.sqrt(shot**2 + read**2)
    size[255] = 0.0
    return np.asarray(np.clip(np.rint(size * 32.0), 0, 255), dtype=np.uint8)
