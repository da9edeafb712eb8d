"""All that reference runs tell: of plants, of chance, of swings, and of what the law is wrong in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import learn, rhythm, usual_errors
from flora_lab.diagnose.joint import Base, Found, Joint, Ready, ready
from flora_lab.diagnose.learn import Learned
from flora_lab.diagnose.residuals import ReferenceResiduals, reference_residuals
from flora_lab.diagnose.rhythm import Spectrum, Swing, Swings
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.usual_errors import UsualErrors
from flora_lab.diagnose.usual_pushes import UsualPushes, no_pushes, usual_pushes
from flora_lab.effects.catalogue import CATALOGUE
from flora_lab.effects.effect import Change
from flora_lab.effects.law_forms import LAWS, Law
from flora_lab.simulator.extended import change_of
from flora_lab.simulator.store import Extension

LOOKED_FOR: Final = tuple(effect.name for effect in CATALOGUE if effect.forms)
"""Causes that are looked for."""
_STEPS: Final = 8
_PARTS: Final = 6
_RATHER: Final = 10.0
"""Nats by which a law must be better for each form in which it is another than it is written: of stems whose growth
rises with their length, but not in a straight line, nine runs were seven nats for one by the hours."""
_ASPECTS: Final = (0, 1, 2, 0)
"""In this order: when stems grow shows under most laws of bending, and once more where another one was found."""
LAW_ROUNDS: Final = learn.ROUNDS * (1 + sum(len(LAWS[aspect]) for aspect in _ASPECTS))
"""How often :func:`law_of` tells that it has come farther."""


@dataclass(frozen=True, slots=True)
class Knowledge:
    """What a search for causes starts from.

    Attributes:
        base: of plants, and of what happens by chance.
        swings: what tips do anyway.
        errors: how much of every effect healthy runs seem to show.
        left: what each reference run leaves by itself, see :func:`blocks`, shape (runs, 2).
        swing_evidence: nats for a swing in each reference run beside the others, shape (runs,).
        residuals: what the base gets wrong about its own runs.
        law: the forms of the law that its plants are under; none where it is as it is written.
        pushes: what has no name and healthy runs show all the same.
        cross_fit: nats for each of :data:`LOOKED_FOR` in reference runs by what the others tell, shape (folds, causes);
            no folds where they are too few. See :mod:`flora_lab.diagnose.cross_fit`.
        swing: that plants have by themselves; it is a part of ``swings`` and ``residuals`` already, see
            :mod:`flora_lab.diagnose.known_swing`. None where the simulator was extended by none.
    """

    base: Base
    swings: Swings
    errors: UsualErrors
    left: Array
    swing_evidence: Array
    residuals: ReferenceResiduals
    law: tuple[Extension, ...] = ()
    pushes: UsualPushes = field(default_factory=no_pushes)
    cross_fit: Array = field(default_factory=lambda: np.zeros((0, len(LOOKED_FOR))))
    swing: Swing | None = None


def known_of(scenes: Sequence[Scene], best: Learned, law: tuple[Extension, ...]) -> Knowledge:
    """All that runs tell beside their plants; but for :attr:`Knowledge.cross_fit`.

    Args:
        scenes: under the law.
        best: learned from them.
        law: its forms.
    """
    base, fits, parts = best.base, best.fits, best.parts
    alone = base.of_single_runs()
    runs = [ready(scene, alone, own, together=0) for scene, own in zip(scenes, parts, strict=True)]
    ends = [_on(run, alone, fit) for run, fit in zip(runs, fits, strict=True)]
    errors = usual_errors.usual_errors(runs, ends, alone)
    usual = [errors.of_run(scene, end.traits[0], Change()) for scene, end in zip(scenes, ends, strict=True)]
    runs = [
        ready(scene, alone, own, together=0, besides=besides, shift=shift)
        for scene, own, (shift, besides) in zip(scenes, parts, usual, strict=True)
    ]
    ends = [_on(run, alone, end) for run, end in zip(runs, ends, strict=True)]
    answers = [scene.answers(end.traits[0], Change()) for scene, end in zip(scenes, ends, strict=True)]
    pushes = usual_pushes(runs, ends, answers, alone)
    spectra = [spectra_of(scene, end, 0) for scene, end in zip(scenes, ends, strict=True)]
    swings = rhythm.usual([rest for rest, _ in spectra], [moved for _, moved in spectra])
    left = np.stack([blocks(end.residuals[0]) for end in ends])
    shown = reference_residuals(scenes, base, ends)
    return Knowledge(base, swings, errors, left, _swing_evidence(spectra), shown, law, pushes)


def law_of(
    scenes: Sequence[Scene], on_round: Callable[[], None] = lambda: None, laws: Sequence[Law] = LAWS
) -> tuple[tuple[Extension, ...], Learned]:
    """The forms of the law that plants are under, and what is learned under it.

    Laws are compared where each has come to rest: after one round plants are still on their way from the constants that
    another law gave them, and the right law may be thirty nats behind. Two forms together may be what neither alone is.

    Args:
        scenes: the runs.
        on_round: called :data:`LAW_ROUNDS` times where ``laws`` are all.
        laws: to choose from, see :data:`flora_lab.effects.law_forms.LAWS`.
    """
    law: Law = ((),) * len(laws)
    best = learn.learned(scenes, on_round)
    tried = [law]
    for aspect in _ASPECTS:
        start = best
        for forms in laws[aspect]:
            rival = (*law[:aspect], forms, *law[aspect + 1 :])
            if rival in tried:
                for _ in range(learn.ROUNDS):
                    on_round()
                continue
            tried.append(rival)
            other = learn.learned_from(under(_extensions(rival), scenes), start, best.evidence, on_round)
            if other.evidence - best.evidence > _RATHER * (_forms_in(rival) - _forms_in(law)):
                law, best = rival, other
    return _extensions(law), best


def _forms_in(law: Law) -> int:
    return sum(len(forms) for forms in law)


def _extensions(law: Law) -> tuple[Extension, ...]:
    return tuple(Extension(form.name, {"amount": 1.0}) for forms in law for form in forms)


def under(law: Sequence[Extension], scenes: Sequence[Scene]) -> list[Scene]:
    """The same runs for a law of these forms."""
    return [scene.under(change_of(law, "law")) for scene in scenes]


def _on(run: Ready, alone: Base, fit: Found) -> Found:
    """A fit of one run, carried on."""
    start = Found(fit.hypothesis, fit.coordinates, fit.traits, fit.start)
    return Joint([run], alone).fit(start, _STEPS)


def blocks(residual: Array) -> Array:
    """Mean square of what is left of a run, in units of chance, and that of its worst part, shape (2,).

    Args:
        residual: whitened in order of time, shape (m,); one part is a sixth of it, and parts overlap by half.
    """
    squares = residual**2
    size = max(1, len(squares) // _PARTS)
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    starts = np.arange(0, len(squares) - size + 1, max(1, size // 2))
    return np.array([squares.mean(), ((sums[starts + size] - sums[starts]) / size).max()])


def spectra_of(scene: Scene, found: Found, run: int) -> tuple[Spectrum, Spectrum]:
    """Of what a fit leaves of a run's tip, and of what it makes the tip do."""
    change = found.hypothesis.change(found.coordinates)
    rest, simulated = scene.tips(found.traits[run], found.start[run], change)
    return rhythm.spectrum(rest, scene.step_h), rhythm.spectrum(simulated, scene.step_h)


def _swing_evidence(spectra: Sequence[tuple[Spectrum, Spectrum]]) -> Array:
    """For a swing in each run, if what is usual were told by all the others."""
    found = []
    for i, (rest, moved) in enumerate(spectra):
        others = [pair for j, pair in enumerate(spectra) if j != i]
        swings = rhythm.usual([a for a, _ in others], [b for _, b in others])
        found.append(rhythm.best_swing([rest], [swings.expectations(moved)]).evidence)
    return np.array(found)
