"""What no law is right in: a little of every effect, that healthy runs seem to show though nothing is wrong with them.

What a law is wrong in looks a little like one effect or another, in all runs alike, and now in this run, now in that.
That is a part of what happens by chance: beside what :mod:`flora_lab.diagnose.chance` knows, each run is pushed along
every effect of the catalogue, by as much on the mean and scattered by as much as makes the reference runs most
probable. All of it is found together, so that what two effects explain alike is counted once. An effect in other runs
is news only beyond that. Kennedy and O'Hagan 2001 call it the discrepancy.

So are forms of the law that are the plants' rather than its own (:mod:`flora_lab.effects.law_forms`).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy.linalg
import scipy.optimize

from flora_common.arrays import Array
from flora_lab.diagnose.hypothesis import STEP_SPREAD, Cause
from flora_lab.diagnose.joint import Base, Found, Ready
from flora_lab.diagnose.scene import START_SD, Lanes, Scene
from flora_lab.effects.catalogue import CATALOGUE
from flora_lab.effects.effect import Change, Effect
from flora_lab.effects.law_forms import FORMS, NEARER

EXPECTED_SHARE: Final = 0.05
"""Size that is expected before any data, in standard deviations of what is plausible for the effect, but for those that
:data:`_EXPECTED` names."""
_EXPECTED: Final[dict[str, float]] = {"camera_scale": 0.05, "camera_roll": 0.8, "camera_drift": 0.8}
"""Coordinates. A law's own lengths, by which alone the scale of a picture can be told, are good to some per cent. Stems
twist and lean out of the picture plane, which no law of the plane knows."""
_FORMS_DIFFER: Final = 0.1
_FORMS_ARE: Final = 0.5
"""The same for forms of the law: by how much they differ between plants, and, since nobody knows them before, how far
they may be from it in all plants."""
_DOUBT: Final = 1.0
"""Standard deviation of the logarithm of that."""
_SURER: Final[dict[str, float]] = dict.fromkeys(("camera_roll", "camera_drift"), 0.4)
"""The same where it is known better: how much plants lean by themselves is told badly by nine runs."""
_LEAST, _MOST = 0.05, 60.0
"""How far sizes may go from what is expected, as factors."""
_LEFT_OUT: Final = (
    # Acts on constants, as those do that are left out for it: see :func:`effects`.
    "time_scale",
    # The same as clock_offset.
    "phototropic_latency",
    # Have no part in hourly means.
    "circumnutation",
    "memory",
)


def strength_of(effect: Effect) -> int:
    """Which parameter says how strong the effect is."""
    return next(i for i, p in enumerate(effect.parameters) if p.none is not None)


@functools.cache
def effects() -> tuple[Effect, ...]:
    """Along which runs are pushed.

    By how much plants differ in their constants is known of the base, and is not counted twice.
    """
    others = (effect for effect in CATALOGUE if effect.name not in _LEFT_OUT and not effect.is_of_constants)
    return (*others, *FORMS)


@functools.cache
def causes() -> tuple[str, ...]:
    """Their names."""
    return tuple(effect.name for effect in effects())


@functools.cache
def columns() -> tuple[int, ...]:
    """How many kinds there are of each cause."""
    return tuple(len(_kinds(effect, strength_of(effect))) for effect in effects())


def expected_sizes() -> Array:
    """Of all before any data, shape (causes,)."""
    spreads = {effect.name: effect.parameters[strength_of(effect)].spread for effect in effects()}
    shares = {name: EXPECTED_SHARE * spread for name, spread in spreads.items()}
    forms = {form.name: _FORMS_DIFFER * spreads[form.name] for form in FORMS}
    return np.array(list((shares | _EXPECTED | forms).values()))


def expected_means() -> Array:
    """Size of the mean over all plants that is expected before any data, shape (causes,)."""
    wider = [_FORMS_ARE / _FORMS_DIFFER if effect in FORMS else 1.0 for effect in effects()]
    return np.asarray(expected_sizes() * wider)


@dataclass(frozen=True, slots=True)
class UsualErrors:
    """How far healthy runs are pushed along each effect.

    Attributes:
        sizes: standard deviations over runs of the strength's coordinate, in the order of :func:`causes`, shape
            (causes,).
        mean: of all runs, by column of :func:`directions`, shape (columns,).
        doubt: of the mean, shape (columns, columns): what happened to so few runs by chance looks like errors of all.
    """

    sizes: Array
    mean: Array
    doubt: Array

    def whole(self) -> Array:
        """How far a run is pushed along each effect, of which nothing else is known, root mean square, (causes,)."""
        squares = self.mean**2 + np.diag(self.doubt)
        on_the_mean = [np.mean(own) for own in np.split(squares, np.cumsum(columns())[:-1])]
        return np.asarray(np.sqrt(self.sizes**2 + np.array(on_the_mean)))

    @property
    def beyond_expected(self) -> float:
        """By how much more the law is wrong than was expected: mean logarithm of its errors' sizes over those."""
        return float(np.mean(np.log(self.sizes / expected_sizes())))

    def of_run(self, scene: Scene, traits: Array, change: Change, together: int = 1) -> tuple[Array, Array]:
        """What they are in a run's features: on the mean, shape (m,), and covariance, shape (m, m).

        Args:
            scene: the run.
            traits: of the plant about which all is linear, without what ``change`` adds, shape (9,).
            change: what causes change already.
            together: number of runs that will be explained together: all are off by what is not known of the mean,
                which does not become less over many.
        """
        along = np.concatenate(directions(scene, traits, change), axis=1)
        scatter = np.diag(np.repeat(self.sizes, columns()) ** 2) + together * self.doubt
        return along @ self.mean, np.asarray(along @ scatter @ along.T)


