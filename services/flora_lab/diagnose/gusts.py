"""Gusts: no wind is steady, and a stem that it bends elastically follows it within minutes.

A draught in its elastic forms (``WIND`` of :mod:`flora_lab.simulator.terms`) explains the mean push. That it blows
harder and weaker by turns is left over then, and would be told as something without a name, or as a swing of the tip.
A gust moves each place of the stem by its share of how far the mean wind holds that place aside: Gaussian processes of
known shapes in time. How gusty a wind is differs, from a fan's to an open window's: sizes are tried, and by how much
one makes the runs more probable speaks for the wind, whose mean push plants' own lean may hide.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg

from flora_common.arrays import Array
from flora_lab.diagnose import chance
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.rhythm import ALONE, Spectrum
from flora_lab.diagnose.scene import START_SD, WINDOW_H, Answers, Lanes, Scene
from flora_lab.simulator.terms import SOFTNESS_CM, WIND

MEMORIES_H: Final = (0.2, 1.0, 5.0)
"""Correlation times."""
SHARES: Final = (0.0, 0.05, 0.15)
"""Of the mean wind, that may come and go with each of them."""
_MORE: Final = (0.0, 1.0, 3.0, 9.0)
"""So many times as much as is usual a run may wander besides, wind or none."""
_BY_THEMSELVES: Final = 10.0
"""Nats that plants may show which sway by themselves; healthy ones have had 8 (docs/results/discovery-history.md)."""
_QUICK: Final = 5.5
"""Nats that gusts of an hour or less must come to beside such as last for hours: of nine drawn winds those with slow
gusts alone have come to 5.1 at most, and those with quick ones to 6.3 at least."""
_MUCH: Final = 30.0
"""Nats of one run from which on it is asked whether gusts come all the time."""
_PARTS, _LEFT = 12, 0.4
"""Without any two of so many parts of a run in a row at least that share of its nats must be left: who knocks at a pot
once, or bends a stem, makes no wind."""
_TRIED: Final = tuple(itertools.product(SHARES, repeat=len(MEMORIES_H)))
_SLOW: Final = [number for number, shares in enumerate(_TRIED) if not any(shares[:-1])]
"""No gusts, or such as last for hours alone."""
LOOKED: Final = math.log(len(_TRIED))
"""The price of having looked at so many, in nats."""


@dataclass(frozen=True, slots=True)
class Gusts:
    """How gusty a wind is.

    Attributes:
        shares: of the mean wind, that come and go with each of :data:`MEMORIES_H`.
        evidence: nats that they add to those for the wind, after what looking cost; none where they may as well be
            what stems sway by themselves.
    """

    shares: tuple[float, ...] = (0.0,) * len(MEMORIES_H)
    evidence: float = 0.0


CALM: Final = Gusts()


def best_gusts(joint: Joint, scenes: Sequence[Scene], answers: Sequence[Answers], found: Found) -> Gusts:
    """The gusts that make some runs most probable; :data:`CALM` where none do, or no wind blows.

    A wind that blows on all runs comes and goes in all: what one shows more than any other is taken for no more than
    what that one shows, for any plant may waver by itself. Nor does a wind show by what lasts for hours alone: a law
    that is a little wrong leaves as much, so the quicker gusts must be worth :data:`_QUICK` by themselves.
    And what a single stretch of a run shows does not count where little is left without it.

    Args:
        joint: the runs, whitened for what happens by chance without gusts.
        scenes, answers: the same runs, and how they answer chance.
        found: their explanation, fitted in ``joint``.
    """
    both = zip(scenes, answers, strict=True)
    by_run = [_nats(joint, scene, own, found, run) for run, (scene, own) in enumerate(both)]
    borne_out = np.array([_borne_out(each) for each in np.transpose(by_run)])
    best = int(np.argmax(borne_out))
    evidence = float(borne_out[best]) - LOOKED - _BY_THEMSELVES
    is_told = borne_out[best] - borne_out[_SLOW].max() > _QUICK
    return Gusts(_TRIED[best], max(evidence, 0.0) if is_told else 0.0)


def _borne_out(each: Array) -> float:
    """Nats of all runs, shape (runs,), of which the best one counts as much as the next one at most."""
    if len(each) == 1:
        return float(each[0]) - ALONE
    return float(np.minimum(each, np.sort(each)[-2]).sum())


def _nats(joint: Joint, scene: Scene, answers: Answers, found: Found, run: int) -> Array:
    """By how much each of :data:`_TRIED` makes the hourly means of a run more probable, shape (tried,).

    All is linear about the explanation, whose plant is any.
    """
    away = _held_aside_cm(scene, found, run, None)
    if away is None:
        return np.zeros(len(_TRIED))
    own = joint.runs[run]
    of_plant = np.concatenate([found.traits[run] - joint.base.mean, found.start[run]])
    slopes = found.jacobians[run][:, : len(of_plant)]
    prior = scipy.linalg.block_diag(joint.base.spread + joint.base.doubt, np.diag(START_SD**2))
    residual = found.residuals[run] + slopes @ of_plant
    root = scipy.linalg.cholesky(np.eye(len(residual)) + slopes @ prior @ slopes.T, lower=True)

    def white(values: Array) -> Array:
        return np.asarray(scipy.linalg.solve_triangular(root, values, lower=True))

    def seen(part: Array) -> Array:
        padded = np.pad(part, (0, len(residual) - len(part)))
        return white(white(own.white(own.white(padded).T)).T)

    parts = np.stack([seen(part) for part in _of_means_of_each(scene, away)])
    more = seen(chance.of_wander(scene, answers, joint.base.sizes))
    rest = white(residual)

    def gusty(shares: tuple[float, ...]) -> Array:
        return np.asarray(np.eye(len(rest)) + np.einsum("i,ijk->jk", np.square(shares), parts))

    out = np.array([_likeliest(rest, gusty(shares), more) for shares in _TRIED])
    out -= out[_TRIED.index(CALM.shares)]
    best = int(np.argmax(out))
    if out[best] < _MUCH:
        return out
    left = _left_elsewhere(rest, gusty(_TRIED[best]), more)
    return out if left > _LEFT * out[best] else out * (max(left, 0.0) / out[best])


def _left_elsewhere(rest: Array, gusty: Array, more: Array) -> float:
    """Nats for gusts without that stretch of a run, two of :data:`_PARTS` in a row, in which most of them are."""
    whole, calm = np.arange(len(rest)), np.eye(len(rest))
    left = []
    for first, second in itertools.pairwise(np.array_split(whole, _PARTS)):
        kept = np.setdiff1d(whole, np.concatenate([first, second]))
        some = np.ix_(kept, kept)
        with_gusts, without = (_likeliest(rest[kept], own[some], more[some]) for own in (gusty, calm))
        left.append(with_gusts - without)
    return min(left)


def _likeliest(rest: Array, gusty: Array, more: Array) -> float:
    """The probability of what is left, see :func:`_probability`, where the run wanders as suits it best."""
    return max(_probability(rest, gusty + times * more) for times in _MORE)


def covariance(scene: Scene, found: Found, run: int, gusts: Gusts) -> Array:
    """What gusts do to the hourly means of a run, shape (m, m); nothing where no wind blows.

    Args:
        scene: the run.
        found: its explanation.
        run: which of those explained it is.
        gusts: of the wind.
    """
    away = None if gusts == CALM else _held_aside_cm(scene, found, run, None)
    if away is None:
        return np.zeros((scene.size, scene.size))
    return np.asarray(np.einsum("i,ijk->jk", np.square(gusts.shares), _of_means_of_each(scene, away)))


def power(scene: Scene, found: Found, run: int, seen: Spectrum, gusts: Gusts) -> Array:
    """What gusts add to the spectrum of a tip, cm^2 h, at the frequencies of ``seen``, shape (n,)."""
    away = None if gusts == CALM else _held_aside_cm(scene, found, run, 1)
    if away is None:
        return np.zeros(len(seen.per_hour))
    memory_h = np.array(MEMORIES_H)[:, None]
    of_one = 2.0 * memory_h / (1.0 + (2.0 * np.pi * seen.per_hour * memory_h) ** 2)
    return np.asarray(np.mean(away[:, -1, 0] ** 2) * np.square(gusts.shares) @ of_one)


def _of_means_of_each(scene: Scene, away_cm: Array) -> Array:
    """Covariance of hourly means of a run where each of the gusts is as large as the wind, shape (gusts, m, m).

    Args:
        scene: the run.
        away_cm: how far the wind holds each point aside, shape (rows told, 10, 2).
    """
    moved = scene.of_points(away_cm[:, None])[0]
    at_h = scene.time_h[scene.window]
    lag_h = np.abs(at_h[:, None] - at_h[None, :])
    return np.stack([moved[:, None] * moved[None, :] * _of_means(lag_h, memory_h) for memory_h in MEMORIES_H])


def _probability(rest: Array, covariance: Array) -> float:
    """Its logarithm, up to a constant, of what is left, shape (m,)."""
    root = scipy.linalg.cholesky(covariance, lower=True)
    reached = scipy.linalg.solve_triangular(root, rest, lower=True)
    return -0.5 * float(reached @ reached) - float(np.log(np.diag(root)).sum())


def _of_means(lag_h: Array, memory_h: float) -> Array:
    """How alike the means over :data:`WINDOW_H` of what forgets in ``memory_h`` are, of unit variance itself."""
    whole = WINDOW_H / memory_h
    apart = np.exp(-lag_h / memory_h) * 2.0 * (np.cosh(whole) - 1.0) / whole**2
    same = 2.0 * (whole - 1.0 + np.exp(-whole)) / whole**2
    return np.asarray(np.where(lag_h < 0.5 * WINDOW_H, same, apart))


def _held_aside_cm(scene: Scene, found: Found, run: int, every: int | None) -> Array | None:
    """How far the wind holds each point of the stem aside, cm, shape (rows told, 10, 2); None where none blows."""
    change = found.hypothesis.change(found.coordinates)
    terms = scene.terms_with(change)
    if terms[WIND] == 0.0:
        return None
    lanes = Lanes(found.traits[run][None] + change.traits, found.start[run][None], [change])
    return held_aside_cm(scene.points(lanes, every=every)[:, 0], float(terms[WIND]), float(terms[SOFTNESS_CM]))


def held_aside_cm(stems_cm: Array, wind: float, softness_cm: float) -> Array:
    """How far a wind holds each point of some stems aside, cm, of the shape of ``stems_cm``.

    By the moments of :mod:`flora_lab.simulator.sag`, about the stem as it stands in the wind.

    Args:
        stems_cm: from foot to tip, shape (stems, points, 2).
        wind, softness_cm: ``WIND`` and ``SOFTNESS_CM`` of :mod:`flora_lab.simulator.terms`.
    """
    pieces = np.linalg.norm(np.diff(stems_cm, axis=1), axis=2)
    middles = 0.5 * (stems_cm[:, 1:] + stems_cm[:, :-1])
    piece, point = np.arange(pieces.shape[1]), np.arange(stems_cm.shape[1])
    higher_cm = middles[:, None, :, 1] - middles[:, :, None, 1]
    moment = np.sum(higher_cm * pieces[:, None, :] * (piece[None, :] > piece[:, None]), axis=2)
    to_tip_cm = np.cumsum(pieces[:, ::-1], axis=1)[:, ::-1] - 0.5 * pieces
    bend = wind * np.exp(-to_tip_cm / softness_cm) * pieces * moment
    arm_cm = (stems_cm[:, None] - middles[:, :, None]) * (point[None, :] > piece[:, None])[None, :, :, None]
    turned = np.stack([arm_cm[..., 1], -arm_cm[..., 0]], axis=-1)
    return np.asarray(np.sum(bend[:, :, None, None] * turned, axis=1))
