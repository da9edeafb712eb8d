"""What a simulator, its chance and the hours before let expect of a plant, hour by hour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np
import scipy.linalg

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Base, Found, Joint, Ready, ready
from flora_lab.diagnose.scene import FEATURES, START_SD, Answers, Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.serve import evidence, pushes

WATCHED_H: Final = 24
"""Hours after which the simulator knows the plant, and not the typical one alone."""
AGAIN_H: Final = 6
"""Hours for which the plant's constants, about which all is taken to be linear, are good."""
BELIEVED: Final = 0.95
_TIP: Final = (FEATURES.index((9, 0)), FEATURES.index((9, 1)))
_MM: Final = 10.0
_FIRST_FIT, _LATER_FITS = 12, 4
_ANGLES: Final = np.linspace(0.0, np.pi, 181)[:-1]


class Hour(msgspec.Struct, frozen=True):
    """One hour of a run beside the simulator.

    Attributes:
        hour: that has ended, from 1.
        squares: sum of the squares of what it brought beyond what was to be expected, in units of chance.
        count: how many numbers that are; 0 where nothing was measured.
        bets: see :func:`flora_lab.serve.evidence.log_worth`.
        is_watched: whether the simulated plant had been watched for a day; else it is the typical one.
        error_mm: measured minus expected tip, to the right and upwards, the hour's mean; None where there was none.
        expected_mm: distance that :data:`BELIEVED` of all plants that the simulator is right about stay within.
    """

    hour: int
    squares: float
    count: int
    bets: tuple[float, ...]
    is_watched: bool
    error_mm: tuple[float, float] | None
    expected_mm: float


@dataclass(frozen=True, slots=True)
class Usual:
    """What is known of plants that are as the simulator says.

    Attributes:
        base: of their constants and of chance, for runs looked at one by one.
        mean_square: of innovations, at most.
        pushes: how much they seem to be pushed, see :func:`flora_lab.serve.pushes.usual_sizes`.
    """

    base: Base
    mean_square: float
    pushes: list[Array]


class Recognised(msgspec.Struct, frozen=True):
    """The constants of a plant, as far as they are known.

    Attributes:
        traits: nine.
        start: tilt and bow of the first stem.
        hours: after which they were found; 0 for the typical plant.
    """

    traits: tuple[float, ...]
    start: tuple[float, ...]
    hours: int


def unknown(base: Base) -> Recognised:
    """Of a plant of which nothing is known."""
    return Recognised(tuple(map(float, base.mean)), (0.0,) * len(START_SD), 0)


def hours_of(scene: Scene, usual: Usual, plant: Recognised, hours: range) -> list[Hour]:
    """Some hours of a run, each beside what those before it let expect.

    What comes after an hour has no part in what is said of it, but for the first stem, which is the mean of three.

    Args:
        scene: all of the run up to now.
        usual: what is known of plants.
        plant: its constants, about which all is taken to be linear.
        hours: numbers of hours, from 0.
    """
    return _hours(*_ready(scene, usual.base, plant), usual, plant, hours)


def recognised(scene: Scene, base: Base, before: Recognised, hours: int) -> Recognised:
    """The most probable constants of a plant after so many hours.

    Args:
        scene: the run.
        base: what is known of plants, for runs looked at one by one.
        before: constants to begin with.
        hours: a number; what came later counts nothing.
    """
    return _recognised(_ready(scene, base, before)[0], base, before, hours)


def is_to_be_recognised(plant: Recognised, hours: int) -> bool:
    """Whether so many hours tell enough more of a plant than was known."""
    return hours > 0 and (plant.hours == 0 or hours - plant.hours >= AGAIN_H)


def _ready(scene: Scene, base: Base, plant: Recognised) -> tuple[Ready, Answers]:
    answers = scene.answers(np.array(plant.traits), Change())
    return ready(scene, base, chance.covariances(scene, answers), together=0), answers


