"""Several runs under one hypothesis: every plant's constants and the effects' parameters, most probable together.

Plants are individuals about a typical one, which is itself known only as well as the reference tells. Errors of a free
run are whitened with what happens by chance (:mod:`flora_lab.diagnose.chance`). Levenberg-Marquardt; evidence after
Laplace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import scipy.linalg

from flora_common.arrays import Array
from flora_lab.diagnose.hypothesis import Cause, Hypothesis, pushed_by
from flora_lab.diagnose.information_form import InformationForm
from flora_lab.diagnose.scene import START_SD, Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.levenberg_marquardt import descended
from flora_lab.simulator.tropism_traits import NAMES

TRAITS: Final = len(NAMES)
_OWN: Final = TRAITS + len(START_SD)
STEPS: Final = 12
"""Of a fit that is to be as good as it gets, at most: it ends where one gains no more."""
_STEP_SD: Final = 0.1
"""Of differences, in standard deviations of what is known before."""
_FARTHEST_SD: Final = 7.0
_GAINED_NATS: Final = 0.02
"""A step that gains no more is the last."""


@dataclass(frozen=True, slots=True)
class Base:
    """What is known of plants under the simulator, and of how wrong it is.

    Attributes:
        mean: of the traits, shape (9,).
        spread: between plants, shape (9, 9).
        doubt: of the mean, shape (9, 9).
        sizes: of what happens by chance, see :mod:`flora_lab.diagnose.chance`.
        first: logarithm of the first stem's length and its lean in rad, shape (2,): mean over plants.
        first_sd: how plants differ in them.
        runs: that this was learned from.
    """

    mean: Array
    spread: Array
    doubt: Array
    sizes: Array
    first: Array
    first_sd: Array
    runs: int

    def of_single_runs(self) -> Base:
        """For runs looked at one by one: that the mean is not known for certain is one with how they differ."""
        return replace(self, spread=self.spread + self.doubt, doubt=1e-9 * np.eye(TRAITS))

    def mean_with(self, traits: Array) -> Array:
        """What is typical once further plants are known, too, shape (9,): as far towards their mean as so few tell.

        Args:
            traits: of these as they are most probable, shape (runs, 9).
        """
        away = traits.mean(axis=0) - self.mean
        return np.asarray(self.mean + self.doubt @ np.linalg.solve(self.doubt + self.spread / len(traits), away))


@dataclass(frozen=True, slots=True)
class Ready:
    """A run, ready to be explained. To its features come length and lean of the first stem.

    Attributes:
        scene: the run.
        measured: shape (m + 2,).
        inverse_root: of the covariance, shape (m + 2, m + 2).
    """

    scene: Scene
    measured: Array
    inverse_root: Array

    def white(self, values: Array) -> Array:
        """Values (m + 2,) or (m + 2, k) in units of chance; of plants that cannot be they are not finite."""
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(self.inverse_root @ values)


def ready(
    scene: Scene, base: Base, parts: Array, *, together: int, besides: Array | None = None, shift: Array | None = None
) -> Ready:
    """A run with what chance does to it.

    Args:
        scene: the run.
        base: what is known.
        parts: of about the plant that it is, see :func:`flora_lab.diagnose.chance.covariances`.
        together: number of runs that will be explained together: what is known of first stems from so few runs is not
            known better in the mean over many others.
        besides: covariance of what is there besides, shape (m, m).
        shift: what is there in any run, shape (m,).
    """
    covariance = np.tensordot(base.sizes**2, parts, axes=1)
    if besides is not None:
        covariance += besides
    m = scene.size
    root = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    inverse_root = np.zeros((m + 2, m + 2))
    inverse_root[:m, :m] = scipy.linalg.solve_triangular(root, np.eye(m), lower=True, check_finite=False)
    inverse_root[[m, m + 1], [m, m + 1]] = 1.0 / (base.first_sd * np.sqrt(1.0 + together / max(base.runs, 1)))
    features = scene.features if shift is None else scene.features - shift
    return Ready(scene, np.concatenate([features, scene.first - base.first]), inverse_root)


@dataclass(slots=True)
class Found:
    """The most probable plants and parameters of a hypothesis.

    Attributes:
        hypothesis: which.
        coordinates: of its parameters, shape (q,).
        traits: shape (runs, 9).
        start: tilt and bow, shape (runs, 2).
        evidence: logarithm, up to a constant that all hypotheses about the same runs share.
        misfit: half the sum of squares, with what was known before.
        covariance: of the coordinates, shape (q, q).
        residuals: whitened, one array per run.
        jacobians: whitened, of a run's features by its own unknowns and the parameters, shape (m, 11 + q).
    """

    hypothesis: Hypothesis
    coordinates: Array
    traits: Array
    start: Array
    evidence: float = -np.inf
    misfit: float = np.inf
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    residuals: list[Array] = field(default_factory=list)
    jacobians: list[Array] = field(default_factory=list)

    @property
    def left(self) -> float:
        """Mean square of what is left of the runs, in units of chance; each counts as much."""
        return float(np.mean([np.mean(residual**2) for residual in self.residuals]))

    def values(self) -> list[dict[str, float]]:
        """Parameters of each cause by name."""
        causes, shares = self.hypothesis.causes, self.hypothesis.shares(self.coordinates)
        return [cause.values(own) for cause, own in zip(causes, shares, strict=True)]


def evidence_for_last(before: Found, fit: Found) -> float:
    """Nats for the last cause of a fit, in one of its forms, beyond what there was before it."""
    effect = fit.hypothesis.causes[-1].effect
    return float(fit.evidence - before.evidence - np.log(len(effect.forms)) + np.log(effect.prior))


class Joint:
    """Some runs, to be explained together.

    Args:
        runs: ready to be explained.
        base: what is known of plants.
    """

    def __init__(self, runs: Sequence[Ready], base: Base) -> None:
        self.runs = runs
        self.base = base
        count = len(runs)
        together = np.kron(np.eye(count), base.spread) + np.kron(np.ones((count, count)), base.doubt)
        self._trait_precision = np.linalg.inv(together)
        self._trait_sd = np.sqrt(np.diag(base.spread + base.doubt))

    def fit(self, start: Found, iterations: int = STEPS) -> Found:
        """The most probable unknowns of a hypothesis, from a start on.

        Its evidence is minus infinity where no stem can be simulated there.
        """
        at = self._linearised(replace(start))
        if not np.isfinite(at.misfit):
            return at
        return self._with_evidence(
            descended(
                at, self._normal, self._better, steps=iterations, damping=1e-3, most_damping=1e5, gained=_GAINED_NATS
            )
        )

    def _better(self, at: Found, step: Array) -> Found | None:
        """Where a step leads, if that is better; where a stem can be simulated, but not those beside it, is no place
        to go on from."""
        new = self._moved(at, step)
        if not self._misfit_only(new) < at.misfit:
            return None
        new = self._linearised(new)
        return new if np.isfinite(new.misfit) else None

    def screened(self, before: Found, cause: Cause, start: Array) -> Found:
        """Where one cause more would lead from one start, with about the evidence that it would come to.

        All is linear in the plants and in the parameters about the start; the plants' own slopes are those of
        ``before``, so that this costs a tenth of a fit.

        Args:
            before: fitted, without the cause.
            cause: which.
            start: coordinates of its parameters.
        """
        at, normal, downhill = self._about(before, cause, start)
        if not (np.isfinite(at.misfit) and np.isfinite(normal).all()):
            return at
        step = self._within_reach(at, normal, downhill)
        misfit = at.misfit - float(downhill @ step) + 0.5 * float(step @ normal @ step)
        ratio = np.linalg.slogdet(normal)[1] - np.linalg.slogdet(self._precision(at.hypothesis))[1]
        moved = self._moved(at, step)
        q = len(at.coordinates)
        moved.covariance = np.linalg.inv(normal)[len(normal) - q :, len(normal) - q :]
        moved.evidence = float(-misfit - 0.5 * ratio)
        return moved

    def _within_reach(self, at: Found, normal: Array, downhill: Array) -> Array:
        """The step to the bottom; where that lies beyond what a parameter can be, with it at its bound.

        Else the mirror of an effect (less by night is more by day) would be taken for the effect, and end as nothing.
        """
        step = np.linalg.solve(normal, downhill)
        first = len(step) - len(at.coordinates)
        kept = self._moved(at, step).coordinates - at.coordinates
        bound = first + np.flatnonzero(np.abs(kept - step[first:]) > 1e-12)
        if len(bound):
            free = np.setdiff1d(np.arange(len(step)), bound)
            step[bound] = kept[bound - first]
            pull = downhill[free] - normal[np.ix_(free, bound)] @ step[bound]
            step[free] = np.linalg.solve(normal[np.ix_(free, free)], pull)
        return step

    def _about(self, before: Found, cause: Cause, start: Array) -> tuple[Found, Array, Array]:
        """One cause more at a start, and the normal equations there."""
        hypothesis = Hypothesis((*before.hypothesis.causes, cause))
        at = Found(hypothesis, np.concatenate([before.coordinates, start]), before.traits, before.start)
        away = self._away(at)
        at.misfit = 0.5 * float(away @ self._precision(hypothesis) @ away)
        for run, own in enumerate(self.runs):
            pushed = pushed_by(at.hypothesis, at.coordinates, len(start))
            told = self._told(run, at.traits[run], at.start[run], pushed.changes)
            residual = own.white(own.measured - told[0])
            at.residuals.append(residual)
            known = before.jacobians[run]
            slopes = known[:, :TRAITS] @ pushed.shifts + own.white(pushed.slopes(told[1:]))
            at.jacobians.append(np.concatenate([known, slopes], axis=1))
            at.misfit += 0.5 * float(residual @ residual)
        return at, *self._normal(at)

    def _told(self, run: int, traits: Array, start: Array, changes: Sequence[Change]) -> Array:
        """Features of a run, with those of its first stem, shape (changes, m + 2).

        Args:
            run: which.
            traits, start: of the plant, shape (9,) and (2,), or one row per change.
            changes: one per row of the answer.
        """
        shifts = np.stack([change.traits for change in changes])
        starts = np.broadcast_to(start, (len(changes), len(START_SD)))
        told = self.runs[run].scene.simulated(Lanes(traits + shifts, starts, changes))
        first = [[np.log(change.scale), np.radians(change.turn_deg)] for change in changes]
        return np.concatenate([told, first], axis=1)

    def beside(self, found: Found, pushed: Sequence[Array], places: Sequence[Array] | None = None) -> InformationForm:
        """What runs tell of something beside an explanation that pushes features in proportion to its sizes.

        All is linear about the explanation, whose plants and parameters give way.

        Args:
            found: fitted.
            pushed: by a unit of each size, one array of shape (m, its sizes) per run.
            places: of each run's sizes among those of all, shape (its sizes,); all runs have all of them where None.
        """
        normal, downhill = self._normal(found)
        count, q = len(self.runs), len(found.coordinates)
        places = [np.arange(along.shape[1]) for along in pushed] if places is None else places
        sizes = 1 + max(int(at.max()) for at in places)
        information, pull = np.zeros((sizes, sizes)), np.zeros(sizes)
        across = np.zeros((len(normal), sizes))
        for run, (own, along, at) in enumerate(zip(self.runs, pushed, places, strict=True)):
            white = own.white(np.concatenate([along, np.zeros((len(own.measured) - len(along), len(at)))]))
            information[np.ix_(at, at)] += white.T @ white
            pull[at] += white.T @ found.residuals[run]
            across[np.ix_(self._places(run, count, q), at)] += found.jacobians[run].T @ white
        gives_way = np.linalg.solve(normal, np.column_stack([across, downhill]))
        return InformationForm(information - across.T @ gives_way[:, :-1], pull - across.T @ gives_way[:, -1])

    def probability(self, found: Found) -> float:
        """The evidence of a fit beside those of the same runs with other errors by chance: with these errors' size."""
        return found.evidence + sum(float(np.log(np.diag(own.inverse_root)).sum()) for own in self.runs)

    def null(self) -> Found:
        """A start without any cause, all plants typical."""
        count = len(self.runs)
        return Found(Hypothesis(), np.zeros(0), np.repeat(self.base.mean[None], count, axis=0), np.zeros((count, 2)))

    # The unknowns stand in this order: traits of all plants, starts of all plants, parameters.

    def _precision(self, hypothesis: Hypothesis) -> Array:
        count = len(self.runs)
        spreads = np.array([p.spread for p in hypothesis.parameters])
        starts = np.diag(np.tile(START_SD**-2.0, count))
        return np.asarray(scipy.linalg.block_diag(self._trait_precision, starts, np.diag(spreads**-2.0)))

    def _away(self, found: Found) -> Array:
        expected = [
            own if p.is_cyclic else p.centre
            for p, own in zip(found.hypothesis.parameters, found.coordinates, strict=True)
        ]
        return np.concatenate(
            [(found.traits - self.base.mean).ravel(), found.start.ravel(), found.coordinates - np.array(expected)]
        )

    def _moved(self, at: Found, step: Array) -> Found:
        count = len(self.runs)
        traits = at.traits + step[: TRAITS * count].reshape(count, TRAITS)
        far = _FARTHEST_SD * self._trait_sd
        traits = np.clip(traits, self.base.mean - far, self.base.mean + far)
        start = at.start + step[TRAITS * count : _OWN * count].reshape(count, -1)
        start = np.clip(start, -10 * START_SD, 10 * START_SD)
        reach = np.array([p.reach for p in at.hypothesis.parameters]).reshape(-1, 2)
        coordinates = np.clip(at.coordinates + step[_OWN * count :], reach[:, 0], reach[:, 1])
        return Found(at.hypothesis, coordinates, traits, start)

    def features_of(self, found: Found, run: int, *, with_slopes: bool = True) -> tuple[Array, Array]:
        """Features of a run (m + 2,), and their derivatives (m + 2, 11 + q) in its own unknowns and the parameters.

        All differences are to both sides: to one side they would be off by a hundredth, which tells a plant that grows
        faster from one whose growth is multiplied, though nothing can.
        """
        pushed = pushed_by(found.hypothesis, found.coordinates, len(found.coordinates) if with_slopes else 0)
        widths = np.concatenate([_STEP_SD * self._trait_sd, START_SD * 0.5])
        away = np.diag(widths) if with_slopes else np.zeros((0, _OWN))
        still = np.zeros((len(pushed.changes), _OWN))
        lanes = np.concatenate([found.traits[run], found.start[run]]) + np.concatenate([still, away, -away])
        changes = pushed.changes + [pushed.changes[0]] * (2 * len(away))
        told = self._told(run, lanes[:, :TRAITS], lanes[:, TRAITS:], changes)
        if not with_slopes:
            return told[0], np.zeros((told.shape[1], 0))
        up, down = told[len(still) :].reshape(2, _OWN, told.shape[1])
        own = ((up - down) / (2.0 * widths[:, None])).T
        parameters = own[:, :TRAITS] @ pushed.shifts + pushed.slopes(told[1 : len(still)])
        return told[0], np.concatenate([own, parameters], axis=1)

    def _linearised(self, found: Found) -> Found:
        found.residuals, found.jacobians = [], []
        away = self._away(found)
        total = 0.5 * float(away @ self._precision(found.hypothesis) @ away)
        for run, own in enumerate(self.runs):
            told, slopes = self.features_of(found, run, with_slopes=True)
            residual = own.white(own.measured - told)
            found.residuals.append(residual)
            found.jacobians.append(own.white(slopes))
            total += 0.5 * float(residual @ residual)
        is_whole = np.isfinite(total) and all(np.isfinite(jacobian).all() for jacobian in found.jacobians)
        found.misfit, found.evidence = total if is_whole else np.inf, -np.inf
        return found

    def _misfit_only(self, found: Found) -> float:
        away = self._away(found)
        total = 0.5 * float(away @ self._precision(found.hypothesis) @ away)
        for run, own in enumerate(self.runs):
            told, _ = self.features_of(found, run, with_slopes=False)
            residual = own.white(own.measured - told)
            total += 0.5 * float(residual @ residual)
        return total if np.isfinite(total) else np.inf

    def _normal(self, found: Found) -> tuple[Array, Array]:
        count, q = len(self.runs), len(found.coordinates)
        normal = self._precision(found.hypothesis).copy()
        downhill = -normal @ self._away(found)
        for run, (residual, jacobian) in enumerate(zip(found.residuals, found.jacobians, strict=True)):
            at = self._places(run, count, q)
            normal[np.ix_(at, at)] += jacobian.T @ jacobian
            downhill[at] += jacobian.T @ residual
        return normal, downhill

    @staticmethod
    def _places(run: int, count: int, q: int) -> Array:
        """Where the unknowns of a run stand, and the parameters."""
        own, start = TRAITS * run + np.arange(TRAITS), TRAITS * count + 2 * run + np.arange(2)
        return np.concatenate([own, start, _OWN * count + np.arange(q)])

    def _with_evidence(self, found: Found) -> Found:
        normal, _ = self._normal(found)
        precision = self._precision(found.hypothesis)
        ratio = np.linalg.slogdet(normal)[1] - np.linalg.slogdet(precision)[1]
        found.evidence = float(-found.misfit - 0.5 * ratio)
        q = len(found.coordinates)
        found.covariance = np.linalg.inv(normal)[len(normal) - q :, len(normal) - q :] if q else np.zeros((0, 0))
        return found
