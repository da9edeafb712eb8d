"""The base simulator, learned from reference runs: typical plants, how they differ, what happens by chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import chance, marginal
from flora_lab.diagnose.joint import Base, Found, Joint, Ready, ready
from flora_lab.diagnose.marginal import Linear
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change
from flora_lab.simulator.tropism_traits import NAMES, prior_doubt, prior_mean, prior_spread

ROUNDS: Final = 3
_FIRST_ITERATIONS: Final = 12
_ITERATIONS: Final = 5
_TURNS: Final = 2
_HOPELESS: Final = 50.0
"""Nats: of laws that were right in the end, the last was 31 behind after the first round."""
_CATCHES_UP: Final = 0.2
"""Share of what a law is behind that its second round must make up for, for a third one to be worth its time."""
_FAR_WORSE: Final = 2.0
_FAR_OFF: Final = 4.5
_STEP: Final = 3.0
"""How far from the middle of the plants the typical one is sought, in units of how they differ."""
_FIRST_SD: Final = np.array([0.08, 0.06])
"""How seedlings are expected to differ in the logarithm of their length, and in lean, rad."""
_FIRST_STRENGTH: Final = 3.0
_DOUBTS: Final = {
    "growth_early_cm_per_day": 0.5,
    "growth_late_cm_per_day": 0.5,
    "growth_zone_cm": 0.5,
    "stiffening_cm": 0.6,
    "mature_cm": 0.5,
    "photo_latency_min": 0.7,
}
"""Plants other than those that the sources measured are let in: what is not told by the runs matters little."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What reference runs tell of plants under one law.

    Attributes:
        base: of plants.
        fits: of each run by itself.
        parts: what happens by chance about these, see :func:`flora_lab.diagnose.chance.covariances`.
        evidence: logarithm of the probability of the runs, up to a constant that all laws share.
    """

    base: Base
    fits: list[Found]
    parts: list[Array]
    evidence: float


def learned(scenes: Sequence[Scene], on_round: Callable[[], None] = lambda: None) -> Learned:
    """Learn a base from runs in which nothing is taken to be wrong; ``on_round`` is told of each of :data:`ROUNDS`."""
    first, first_sd = _firsts(scenes)
    sizes = chance.sizes_expected() * 1.5
    base = Base(prior_mean(), prior_spread(), _known_doubt(), sizes, first, first_sd, len(scenes))
    parts = [chance.covariances(scene, scene.answers(base.mean, Change())) for scene in scenes]
    return learned_from(scenes, Learned(base, [], parts, -np.inf), -np.inf, on_round)


def learned_from(
    scenes: Sequence[Scene], start: Learned, rival: float, on_round: Callable[[], None] = lambda: None
) -> Learned:
    """The same from what was learned of the same runs under another law.

    Where a law is not the plants' own, fits jump from round to round: the round after which runs are most probable
    counts. A law that is far behind after the first round is given up, and so is one that is behind and does not catch
    up.

    Args:
        scenes: the runs.
        start: where to begin.
        rival: :attr:`Learned.evidence` of the best law so far.
        on_round: told of each of :data:`ROUNDS`.
    """
    best = so_far = _carried_on(scenes, start, _FIRST_ITERATIONS)
    on_round()
    is_hopeful = best.evidence > rival - _HOPELESS
    for _ in range(ROUNDS - 1):
        if is_hopeful:
            before, so_far = so_far, _carried_on(scenes, so_far, _ITERATIONS)
            best = max(best, so_far, key=lambda one: one.evidence)
            behind = rival - best.evidence
            is_hopeful = behind < 0.0 or so_far.evidence - before.evidence > _CATCHES_UP * behind
        on_round()
    return best


def learned_by(scenes: Sequence[Scene], whole: Learned, kept: Sequence[int]) -> Learned:
    """What some of the runs tell, from where all of them have come to: each plant stays as it was fitted."""
    fits, parts = [whole.fits[i] for i in kept], [whole.parts[i] for i in kept]
    base = replace(whole.base, runs=len(kept))
    alone = base.of_single_runs()
    runs = [ready(scenes[i], alone, one, together=0) for i, one in zip(kept, parts, strict=True)]
    return _together(runs, base, fits, parts)


def _carried_on(scenes: Sequence[Scene], so_far: Learned, iterations: int) -> Learned:
    """One round more: each run's plant, what plants have in common, and what happens by chance about them."""
    alone = so_far.base.of_single_runs()
    runs = [ready(scene, alone, one, together=0) for scene, one in zip(scenes, so_far.parts, strict=True)]
    starts = so_far.fits or [Joint([one], alone).null() for one in runs]
    fits = [Joint([one], alone).fit(old, iterations) for one, old in zip(runs, starts, strict=True)]
    fits = _from_the_middle(runs, alone, fits)
    parts = [
        chance.covariances(scene, scene.answers(fit.traits[0], Change()))
        for scene, fit in zip(scenes, fits, strict=True)
    ]
    return _together(runs, so_far.base, fits, parts)