def _recognised(own: Ready, base: Base, before: Recognised, hours: int) -> Recognised:
    root = own.inverse_root.copy()
    root[: own.scene.size][own.scene.window >= hours] = 0.0
    joint = Joint([replace(own, inverse_root=root)], base)
    start = _found(before)
    fit = joint.fit(start, _LATER_FITS if before.hours else _FIRST_FIT)
    return Recognised(tuple(map(float, fit.traits[0])), tuple(map(float, fit.start[0])), hours)


def _found(plant: Recognised) -> Found:
    return Found(Hypothesis(), np.zeros(0), np.array([plant.traits]), np.array([plant.start]))


def _hours(own: Ready, answers: Answers, usual: Usual, plant: Recognised, hours: range) -> list[Hour]:
    scene, base = own.scene, usual.base
    m = scene.size
    fit = _found(plant)
    told, slopes = Joint([own], base).features_of(fit, 0)
    # About this plant all is linear, so that the typical plant and how plants differ can be told there too.
    away = np.concatenate([base.mean - np.array(plant.traits), -np.array(plant.start)])
    surprise = scene.features - told[:m] - slopes[:m] @ away
    prior = scipy.linalg.block_diag(base.spread, np.diag(START_SD**2))
    root_of_chance = np.linalg.inv(own.inverse_root[:m, :m])
    by_plant = own.inverse_root[:m, :m] @ slopes[:m]
    units = pushes.of_run(scene, answers, told[:m])
    by_push = own.inverse_root[:m, :m] @ np.concatenate(
        [unit * size for unit, size in zip(units, usual.pushes, strict=True)], axis=1
    )
    whole = np.eye(m) + by_plant @ prior @ by_plant.T + by_push @ by_push.T
    root = root_of_chance @ scipy.linalg.cholesky(whole, lower=True, check_finite=False)
    white = scipy.linalg.solve_triangular(root, surprise, lower=True, check_finite=False)
    typical = scene.simulated(Lanes(base.mean[None], np.zeros((1, len(START_SD))), [Change()]))[0]
    most = usual.mean_square
    on_pushes = [
        pushes.won(root, white, push.size * unit, most) for unit, push in zip(units, pushes.PUSHES, strict=True)
    ]
    # A plant that departed on its first day was never known as it should be.
    watched = plant.hours >= WATCHED_H
    found = []
    for hour in hours:
        rows = np.flatnonzero(scene.window == hour)
        squares, count = float(np.sum(white[rows] ** 2)), len(rows)
        bets = (*map(float, evidence.wider(squares, count, most)), *(float(on[rows].sum()) for on in on_pushes))
        error_mm, expected_mm = None, 0.0
        if count:
            error_mm, expected_mm = _tip(scene, hour, root, white, surprise, None if watched else typical)
        found.append(Hour(hour + 1, squares, count, bets, watched, error_mm, expected_mm))
    return found


def _tip(
    scene: Scene, hour: int, root: Array, white: Array, surprise: Array, typical: Array | None
) -> tuple[tuple[float, float], float]:
    """Measured minus expected tip, mm, and how far it may be."""
    tip = np.flatnonzero(scene.window == hour)[list(_TIP)]
    if typical is not None:
        known, error = 0, scene.features[tip] - typical[tip]
    else:  # what the first day tells of the plant, and of what it was up to then
        known = int(np.searchsorted(scene.window, WATCHED_H))
        error = surprise[tip] - root[tip, :known] @ white[:known]
    left = root[tip, known:]
    return (float(_MM * error[0]), float(_MM * error[1])), _MM * within(left @ left.T, BELIEVED)


def within(covariance: Array, share: float) -> float:
    """The distance from the middle within which this share of a normal distribution of shape (2, 2) lies."""
    values = np.maximum(np.linalg.eigvalsh(covariance), 1e-12)
    reach = values[0] * np.cos(_ANGLES) ** 2 + values[1] * np.sin(_ANGLES) ** 2
    low, high = 0.0, 10.0 * float(np.sqrt(values[1]))
    for _ in range(50):
        middle = 0.5 * (low + high)
        if 1.0 - float(np.mean(np.exp(-0.5 * middle**2 / reach))) < share:
            low = middle
        else:
            high = middle
    return high
