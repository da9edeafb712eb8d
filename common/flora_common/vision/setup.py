"""What the empty setup looks like: the matrices L and H of the published method.

L and H are the smallest and largest green value that each pixel takes over pictures of the setup without a plant, in
every lamp state (Wahby et al. 2018, "Stem motion tracking", first equation). Where nobody took such pictures,
:func:`learn_from_frames` makes do with the plant's own: a stem that moves leaves every place empty in some frames.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from flora_common import files
from flora_common.arrays import ByteArray, Float32Array
from flora_common.errors import BadInput, BadPicture
from flora_common.vision.lamp_states import MadeBy
from flora_common.vision.picture import Picture, Reduction, checked_array, decode_picture, read_picture_bytes

_FORMAT: Final = 1


def green(picture: Picture) -> Float32Array:
    """The green channel remapped onto [0, 1]; shape (height, width)."""
    return np.asarray(picture[:, :, 1], dtype=np.float32) / np.float32(255.0)


@dataclass(frozen=True, slots=True, eq=False)
class SetupMatrices:
    """The interval of green values that the setup itself can show, per pixel of the reduced picture.

    Attributes:
        L: smallest value, shape (height, width), float32 in [0, 1].
        H: largest value, likewise; nowhere below L.
        made_by: ``background`` (pictures without a plant) or ``frames`` (learnt from the plant's own pictures).
        pictures: how many pictures went in.
        sources_sha256: hash over what went in, to know when a stored copy is out of date; empty where unknown.
    """

    L: Float32Array
    H: Float32Array
    made_by: MadeBy = "background"
    pictures: int = 0
    sources_sha256: str = ""

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the reduced picture."""
        return self.L.shape[1], self.L.shape[0]

    def save(self, path: Path) -> None:
        """Write as ``.npz``, whole or not at all."""
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            format=np.int64(_FORMAT),
            L=self.L,
            H=self.H,
            made_by=np.str_(self.made_by),
            pictures=np.int64(self.pictures),
            sources_sha256=np.str_(self.sources_sha256),
        )
        files.write_bytes(path, buffer.getvalue())

    @classmethod
    def load(cls, path: Path) -> SetupMatrices:
        """Read what :meth:`save` wrote, checked.

        Raises:
            BadInput: missing, not such a file, or values that cannot be.
        """
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
                if int(stored["format"]) != _FORMAT:
                    raise BadInput(f"{path}: format {int(stored['format'])} is not known; make the setup matrices anew")
                low, high = stored["L"], stored["H"]
                made_by, pictures = str(stored["made_by"]), int(stored["pictures"])
                sources = str(stored["sources_sha256"])
        except OSError as problem:
            raise BadInput(f"{path}: cannot be read ({problem.strerror or problem})") from problem
        except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, NotImplementedError) as problem:
            raise BadInput(f"{path}: not a file of setup matrices; make them anew") from problem
        if (
            low.dtype != np.float32
            or high.dtype != np.float32
            or low.ndim != 2
            or low.size == 0
            or low.shape != high.shape
        ):
            raise BadInput(f"{path}: L and H must be two float32 matrices of one shape; make them anew")
        # written so that NaN fails it too
        if not (np.all(low >= 0.0) and np.all(high <= 1.0) and np.all(low <= high)):
            raise BadInput(f"{path}: needs 0 <= L <= H <= 1 at every pixel; make the setup matrices anew")
        if made_by == "background":
            return cls(low, high, "background", pictures, sources)
        if made_by == "frames":
            return cls(low, high, "frames", pictures, sources)
        raise BadInput(f"{path}: made by `{made_by[:40]}`, which is not known; make the setup matrices anew")