def _together(runs: Sequence[Ready], so_far: Base, fits: list[Found], parts: list[Array]) -> Learned:
    """What the plants of fits have in common, and what happens by chance about them."""
    alone = so_far.of_single_runs()
    linear = [_linear(alone, *of_run) for of_run in zip(runs, fits, parts, strict=True)]
    near = [one for one, is_near in zip(linear, _are_near(fits), strict=True) if is_near]
    base = _population(near, so_far, *_middle(fits))
    evidence = marginal.evidence(linear, base.mean, base.sizes, base.spread + base.doubt)
    return Learned(base, fits, parts, evidence)


def _known_doubt() -> Array:
    return np.diag([_DOUBTS.get(n, d) ** 2 for n, d in zip(NAMES, prior_doubt(), strict=True)])


def _from_the_middle(runs: Sequence[Ready], base: Base, fits: Sequence[Found]) -> list[Found]:
    """Fits that ended much worse than the others, or far from them, once more, from where these ended."""
    middle, _ = _middle(fits)
    usual = float(np.median([fit.misfit for fit in fits]))
    out = []
    for one, fit, is_near in zip(runs, fits, _are_near(fits), strict=True):
        best = fit
        if not is_near or not fit.misfit <= _FAR_WORSE * usual:
            joint = Joint([one], base)
            again = joint.fit(replace(joint.null(), traits=middle[None]))
            best = again if again.misfit < fit.misfit else fit
        out.append(best)
    return out


def _are_near(fits: Sequence[Found]) -> list[bool]:
    """Whether each is of a plant like most others: one that ended in a corner must not tell how plants differ."""
    middle, usual = _middle(fits)
    return [bool((np.abs(fit.traits[0] - middle) / usual).max() <= _FAR_OFF) for fit in fits]


def _middle(fits: Sequence[Found]) -> tuple[Array, Array]:
    """The middle of the plants of some fits, and how far from it most are, each of shape (9,)."""
    values = np.concatenate([fit.traits for fit in fits])
    middle = np.median(values, axis=0)
    away = np.median(np.abs(values - middle), axis=0)
    return middle, np.maximum(away, np.sqrt(np.diag(prior_spread())))


def _linear(alone: Base, run: Ready, fit: Found, parts: Array) -> Linear:
    """A run, from its own fit carried on to any plant: linear, because the typical one may stand elsewhere."""
    scene = run.scene
    told, slopes = Joint([run], alone).features_of(fit, 0)
    told, slopes = told[: scene.size], slopes[: scene.size]
    return Linear(scene.features - told + slopes @ np.concatenate([fit.traits[0], fit.start[0]]), slopes, parts)


def _population(runs: Sequence[Linear], base: Base, middle: Array, usual: Array) -> Base:
    """What is known of plants after some runs; what is typical and how plants differ take turns.

    Runs are linear about their own plants only. Where they hardly tell a combination of constants (stems that stiffen
    within half a centimetre, or within eight and mature earlier), what is typical would be found far from all of them,
    and a round later far on the other side; so it goes some way only.

    Args:
        runs: about their own plants.
        base: what was known of chance and differences.
        middle, usual: of these plants, and how far most are from it, each of shape (9,).
    """
    known = prior_mean(), _known_doubt()

    def typical(sizes: Array, spread: Array) -> tuple[Array, Array]:
        mean, doubt = marginal.typical(runs, sizes, spread, known)
        far = float((np.abs(mean - middle) / usual).max())
        return middle + (mean - middle) * (_STEP / max(_STEP, far)), doubt

    mean, _ = typical(base.sizes, base.spread)
    for _ in range(_TURNS):
        sizes, spread = marginal.sizes_and_spread(runs, mean, base.sizes)
        mean, doubt = typical(sizes, spread)
    return replace(base, mean=mean, spread=spread, doubt=doubt, sizes=sizes)


def _firsts(scenes: Sequence[Scene]) -> tuple[Array, Array]:
    values = np.stack([scene.first for scene in scenes])
    mean = values.mean(axis=0)
    variance = ((values - mean) ** 2).sum(axis=0) + _FIRST_STRENGTH * _FIRST_SD**2
    return mean, np.sqrt(variance / (len(scenes) + _FIRST_STRENGTH))
