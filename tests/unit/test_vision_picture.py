"""Pictures are whole, of the right size and the ones announced, or refused in one line."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flora_common.errors import BadPicture
from flora_common.vision.header import picture_size
from flora_common.vision.picture import decode_picture, read_picture, reduce_picture, reduced_size

BAD = Path(__file__).parents[1] / "golden" / "pictures_bad"
SENTENCES = tomllib.loads((BAD / "sentences.toml").read_text())


def texture(width: int, height: int) -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 255, (height, width, 3), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 3)


def encode(suffix: str, picture: np.ndarray) -> bytes:
    return cv2.imencode(suffix, picture)[1].tobytes()


JPEG = encode(".jpg", texture(60, 40))
PNG = encode(".png", texture(60, 40))


def test_every_bad_example_has_its_sentence_and_the_other_way_round() -> None:
    assert sorted(SENTENCES) == sorted(p.name for p in BAD.iterdir() if p.suffix != ".toml")


@pytest.mark.parametrize("name", sorted(SENTENCES))
def test_bad_picture_is_told_in_one_line(name: str) -> None:
    known = dict(SENTENCES[name])
    sentence = known.pop("sentence").replace("{path}", str(BAD / name))
    if "expected_size" in known:
        known["expected_size"] = tuple(known["expected_size"])
    with pytest.raises(BadPicture) as told:
        read_picture(BAD / name, **known)
    assert str(told.value) == sentence
    assert told.value.exit_status == 2


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_whole_picture_is_decoded(suffix: str) -> None:
    picture = texture(60, 40)
    data = encode(suffix, picture)
    decoded = decode_picture(data, where="x", expected_size=(60, 40), sha256=hashlib.sha256(data).hexdigest())
    assert decoded.shape == (40, 60, 3)
    assert np.abs(decoded.astype(int) - picture).mean() < (3.0 if suffix == ".jpg" else 1e-9)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("reduction", [2, 4, 8])
@pytest.mark.parametrize("size", [(64, 48), (61, 43), (17, 9)])
def test_reduced_decoding_averages_squares(suffix: str, reduction: int, size: tuple[int, int]) -> None:
    picture = texture(*size)
    decoded = decode_picture(encode(suffix, picture), where="x", reduction=reduction)  # type: ignore[arg-type]
    assert (decoded.shape[1], decoded.shape[0]) == reduced_size(size, reduction)
    whole = picture[: size[1] // reduction * reduction, : size[0] // reduction * reduction].astype(float)
    squares = whole.reshape(size[1] // reduction, reduction, size[0] // reduction, reduction, 3).mean(axis=(1, 3))
    inner = decoded[: squares.shape[0], : squares.shape[1]]
    assert np.abs(inner - squares).mean() < 3.0
    assert np.array_equal(reduce_picture(picture, 1), picture)


def test_orientation_note_is_not_applied() -> None:
    exif = (
        b"Exif\x00\x00II*\x00\x08\x00\x00\x00\x01\x00\x12\x01\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00\x00\x00\x00\x00"
    )
    turned = JPEG[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + JPEG[2:]
    assert decode_picture(turned, where="x").shape == (40, 60, 3)


@pytest.mark.parametrize("data", [JPEG, PNG], ids=["jpeg", "png"])
def test_every_truncation_is_refused(data: bytes) -> None:
    for length in range(len(data)):
        with pytest.raises(BadPicture, match=r"cut short|empty|neither|damaged"):
            decode_picture(data[:length], where="x")


@pytest.mark.parametrize("data", [JPEG, PNG], ids=["jpeg", "png"])
def test_every_flipped_bit_is_refused_by_the_hash(data: bytes) -> None:
    digest = hashlib.sha256(data).hexdigest()
    for position in range(0, len(data) * 8, 7):
        flipped = bytearray(data)
        flipped[position // 8] ^= 1 << (position % 8)
        with pytest.raises(BadPicture, match="SHA-256"):
            decode_picture(bytes(flipped), where="x", sha256=digest)


def test_every_flipped_bit_of_a_png_is_refused_without_a_hash() -> None:
    for position in range(0, len(PNG) * 8, 5):
        flipped = bytearray(PNG)
        flipped[position // 8] ^= 1 << (position % 8)
        with pytest.raises(BadPicture):
            decode_picture(bytes(flipped), where="x")


def test_unknown_reduction_is_refused() -> None:
    with pytest.raises(BadPicture, match="cannot be reduced 3 times"):
        decode_picture(JPEG, where="x", reduction=3)  # type: ignore[arg-type]


def test_missing_folder_and_pipe_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.jpg")
    (tmp_path / "folder.jpg").mkdir()
    with pytest.raises(BadPicture, match="No such file"):
        read_picture(tmp_path / "none.jpg")
    with pytest.raises(BadPicture, match="not a regular file"):
        read_picture(tmp_path / "pipe.jpg")
    with pytest.raises(BadPicture, match=r"not a regular file|Is a directory"):
        read_picture(tmp_path / "folder.jpg")


@given(st.binary(max_size=300), st.sampled_from([b"", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"]), st.booleans())
def test_random_bytes_raise_bad_picture_only(body: bytes, start: bytes, with_end: bool) -> None:
    with pytest.raises(BadPicture):
        decode_picture(start + body + (b"\xff\xd9" if with_end else b""), where="x")


@given(st.lists(st.tuples(st.integers(0, len(JPEG) - 1), st.integers(0, 255)), min_size=1, max_size=6))
def test_damaged_jpeg_is_refused_or_has_the_size_of_its_header(changes: list[tuple[int, int]]) -> None:
    damaged = bytearray(JPEG)
    for place, value in changes:
        damaged[place] = value
    size = None
    with contextlib.suppress(BadPicture):
        size = picture_size(bytes(damaged), where="x")
    if size is not None and size[0] * size[1] > 1_000_000:
        return  # legal by its header, and slow to decode
    try:
        decoded = decode_picture(bytes(damaged), where="x")
    except BadPicture:
        return
    assert size == (decoded.shape[1], decoded.shape[0])
