"""Pictures as a rig should never get them, and sometimes does: cut, flipped, dark, foreign, in the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from drawings.good import Good, decoded, goods, stem_share
from drawings.intruders import another_plant, fog, hand, something_else
from drawings.run import drawn_run
from drawings.textures import Rng
from flora_common.arrays import FloatArray

QUALITY: Final = (cv2.IMWRITE_JPEG_QUALITY, 88)
END_MARK: Final = b"\xff\xd9"


@dataclass(frozen=True, slots=True)
class Damaged:
    """A spoilt picture.

    Attributes:
        kind: one of ``KINDS``.
        data: the file.
        has_stem: whether the plant's stem is really in the picture, whole, as a decoder shows it. False where the
            decoder gives no picture, or part of the stem was lost or hidden.
        truth_cm: where the stem is in this picture, or would be where part of it was lost, from the anchor: an answer
            far from that is wrong. None where no answer can be right: no stem, no picture, or not one of this
            camera's (other size, turned).
        source: which of the good pictures it was made of.
    """

    kind: str
    data: bytes
    has_stem: bool
    truth_cm: FloatArray | None
    source: int


Spoilt = tuple[bytes, FloatArray | None, bool]
"""File, true stem, whether a whole stem is in it."""
Spoiler = Callable[[Rng, Good], Spoilt]


def damaged(seed: int, count: int, good: Sequence[Good] | None = None) -> Iterator[Damaged]:
    """Spoilt pictures, every kind in turn, the same for the same seed.

    Args:
        seed: decides everything.
        count: how many.
        good: what to spoil; without, eight pictures of the drawn run of this seed.
    """
    pictures = list(good) if good is not None else goods(drawn_run(seed, hours=72.0, every_s=8 * 3600.0))
    kinds = list(SPOILERS.items())
    for i in range(count):
        rng = np.random.default_rng([seed, 3, i])
        kind, spoil = kinds[i % len(kinds)]
        source = int(rng.integers(len(pictures)))
        data, truth_cm, has_stem = spoil(rng, pictures[source])
        yield Damaged(kind, data, has_stem, truth_cm, source)


def _encoded(picture: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".jpg", np.clip(np.rint(picture), 0, 255).astype(np.uint8), list(QUALITY))[1])


def _judged(data: bytes, good: Good) -> Spoilt:
    """For harmed bytes: how much of the stem came through decides."""
    share = stem_share(data, good)
    return data, good.centreline_cm if share > 0.3 else None, share > 0.97


def _cut(rng: Rng, good: Good) -> Spoilt:
    return _judged(good.jpeg[: int(rng.integers(2, len(good.jpeg) - 2))], good)


def _cut_and_ended(rng: Rng, good: Good) -> Spoilt:
    return _judged(good.jpeg[: int(rng.integers(2, len(good.jpeg) - 2))] + END_MARK, good)


def _flipped(most: int) -> Spoiler:
    def spoil(rng: Rng, good: Good) -> Spoilt:
        data = bytearray(good.jpeg)
        for at in rng.integers(0, len(data) * 8, int(rng.integers(1, most + 1))):
            data[int(at) // 8] ^= 1 << (int(at) % 8)
        return _judged(bytes(data), good)

    return spoil


def _zeroed(rng: Rng, good: Good) -> Spoilt:
    data = bytearray(good.jpeg)
    start, size = int(rng.integers(20, len(data) - 600)), int(rng.choice([1, 16, 512, 4096, 65536]))
    end = min(start + size, len(data) - 2)
    data[start:end] = bytes(end - start)
    return _judged(bytes(data), good)


def _picture(good: Good) -> np.ndarray:
    picture = decoded(good.jpeg)
    assert picture is not None
    return picture


def _other_size(rng: Rng, good: Good) -> Spoilt:
    picture = _picture(good)
    height, width = picture.shape[:2]
    sizes = [(width // 2, height // 2), (640, 480), (width, height - 8), (height, height), (1, 1), (16, 16)]
    size = sizes[int(rng.integers(len(sizes)))]
    return _encoded(cv2.resize(picture, size, interpolation=cv2.INTER_AREA)), None, min(size) > 100


def _turned(rng: Rng, good: Good) -> Spoilt:
    return _encoded(np.rot90(_picture(good), int(rng.choice([1, 3])))), None, True


def _even(low: int, high: int) -> Spoiler:
    def spoil(rng: Rng, good: Good) -> Spoilt:
        level = float(rng.integers(low, high + 1))
        shape = _picture(good).shape
        return _encoded(np.full(shape, level) + rng.uniform(0, 3) * rng.standard_normal(shape, np.float32)), None, False

    return spoil


def _noisy(rng: Rng, good: Good) -> Spoilt:
    picture = _picture(good).astype(np.float32)
    deviation = rng.uniform(25, 90)
    picture += np.float32(deviation) * rng.standard_normal(picture.shape, np.float32)
    return _encoded(picture), good.centreline_cm, True


def _blurred(rng: Rng, good: Good) -> Spoilt:
    return _encoded(cv2.GaussianBlur(_picture(good), None, rng.uniform(4, 25))), good.centreline_cm, True


def _no_plant(rng: Rng, good: Good) -> Spoilt:
    empty = decoded(good.empty)
    assert empty is not None
    picture = empty * rng.uniform(0.93, 1.07) * (1 + rng.uniform(-0.03, 0.03, 3))
    return _encoded(picture + rng.normal(0, 2, picture.shape)), None, False


def _dark(rng: Rng, good: Good) -> Spoilt:
    picture = _picture(good).astype(np.float32) * np.float32(rng.uniform(0.02, 0.30)) * (1 + rng.uniform(-0.3, 0.3, 3))
    return _encoded(picture + rng.normal(0, 1.5, picture.shape)), good.centreline_cm, True


def _moved(rng: Rng, good: Good) -> Spoilt:
    picture = _picture(good)
    far, turn = rng.uniform(10, 100), rng.uniform(0, 2 * np.pi)
    by = far * np.array([np.cos(turn), np.sin(turn)])
    matrix = np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]]])
    size = picture.shape[1], picture.shape[0]
    picture = cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return _encoded(picture), good.centreline_cm + by * (1.0, -1.0) / good.camera.px_per_cm, True


def _two_plants(rng: Rng, good: Good) -> Spoilt:
    return _encoded(another_plant(rng, _picture(good), good.camera)), good.centreline_cm, True


def _hand(rng: Rng, good: Good) -> Spoilt:
    picture, cover = hand(rng, _picture(good), good.line_px)
    x, y = np.rint(good.line_px).astype(int).T
    hidden = cover[np.clip(y, 0, cover.shape[0] - 1), np.clip(x, 0, cover.shape[1] - 1)] > 0.5
    return _encoded(picture), good.centreline_cm, not hidden.any()


def _fogged(rng: Rng, good: Good) -> Spoilt:
    return _encoded(fog(rng, _picture(good))), good.centreline_cm, True


def _foreign(rng: Rng, good: Good) -> Spoilt:
    return _encoded(something_else(rng, _picture(good).shape)), None, False


def _png(rng: Rng, good: Good) -> Spoilt:
    level = int(rng.integers(1, 4))
    png = cv2.imencode(".png", _picture(good), [cv2.IMWRITE_PNG_COMPRESSION, level])[1]
    return bytes(png), good.centreline_cm, True


def _nothing(rng: Rng, good: Good) -> Spoilt:
    return b"", None, False


def _text(rng: Rng, good: Good) -> Spoilt:
    lines = (f"{i};{rng.normal():.6f};left\n" for i in range(int(rng.integers(1, 2000))))
    return "".join(lines).encode(), None, False


SPOILERS: Final[dict[str, Spoiler]] = {
    "cut": _cut,
    "cut and ended": _cut_and_ended,
    "one bit": _flipped(1),
    "many bits": _flipped(200),
    "zeroed": _zeroed,
    "other size": _other_size,
    "turned": _turned,
    "black": _even(0, 2),
    "white": _even(253, 255),
    "grey": _even(20, 235),
    "noisy": _noisy,
    "blurred": _blurred,
    "no plant": _no_plant,
    "dark": _dark,
    "moved": _moved,
    "two plants": _two_plants,
    "hand": _hand,
    "fogged": _fogged,
    "foreign": _foreign,
    "png": _png,
    "nothing": _nothing,
    "text": _text,
}
KINDS: Final = tuple(SPOILERS)
AFTER_CAPTURE: Final = ("cut", "cut and ended", "one bit", "many bits", "zeroed", "nothing", "text")
"""Kinds of damage to a file that was whole when it was taken. The others are what a camera may see or send."""