def from_pictures(pictures: Iterable[Picture], *, sources_sha256: str = "") -> SetupMatrices:
    """L and H over pictures of the setup without a plant (first equation of the section).

    Args:
        pictures: at least one, all of one size, already at the resolution at which stems are looked for.
        sources_sha256: stored with the result.

    Raises:
        BadPicture: none at all, or of different sizes.
    """
    low: ByteArray | None = None
    high: ByteArray | None = None
    count = 0
    for picture in pictures:
        level = checked_array(picture, where=f"background picture {count + 1}")[:, :, 1]
        if low is None or high is None:
            low, high = level.copy(), level.copy()
        elif level.shape != low.shape:
            raise BadPicture(f"background picture {count + 1}: {_size(level)} px, the first has {_size(low)}")
        else:
            np.minimum(low, level, out=low)
            np.maximum(high, level, out=high)
        count += 1
    if low is None or high is None:
        raise BadPicture("no background pictures; take some of the setup without a plant, in every lamp state")
    return SetupMatrices(_unit(low), _unit(high), "background", count, sources_sha256)


def from_files(
    paths: Sequence[Path], *, reduction: Reduction, expected_size: tuple[int, int] | None = None
) -> SetupMatrices:
    """L and H from picture files, and the hash of their contents and the reduction.

    Args:
        paths: pictures of the setup without a plant, in every lamp state.
        reduction: as in :func:`flora_common.vision.picture.decode_picture`.
        expected_size: (width, height) in px that each full picture must have.

    Raises:
        BadPicture: no files, or one that cannot be used; the message names it.
    """
    digest = hashlib.sha256(f"reduction {reduction}\n".encode())

    def decoded() -> Iterable[Picture]:
        for path in paths:
            data = read_picture_bytes(path)
            digest.update(hashlib.sha256(data).digest())
            yield decode_picture(data, where=str(path), expected_size=expected_size, reduction=reduction)

    made = from_pictures(decoded())
    return SetupMatrices(made.L, made.H, made.made_by, made.pictures, digest.hexdigest())


def hash_of_files(paths: Sequence[Path], *, reduction: Reduction) -> str:
    """The ``sources_sha256`` that :func:`from_files` would give, without decoding: is a stored copy still current?"""
    digest = hashlib.sha256(f"reduction {reduction}\n".encode())
    for path in paths:
        digest.update(hashlib.sha256(read_picture_bytes(path)).digest())
    return digest.hexdigest()


def learn_from_frames(frames: Sequence[Picture], *, percentiles: tuple[float, float] = (5.0, 10.0)) -> SetupMatrices:
    """L and H from pictures that show the plant, all taken in one lamp state.

    At each pixel the green values over all frames are put in order; L and H are two percentiles of them. The default
    takes them from the dark end: a plant before black cloth is brighter than any empty place, so a place shows what it
    looks like empty as soon as the plant is away from it in a tenth of the frames. (Percentiles about the median would
    need half of them, and a stem that hardly moves is then taken for setup.) For a dark plant before a bright wall use
    the bright end, ``(90, 95)``. A place that the plant never leaves, such as a stem's base, cannot be known this way:
    there the stem is not seen, and in a frame without a plant its absence is.

    Args:
        frames: at least 5, all of one size, spread over the whole stretch of time.
        percentiles: of L and of H, 0 to 100, the first not above the second.

    Raises:
        BadPicture: too few frames, or of different sizes.
        ValueError: percentiles out of order.
    """
    if not 0.0 <= percentiles[0] <= percentiles[1] <= 100.0:
        raise ValueError(f"percentiles {percentiles} must rise within 0 and 100")
    if len(frames) < 5:
        raise BadPicture(
            f"{len(frames)} frames are too few to learn the empty setup from; 5 at least, or take background pictures"
        )
    levels = [checked_array(frame, where=f"frame {i}")[:, :, 1] for i, frame in enumerate(frames)]
    for i, level in enumerate(levels):
        if level.shape != levels[0].shape:
            raise BadPicture(f"frame {i}: {_size(level)} px, the first has {_size(levels[0])}")
    stack = np.sort(np.stack(levels), axis=0)
    last = len(levels) - 1
    low = stack[round(percentiles[0] / 100.0 * last)]
    high = stack[round(percentiles[1] / 100.0 * last)]
    return SetupMatrices(_unit(low), _unit(high), "frames", len(levels))


def _unit(levels: ByteArray) -> Float32Array:
    return levels.astype(np.float32) / np.float32(255.0)


def _size(level: ByteArray) -> str:
    return f"{level.shape[1]}x{level.shape[0]}"
