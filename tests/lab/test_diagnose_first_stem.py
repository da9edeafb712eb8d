"""The stem that a free run starts from: what was measured, without its noise."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.arrays import Array
from flora_lab.diagnose.first_stem import first_stem

ALONG = np.linspace(0.0, 1.0, 10)
NOISE_CM = 0.05


def bow(lean_cm: float, bow_cm: float) -> Array:
    return np.stack([lean_cm * ALONG + bow_cm * ALONG**2, 6.5 * ALONG], axis=1)


def measured(stem: Array, seed: int, noise_cm: float = NOISE_CM, rows: int = 20) -> Array:
    points = np.repeat(stem[None], rows, axis=0)
    points[:, 1:] += noise_cm * np.random.default_rng(seed).standard_normal((rows, 9, 2))
    return points


def slope_deg(stem: Array) -> float:
    """Of the lowest piece."""
    return float(np.degrees(np.arctan2(stem[1, 0], stem[1, 1])))


def test_noise_turns_the_foot_much_less() -> None:
    stem = bow(0.5, -0.8)
    tracks = [measured(stem, seed) for seed in range(40)]
    mean = [slope_deg(track[:3].mean(axis=0)) - slope_deg(stem) for track in tracks]
    told = [slope_deg(first_stem(track, 300.0)) - slope_deg(stem) for track in tracks]
    assert np.std(told) < 0.6 * np.std(mean)
    assert abs(np.mean(told)) < 0.5


def test_what_is_measured_exactly_is_taken_as_it_is() -> None:
    hooked = np.stack([0.9 * np.maximum(ALONG - 0.75, 0.0) ** 2 * 16.0, 6.5 * ALONG], axis=1)
    assert first_stem(measured(hooked, 1, 0.0), 300.0) == pytest.approx(hooked, abs=0.01)


def test_a_bend_beyond_the_noise_is_kept() -> None:
    stem = np.stack([0.8 * np.sin(np.pi * ALONG), 6.5 * ALONG], axis=1)
    told = np.stack([first_stem(measured(stem, seed), 300.0) for seed in range(20)])
    assert np.abs(told.mean(axis=0) - stem).max() < 0.05


def test_rows_without_a_stem_do_not_count() -> None:
    stem = bow(0.3, 0.4)
    points = measured(stem, 3)
    points[1], points[7] = np.nan, np.nan
    assert np.isfinite(first_stem(points, 300.0)).all()
    assert first_stem(points, 300.0) == pytest.approx(stem, abs=0.1)
    assert first_stem(points[:1], 300.0) == pytest.approx(points[0], abs=0.05)


def test_the_foot_stays_at_the_anchor() -> None:
    assert first_stem(measured(bow(0.5, -0.8), 2), 300.0)[0] == pytest.approx([0.0, 0.0], abs=1e-9)