def directions(scene: Scene, traits: Array, change: Change) -> list[Array]:
    """What a unit of each effect does to a run's features, arrays of shape (m, kinds) in the order of :func:`causes`.

    Kinds are what else there is of an effect, a time of day or a time constant: as which of them the law is wrong is
    not known, so that each has its share.

    Args:
        scene, traits, change: see :meth:`UsualErrors.of_run`.
    """
    changes, widths = [], []
    for effect in effects():
        own = strength_of(effect)
        places = _kinds(effect, own)
        width = STEP_SPREAD * effect.parameters[own].spread
        for at, side in itertools.product(places, (1.0, -1.0)):
            moved = at.copy()
            moved[own] += side * width
            changes.append(_further(change, effect, moved))
            widths.append(side * 2.0 * width * np.sqrt(len(places)))
    shifts = np.stack([one.traits for one in changes])
    told = scene.simulated(Lanes(traits + shifts, np.zeros((len(changes), len(START_SD))), changes))
    slopes = (told / np.array(widths)[:, None]).reshape(-1, 2, told.shape[1]).sum(axis=1).T
    return np.split(slopes, np.cumsum(columns())[:-1], axis=1)


def _kinds(effect: Effect, own: int) -> list[Array]:
    """Coordinates at which there is no effect, for every combination of what else is told of it."""
    told = [
        [p.centre] if i == own or not p.starts else [p.coordinate(value) for value in p.starts]
        for i, p in enumerate(effect.parameters)
    ]
    return [np.array(chosen) for chosen in itertools.product(*told)]


def _further(change: Change, effect: Effect, coordinates: Array) -> Change:
    """A change, and an effect besides."""
    both = replace(change, traits=change.traits.copy(), terms=change.terms.copy())
    Cause(effect).act(both, coordinates)
    return both


def usual_errors(runs: Sequence[Ready], fits: Sequence[Found], base: Base) -> UsualErrors:
    """The errors under which reference runs are most probable.

    Args:
        runs: with what else happens by chance.
        fits: of each run by itself, without a cause: all is linear about it.
        base: that they were fitted with, for single runs.
    """
    told = [_told(own, fit, base) for own, fit in zip(runs, fits, strict=True)]
    expected, means = expected_sizes(), expected_means()
    doubts = np.array([_SURER.get(name, _DOUBT) for name in causes()])

    def improbability(logs: Array) -> float:
        away = logs / doubts
        return 0.5 * float(away @ away) + _of_sizes(told, expected * np.exp(logs), means)[0]

    bounds = [(float(np.log(_LEAST)), float(np.log(_MOST)))] * len(expected)
    found = scipy.optimize.minimize(improbability, np.zeros(len(expected)), method="L-BFGS-B", bounds=bounds)
    sizes = expected * np.exp(found.x)
    # Stems that lean out of the picture do not all lean alike, and look as much longer or shorter.
    nearer = _of_sizes(told, sizes, means)[1][np.repeat(causes(), columns()) == NEARER.name]
    scale = causes().index("camera_scale")
    sizes[scale] = np.hypot(sizes[scale], np.abs(nearer).max())
    _, mean, information = _of_sizes(told, sizes, means)
    return UsualErrors(sizes, mean, np.linalg.inv(information))


def _of_sizes(told: Sequence[tuple[Array, Array]], sizes: Array, means: Array) -> tuple[float, Array, Array]:
    """How improbable runs are if errors scatter so much, the most probable mean of the errors, shape (columns,), and
    how precisely that is known: the inverse of its covariance, shape (columns, columns)."""
    size = np.repeat(sizes, columns())
    # Before any data the mean is as wide as what is expected of it, and as the scatter.
    before = np.diag(1.0 / (np.repeat(means, columns()) ** 2 + size**2))
    information, pull, total = before.copy(), np.zeros(len(size)), 0.0
    for own, drawn in told:
        whole = np.eye(len(size)) + size[:, None] * own * size[None, :]
        root = scipy.linalg.cholesky(whole, lower=True, check_finite=False)
        reached = scipy.linalg.solve_triangular(
            root, size[:, None] * np.column_stack([own, drawn]), lower=True, check_finite=False
        )
        total += float(np.log(np.diag(root)).sum() - 0.5 * reached[:, -1] @ reached[:, -1])
        information += own - reached[:, :-1].T @ reached[:, :-1]
        pull += drawn - reached[:, :-1].T @ reached[:, -1]
    mean = np.linalg.solve(information, pull)
    total += 0.5 * float(np.linalg.slogdet(information)[1] - np.linalg.slogdet(before)[1] - pull @ mean)
    return total, mean, information


def _told(own: Ready, fit: Found, base: Base) -> tuple[Array, Array]:
    """What a run tells of pushes along all effects, if its plant is any: information (k, k), and pull (k,)."""
    residual, by_plant = fit.residuals[0], fit.jacobians[0]
    away = np.concatenate([fit.traits[0] - base.mean, fit.start[0]])
    prior = scipy.linalg.block_diag(base.spread, np.diag(START_SD**2))
    along = np.concatenate(directions(own.scene, fit.traits[0], Change()), axis=1)
    white = own.white(np.concatenate([along, np.zeros((len(residual) - len(along), along.shape[1]))]))
    whole = np.eye(len(residual)) + by_plant @ prior @ by_plant.T
    root = scipy.linalg.cholesky(whole, lower=True, check_finite=False)
    pushed, rest = (
        scipy.linalg.solve_triangular(root, values, lower=True, check_finite=False)
        for values in (white, residual + by_plant @ away)
    )
    return pushed.T @ pushed, pushed.T @ rest
