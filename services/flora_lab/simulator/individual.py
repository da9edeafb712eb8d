"""What kind of plant it was that left a track: its traits, by maximum a posteriori probability.

The residuals of a free run are whitened with the covariance that noise would give them (see
:mod:`flora_lab.simulator.drives`), so that a slow swing counts once and not once per photograph. Derivatives are
central differences, all of them side by side in one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.geometry import polyline_length
from flora_common.shapes import STEM_POINTS
from flora_lab.levenberg_marquardt import descended
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.law import Law, standing
from flora_lab.simulator.measured import MeasuredRun

FEATURES: Final = ((9, 0), (9, 1), (6, 0), (3, 0))
"""Point and axis of what is compared. Heights of the points between follow from the tip's."""
EVERY_H: Final = 1.0
KNOT_H: Final = {"bias": 1.0 / 3.0, "growth": 1.0}
"""How finely noise is resolved in time; circumnutation has a period of 1.2 to 2.6 h."""
_PUSH: Final = {"bias": 0.02, "growth": 0.2}
_DELTA_SD: Final = 0.2
"""Half the distance of central differences, in standard deviations of the prior."""
_ITERATIONS: Final = 12
_GAINED: Final = 1e-3
"""A step by which the misfit falls no more is the last."""
RANGE_SD: Final = 6.0


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a plant before it is seen: its traits are normal.

    Attributes:
        mean: shape (traits,).
        covariance: shape (traits, traits).
    """

    mean: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class Fitted:
    """A plant's traits.

    Attributes:
        traits: shape (traits,).
        covariance: of them, shape (traits, traits), by Laplace's approximation.
        information: what the track alone tells of them, shape (traits, traits): the inverse of a covariance.
        residual: measured minus simulated features, cm, shape (m,).
        jacobian: of the features, shape (m, traits).
    """

    traits: Array
    covariance: Array
    information: Array
    residual: Array
    jacobian: Array


@dataclass(frozen=True, slots=True)
class _Tried:
    """A plant that is tried.

    Attributes:
        traits: shape (traits,).
        residual: measured minus simulated features, cm, shape (m,).
        jacobian: of the features, shape (m, traits).
        misfit: half the sum of squares, with the prior's.
    """

    traits: Array
    residual: Array
    jacobian: Array
    misfit: float


@dataclass(frozen=True, slots=True)
class Responses:
    """How the features answer a push at each knot, about one plant.

    Attributes:
        bias, growth: shape (m, knots), per unit of the drive.
        bias_h, growth_h: middles of the knots, shape (knots,).
        length_cm: of the stem in the middle of each bias knot, shape (knots,).
    """

    bias: Array
    growth: Array
    bias_h: Array
    growth_h: Array
    length_cm: Array

    def of(self, which: Array) -> Responses:
        """Those of some of the features."""
        return replace(self, bias=self.bias[which], growth=self.growth[which])

    def covariance(self, noise: DriveNoise) -> Array:
        """Of the features, shape (m, m), without measuring error."""
        out = self.bias @ noise.bias_covariance(self.bias_h, self.length_cm) @ self.bias.T
        return np.asarray(out + self.growth @ noise.growth_covariance(self.growth_h) @ self.growth.T)


def covariance_of(answer: Responses, noise: DriveNoise) -> Array:
    """Of a run's features: by chance, and by measuring."""
    chance = answer.covariance(noise)
    return np.asarray(chance + noise.measure_cm**2 * np.eye(len(chance)))


