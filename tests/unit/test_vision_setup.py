"""L and H: per-pixel limits of the green channel over the empty setup."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.errors import BadInput, BadPicture
from flora_common.vision import setup
from flora_common.vision.setup import SetupMatrices


def plain(green: int, size: tuple[int, int] = (6, 8)) -> np.ndarray:
    picture = np.zeros((*size, 3), dtype=np.uint8)
    picture[:, :, 0], picture[:, :, 1], picture[:, :, 2] = 250, green, 5
    return picture


def test_l_and_h_are_the_limits_of_green_alone() -> None:
    rng = np.random.default_rng(5)
    pictures = rng.integers(0, 256, (7, 6, 8, 3), dtype=np.uint8)
    made = setup.from_pictures(pictures)
    for row in range(6):
        for column in range(8):
            values = [int(m[row, column, 1]) / 255 for m in pictures]
            assert made.L[row, column] == pytest.approx(min(values), abs=1e-7)
            assert made.H[row, column] == pytest.approx(max(values), abs=1e-7)
    assert (made.made_by, made.pictures, made.size_px) == ("background", 7, (8, 6))


def test_no_picture_and_other_size_are_refused() -> None:
    with pytest.raises(BadPicture, match="no background pictures"):
        setup.from_pictures([])
    with pytest.raises(BadPicture, match="background picture 2: 4x4 px, the first has 8x6"):
        setup.from_pictures([plain(3), plain(3, (4, 4))])


def test_hash_changes_with_content_and_reduction(tmp_path: Path) -> None:
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    for path, green in zip(paths, (10, 90), strict=True):
        cv2.imwrite(str(path), plain(green, (16, 16)))
    made = setup.from_files(paths, reduction=2, expected_size=(16, 16))
    assert made.size_px == (8, 8)
    assert made.sources_sha256 == setup.hash_of_files(paths, reduction=2)
    assert made.sources_sha256 != setup.hash_of_files(paths, reduction=4)
    cv2.imwrite(str(paths[1]), plain(91, (16, 16)))
    assert made.sources_sha256 != setup.hash_of_files(paths, reduction=2)
    with pytest.raises(BadPicture, match="expected 20x16"):
        setup.from_files(paths, reduction=2, expected_size=(20, 16))


def test_saved_matrices_come_back(tmp_path: Path) -> None:
    made = setup.from_pictures([plain(10), plain(60)], sources_sha256="ab" * 32)
    made.save(tmp_path / "setup.npz")
    again = SetupMatrices.load(tmp_path / "setup.npz")
    assert np.array_equal(again.L, made.L)
    assert np.array_equal(again.H, made.H)
    assert (again.made_by, again.pictures, again.sources_sha256) == ("background", 2, "ab" * 32)


def test_bad_stored_matrices_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "setup.npz"
    good = setup.from_pictures([plain(10), plain(60)])
    good.save(path)
    whole = path.read_bytes()
    for data in (b"", b"text", whole[:-7], whole[:60]):
        path.write_bytes(data)
        with pytest.raises(BadInput, match="not a file of setup matrices"):
            SetupMatrices.load(path)
    path.unlink()
    with pytest.raises(BadInput, match="cannot be read"):
        SetupMatrices.load(path)
    for low, high in (
        (good.H, good.L),
        (good.L * np.nan, good.H),
        (good.L, good.H[:3]),
        (good.L.astype(float), good.H),
    ):
        SetupMatrices(low, high).save(path)  # type: ignore[arg-type]
        with pytest.raises(BadInput, match=r"needs 0 <= L <= H <= 1|two float32 matrices"):
            SetupMatrices.load(path)
    SetupMatrices(good.L, good.H, "elves").save(path)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="made by `elves`"):
        SetupMatrices.load(path)


def test_a_passing_stem_is_forgotten_and_a_standing_one_is_not() -> None:
    frames = []
    for i in range(20):
        frame = plain(30, (10, 40))
        frame[:, 2 * i : 2 * i + 2, 1] = 200  # sweeps over every column once
        frame[8:, 18:22, 1] = 180  # never moves
        frames.append(frame)
    learnt = setup.learn_from_frames(frames)
    assert learnt.made_by == "frames"
    assert np.allclose(learnt.H[:8] * 255, 30)
    assert np.allclose(learnt.L[8:, 18:22] * 255, 180)


def test_learning_for_a_dark_plant_uses_the_bright_end() -> None:
    frames = []
    for i in range(20):
        frame = plain(200, (10, 40))
        frame[:, i : i + 15, 1] = 40
        frames.append(frame)
    learnt = setup.learn_from_frames(frames, percentiles=(90.0, 95.0))
    assert np.allclose(learnt.L * 255, 200)
    with pytest.raises(ValueError, match="must rise"):
        setup.learn_from_frames(frames, percentiles=(60.0, 40.0))


def test_too_few_or_unequal_frames_are_refused() -> None:
    with pytest.raises(BadPicture, match="4 frames are too few"):
        setup.learn_from_frames([plain(3)] * 4)
    with pytest.raises(BadPicture, match="frame 5: 4x4 px"):
        setup.learn_from_frames([plain(3)] * 5 + [plain(3, (4, 4))])
