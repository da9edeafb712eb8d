"""What happens by chance: covariances of its parts."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from diagnose_runs import TYPICAL, red_noise, scene_of

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.chance import GAPS, MEASURED, PARTS, covariances, of_swing, sizes_expected
from flora_lab.diagnose.rhythm import Swing
from flora_lab.diagnose.scene import FEATURES, Lanes, Scene
from flora_lab.effects.effect import Change

NAMES = [part.name for part in PARTS]
DRIVES = ("bias", "gradient", "growth", "gain", *MEASURED)
GROUPS = {drive: [i for i, part in enumerate(PARTS) if part.drive == drive] for drive in DRIVES}


@functools.cache
def scene(seed: int = 1) -> Scene:
    return scene_of(seed, traits=TYPICAL, chance={})


@functools.cache
def parts(seed: int = 1) -> Array:
    return covariances(scene(seed), scene(seed).answers(TYPICAL, Change()))


def test_covariances_are_symmetric_and_not_negative() -> None:
    own = parts()
    m = scene().size
    assert own.shape == (len(PARTS), m, m)
    for part, covariance in zip(PARTS, own, strict=True):
        assert np.abs(covariance - covariance.T).max() <= 1e-9 * np.abs(covariance).max(), part.name
        values = np.linalg.eigvalsh(covariance)
        assert values[0] >= -1e-9 * values[-1], part.name
        assert (values[-1] > 0.0) == (part.drive != GAPS), part.name  # this run has none
    assert np.linalg.eigvalsh(np.tensordot(sizes_expected() ** 2, own, axes=1))[0] > 0.0


@pytest.mark.parametrize(
    ("name", "sign"),
    [("wander_per_cm_h", 0.0), ("gradient_per_cm_h", 0.0), ("growth_slow_share", 1.0), ("gain_slow_share", 1.0)],
)
def test_a_part_is_what_many_plants_scatter_by(name: str, sign: float) -> None:
    """Plants of the law are pushed about at random, step by step: covariances of their features, the long way round."""
    part, count, size = PARTS[NAMES.index(name)], 500, 0.5 * PARTS[NAMES.index(name)].typical
    own = scene()
    rng = np.random.default_rng(3)
    courses = sign + size * np.stack([red_noise(rng, own.steps, part.memory_h) for _ in range(count)], axis=1)
    plants = Lanes(np.repeat(TYPICAL[None], count, axis=0), np.zeros((count, 2)), [Change()] * count)
    told = own.of_points(own.points(plants, {part.drive: courses}))
    sampled, wanted = np.cov(told.T), size**2 * parts()[NAMES.index(name)]
    assert np.trace(sampled) == pytest.approx(np.trace(wanted), rel=0.15)
    large = np.diag(wanted) > 0.05 * np.diag(wanted).max()
    assert np.diag(sampled)[large] == pytest.approx(np.diag(wanted)[large], rel=0.4)
    alike = np.sum(sampled * wanted) / np.sqrt(np.sum(sampled**2) * np.sum(wanted**2))
    assert alike > 0.98


@pytest.mark.parametrize("drive", MEASURED)
def test_errors_of_a_measurement_are_of_one_point_or_of_the_whole_stem(drive: str) -> None:
    own, together = scene(), parts()[GROUPS[drive][0]]
    first = own.window == own.window[0]
    here, axis = together[np.ix_(first, first)], np.array([axis for _, axis in FEATURES])
    same = axis[own.feature[first]][:, None] == axis[own.feature[first]][None, :]
    assert not here[~same].any()
    root = np.sqrt(np.diag(here))
    wanted = np.outer(root, root) * (np.eye(len(root)) if drive == "measure" else same)
    assert here == pytest.approx(wanted, abs=1e-12)
    tip, foot = root[own.feature[first] == 0], root[own.feature[first] == len(FEATURES) - 1]
    if drive == "bow":
        assert tip == pytest.approx(0.0)
    else:
        assert tip == pytest.approx(1.0)
    assert 0.0 < foot < 0.5


def test_sizes_are_named_with_their_units() -> None:
    assert list(chance.as_dict(sizes_expected())) == NAMES
    assert len(set(NAMES)) == len(NAMES)
    bending, shares = dict.fromkeys(("bias", "gradient"), "_per_cm_h"), dict.fromkeys(("growth", "gain"), "_share")
    units = bending | shares | dict.fromkeys(MEASURED, "_cm") | {GAPS: "gaps"}
    assert all(part.name.endswith(units[part.drive]) for part in PARTS)


@pytest.mark.parametrize("period_h", [1.2, 1.64, 2.5])
def test_a_swing_is_less_in_hourly_means_the_faster_it_is(period_h: float) -> None:
    own = scene()
    answers = own.answers(TYPICAL, Change())
    covariance = of_swing(own, answers, Swing(period_h, 0.5, 10.0, 50.0, (1.0, 3.0), (0.1, 1.0)))
    assert np.abs(covariance - covariance.T).max() < 1e-12
    assert np.linalg.eigvalsh(covariance)[0] > -1e-9
    tip = own.feature == 0
    slower = of_swing(own, answers, Swing(1.5 * period_h, 0.5, 10.0, 50.0, (1.0, 3.0), (0.1, 1.0)))
    assert np.diag(slower)[tip].mean() > np.diag(covariance)[tip].mean()
    # The foot of the stem hardly moves.
    assert np.diag(covariance)[tip].mean() > 20.0 * np.diag(covariance)[own.feature == 4].mean()
    # a mean over an hour of a swing of 0.5 cm has at most its variance, with some margin for the phase
    assert np.diag(covariance)[tip].mean() < 1.5**2 * 0.5 * 0.5**2