class Observed:
    """One run, ready to be compared with what a law makes of its first stem.

    Args:
        run: what was measured.
        law: what makes stems bend and grow.
    """

    def __init__(self, run: MeasuredRun, law: Law) -> None:
        self.law = law
        self.step_h = run.step_s / 3600.0
        self.every = max(1, round(EVERY_H / self.step_h))
        at = np.arange(self.every, len(run), self.every)
        if not len(at):  # a history shorter than an hour is judged by its last stem
            self.every, at = len(run) - 1, np.array([len(run) - 1])
        self.steps = int(at[-1])
        self.light = run.light[: self.steps]
        self._first = standing(law, run.points_cm[:1])
        told = np.stack([run.points_cm[at, point, axis] for point, axis in FEATURES], axis=1).ravel()
        self.is_told = np.isfinite(told)
        self.row = np.repeat(np.arange(len(at)), len(FEATURES))[self.is_told]
        self.features = told[self.is_told]

    def points(self, traits: Array, bias: Array | None = None, growth: Array | None = None) -> Array:
        """Stems at the rows compared, shape (rows, lanes, 10, 2).

        Args:
            traits: shape (lanes, traits).
            bias, growth: drives, shape (steps, lanes); none and 1 where missing.
        """
        lanes = len(traits)
        out = np.empty((self.steps // self.every, lanes, STEM_POINTS, 2))
        self.law.advance(
            self._first.repeated(lanes),
            traits,
            np.repeat(self.light[:, None], lanes, axis=1),
            np.zeros((self.steps, lanes)) if bias is None else bias,
            np.ones((self.steps, lanes)) if growth is None else growth,
            self.step_h,
            self.every,
            out,
        )
        return out

    def of_points(self, points: Array) -> Array:
        """The features of stems (rows, lanes, 10, 2) that were measured, shape (lanes, m)."""
        all_of_them = np.stack([points[:, :, point, axis] for point, axis in FEATURES], axis=2)
        return np.asarray(all_of_them.transpose(1, 0, 2).reshape(points.shape[1], -1)[:, self.is_told])

    def simulated(self, traits: Array) -> Array:
        """Features without noise, shape (lanes, m)."""
        return self.of_points(self.points(traits))

    def responses(self, traits: Array) -> Responses:
        """How this run would answer noise, for a plant with these traits."""
        found: dict[str, tuple[Array, Array]] = {}
        still = self.points(traits[None])
        base = self.of_points(still)[0]
        for name in ("bias", "growth"):
            per_knot = max(1, round(KNOT_H[name] / self.step_h))
            knots = -(-self.steps // per_knot)
            push = np.zeros((self.steps, knots))
            push[np.arange(self.steps), np.arange(self.steps) // per_knot] = _PUSH[name]
            lanes = np.repeat(traits[None], knots, axis=0)
            points = self.points(lanes, bias=push) if name == "bias" else self.points(lanes, growth=1.0 + push)
            middle_h = (np.arange(knots) + 0.5) * per_knot * self.step_h
            found[name] = ((self.of_points(points) - base).T / _PUSH[name], middle_h)
        lines = polyline_length(still[:, 0])
        row_h = (np.arange(len(lines)) + 1) * self.every * self.step_h
        length_cm = np.interp(found["bias"][1], row_h, lines)
        return Responses(found["bias"][0], found["growth"][0], found["bias"][1], found["growth"][1], length_cm)


def fit(seen: Observed, prior: Prior, covariance: Array, start: Array | None = None) -> Fitted:
    """The most probable traits of a plant.

    Args:
        seen: its track.
        prior: of its traits.
        covariance: of the features, with measuring error, shape (m, m).
        start: traits to begin with; the prior's mean where missing.

    Returns:
        The fit. Traits stay within :data:`RANGE_SD` standard deviations of the prior: beyond it nothing is a plant.
    """
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    prior_root = np.linalg.inv(np.linalg.cholesky(prior.covariance))
    spread = np.sqrt(np.diag(prior.covariance))
    low, high = prior.mean - RANGE_SD * spread, prior.mean + RANGE_SD * spread

    def about(traits: Array) -> _Tried:
        features, jacobian = linearised(seen, traits, spread)
        residual = seen.features - features
        return _Tried(traits, residual, jacobian, _cost(residual, traits - prior.mean, whiten, prior_root))

    def equations(at: _Tried) -> tuple[Array, Array]:
        white = whiten @ at.jacobian
        pull = white.T @ (whiten @ at.residual) - prior_root.T @ (prior_root @ (at.traits - prior.mean))
        return white.T @ white + prior_root.T @ prior_root, pull

    def better(at: _Tried, step: Array) -> _Tried | None:
        new = about(np.clip(at.traits + step, low, high))
        return new if new.misfit < at.misfit else None

    found = descended(
        about(prior.mean if start is None else start),
        equations,
        better,
        steps=_ITERATIONS,
        damping=1e-2,
        most_damping=1e4,
        gained=_GAINED,
    )
    white = whiten @ found.jacobian
    information = white.T @ white
    posterior = np.linalg.inv(information + prior_root.T @ prior_root)
    return Fitted(found.traits, posterior, information, found.residual, found.jacobian)


def linearised(seen: Observed, at: Array, spread: Array) -> tuple[Array, Array]:
    """Features (m,) of a plant and their derivatives (m, traits) with respect to its traits.

    Args:
        seen: the run.
        at: traits, shape (traits,).
        spread: how much plants differ in them, shape (traits,): derivatives are differences over a share of it.
    """
    count = len(at)
    away = np.diag(_DELTA_SD * spread)
    told = seen.simulated(at + np.concatenate([np.zeros((1, count)), away, -away]))
    return told[0], (told[1 : count + 1] - told[count + 1 :]).T / (2.0 * _DELTA_SD * spread)


def _cost(residual: Array, away: Array, whiten: Array, prior_root: Array) -> float:
    return float(0.5 * (np.sum((whiten @ residual) ** 2) + np.sum((prior_root @ away) ** 2)))
