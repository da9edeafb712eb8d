"""Causes tried on measured runs: all of them, each on top of those that are in already."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import chance, claims, rhythm, search
from flora_lab.diagnose.alone import side_by_side
from flora_lab.diagnose.explanation import SWING, Stage, Tried
from flora_lab.diagnose.gusts import CALM, Gusts, best_gusts, covariance, power
from flora_lab.diagnose.hypothesis import Cause
from flora_lab.diagnose.joint import Found, Joint, evidence_for_last, ready
from flora_lab.diagnose.knowledge import Knowledge, spectra_of
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.rhythm import Spectrum, Swing
from flora_lab.diagnose.scene import Answers, Scene
from flora_lab.diagnose.unnamed import unnamed
from flora_lab.effects import draught
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Effect

_MUCH: Final = 3.0
"""So many times what healthy runs leave is left where the plants themselves were not found."""
_RESTARTS_AT_FIRST: Final = 2
"""Times that plants are looked for again at most before a first cause; before another one once."""


class Trials:
    """Tries causes on runs.

    What the runs are whitened for, chance and the law's errors and gusts, is answered about the plants and causes of
    one fit (:meth:`answer`) and holds for what is tried after that.

    Args:
        scenes: the measured runs.
        known: what the reference tells.
        on_search: told how many causes are tried next, on top of those found; what it gives is called after each.

    Attributes:
        scenes: the runs as they are compared; may be set, to such that leave out their ends.
        claims: how much evidence it takes.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        known: Knowledge,
        on_search: Callable[[int], Callable[[], None]] = lambda _: lambda: None,
    ) -> None:
        self.scenes = scenes
        self.known = known
        self.claims = claims.claims_of(known, len(scenes))
        self._on_search = on_search
        self._answers: list[Answers] = []
        self._errors: list[tuple[Array, Array]] = []
        self._gusts = CALM

    def begun(self) -> tuple[Found, Joint, Found]:
        """Each run by itself, all together, and how they are without a cause."""
        alone = side_by_side(self.scenes, self.known.base)
        self.answer(alone, CALM)
        joint = self.joint(None)
        null = joint.fit(alone)
        if self._is_much(null):
            # What is very wrong with the runs may have led each of them far astray.
            null = max(null, joint.fit(joint.null()), key=lambda fit: fit.evidence)
        return alone, joint, null

    def first_stage(self) -> Stage:
        """All causes on top of none."""
        _, joint, null = self.begun()
        return self.settled(joint, null, None)

    def settled(self, joint: Joint, before: Found, swing: Swing | None) -> Stage:
        """One step, once the plants are found: what many causes seem to explain may be plants that were not, and so
        these are looked for again from the winner's.

        Args:
            joint: the runs, whitened for what is in.
            before: the fit with what is in.
            swing: where one is in.
        """
        stage = self.stage(joint, before, swing)
        is_first = swing is None and not before.hypothesis.causes
        for _ in range(_RESTARTS_AT_FIRST if is_first else 1):
            better = self._restarted(joint, stage)
            if better.evidence < stage.before.evidence + 1.0:
                break
            stage = self.stage(joint, better, swing)
        return stage

    def stage(self, joint: Joint, before: Found, swing: Swing | None) -> Stage:
        """All causes that are not yet in, on top of those that are, best first."""
        there = set(before.hypothesis.names())
        tried: list[Tried] = []
        effects = [e for e in CATALOGUE if e.forms and e.name != SWING and e.name not in there and self._may_be(e)]
        for effect, fit in search.best_of_each(joint, before, effects, self._on_search(len(effects))):
            tried.append(tried_on(before, effect, fit))
        tried.sort(key=lambda t: -t.gain)
        while tried and tried[0].found is not None and not tried[0].found.jacobians:
            # Only looked at linearly so far.
            effect, fit = tried[0].effect, search.fitted(joint, before, tried[0].found)
            tried[0] = tried_on(before, effect, fit)
            tried.sort(key=lambda t: -t.gain)
        tried = [self._in_gusts(joint, before, one) if one.effect is draught.EFFECT else one for one in tried]
        tried.sort(key=lambda t: -t.gain)
        beside: tuple[Joint, Found] | None = None
        if swing is None and self.known.swing is None:
            own = self.swing(before)
            if own.gain > 0.0 and own.swing is not None:
                swinging = self.joint(own.swing)
                beside = swinging, swinging.fit(started(before))
                # A swing explains something of the hours' means, too, and a cause may make fast errors vanish.
                slower = swinging.probability(beside[1]) - joint.probability(before)
                faster = max((t.gain + self._faster(before, t) for t in tried[:3] if t.found is not None), default=0.0)
                own = replace(own, gain=own.gain + max(0.0, slower))
                tried.insert(0 if own.gain > faster else 1, own)
        found = Stage(before, tuple(tried), self._unnamed(joint, before, swing))
        if beside is not None and found.tried[0].swing is not None and self._has_no_name(found):
            # Hours' means keep some of a slow swing, which has no name as long as it is not known for what it is.
            found = replace(found, unnamed=self._unnamed(*beside, found.tried[0].swing))
        if swing is not None or before.hypothesis.causes:
            return found
        if self._has_no_name(found):
            return self._again(joint, found, lambda one: one.misfit > before.misfit + 1.0)
        if self._leaves_much(found):
            return self._again(joint, found, lambda one: one.hypothesis.causes[-1].effect.is_strong)
        return found

    def swing(self, before: Found) -> Tried:
        """The best swing of the tip in what a fit leaves."""
        fast = (self._fast(scene, before, i, self._gusts) for i, scene in enumerate(self.scenes))
        left, expected = zip(*fast, strict=True)
        swing = rhythm.best_swing(left, expected, [scene.sideways for scene in self.scenes])
        usual = float(np.mean(np.maximum(np.sort(self.known.swing_evidence)[:-1], 0.0))) * len(self.scenes)
        gain = swing.evidence - usual if rhythm.is_plausible(swing) else 0.0
        return Tried(BY_NAME[SWING], gain, None, swing)

    def answer(self, found: Found, gusts: Gusts) -> None:
        """How the runs answer chance, what the law is wrong in, and gusts, about a fit's plants, with its causes."""
        self._gusts = gusts
        change = found.hypothesis.change(found.coordinates)
        self._answers = [
            scene.answers(traits + change.traits, change)
            for scene, traits in zip(self.scenes, found.traits, strict=True)
        ]
        self._errors = []
        for run, (scene, traits) in enumerate(zip(self.scenes, found.traits, strict=True)):
            shift, errors = self.known.errors.of_run(scene, traits, change, len(self.scenes))
            self._errors.append((shift, errors + covariance(scene, found, run, gusts)))

    def joint(self, swing: Swing | None) -> Joint:
        """The runs together, whitened for what was answered last, and for a swing where there is one, beside that which
        plants have by themselves."""
        return self._whitened([one for one in (swing, self.known.swing) if one is not None])

    def left_without_swing(self, found: Found) -> float:
        """What would be left if plants did not swing by themselves, see :attr:`.joint.Found.left`."""
        return self._whitened([]).fit(started(found)).left

    def _whitened(self, swings: Sequence[Swing]) -> Joint:
        runs = []
        for scene, answers, (shift, errors) in zip(self.scenes, self._answers, self._errors, strict=True):
            besides = sum((chance.of_swing(scene, answers, one) for one in swings), errors)
            parts = chance.covariances(scene, answers)
            runs.append(ready(scene, self.known.base, parts, together=len(self.scenes), besides=besides, shift=shift))
        return Joint(runs, self.known.base)

    def _in_gusts(self, joint: Joint, before: Found, tried: Tried) -> Tried:
        """A draught as a wind that comes and goes, where more speaks for that."""
        for form in draught.WINDS:
            fit = tried.found
            if fit is None or fit.hypothesis.causes[-1].form != form or not fit.jacobians:
                look = search.best_start(joint, before, Cause(tried.effect, form))
                fit = search.fitted(joint, before, look)
            if np.isfinite(fit.evidence) and _is_worth_a_name(fit):
                steady, gusts = tried_on(before, tried.effect, fit), best_gusts(joint, self.scenes, self._answers, fit)
                wind = replace(steady, gain=steady.gain + gusts.evidence, gusts=gusts)
                tried = max(wind, tried, key=lambda one: one.gain)
        return tried

    def _has_no_name(self, stage: Stage) -> bool:
        return stage.has_no_name(self.claims.nameless, self.claims.better)

    def _unnamed(self, joint: Joint, found: Found, swing: Swing | None) -> Unnamed:
        swings = [one.period_h for one in (swing, self.known.swing) if one is not None]
        return unnamed(joint, found, self.scenes, self._answers, self.known.pushes, swings)

    def _leaves_much(self, stage: Stage) -> bool:
        """Whether no cause but a swing, which explains no hour's mean, makes the runs anything like healthy ones."""
        best = next((t.found for t in stage.tried if t.found is not None and t.found.residuals), stage.before)
        return self._is_much(best)

    def _is_much(self, fit: Found) -> bool:
        return bool(fit.left > _MUCH * self.known.left[:, 0].mean())

    @staticmethod
    def _again(joint: Joint, stage: Stage, is_lost: Callable[[Found], bool]) -> Stage:
        """Causes that may have lost their way, from typical plants: those of which no strength explains as much as
        nothing does, or those that can bend plants so far that the null was not found."""
        tried = []
        for one in stage.tried:
            is_tried = one.found is not None and is_lost(one.found)
            other = search.from_typical(joint, stage.before, one.effect) if is_tried else None
            again = tried_on(stage.before, one.effect, other) if other is not None else one
            tried.append(again if again.gain > one.gain else one)
        return replace(stage, tried=tuple(sorted(tried, key=lambda t: -t.gain)))

    def _faster(self, before: Found, after: Tried) -> float:
        """Nats by which fast errors are more probable with one cause more than before it."""
        assert after.found is not None
        gusts = self._gusts if after.gusts == CALM else after.gusts
        total = 0.0
        for i, scene in enumerate(self.scenes):
            for found, own, sign in ((before, self._gusts, 1.0), (after.found, gusts, -1.0)):
                total += sign * rhythm.improbability(*self._fast(scene, found, i, own))
        return total

    def _fast(self, scene: Scene, found: Found, run: int, gusts: Gusts) -> tuple[Spectrum, Array]:
        """The spectrum of what a fit leaves of a run's tip, and its expectations where nothing swings, shape (4, n)."""
        rest, moved = spectra_of(scene, found, run)
        return rest, self.known.swings.expectations(moved) + power(scene, found, run, rest, gusts)

    @staticmethod
    def _restarted(joint: Joint, stage: Stage) -> Found:
        fits = (t.found for t in stage.tried if t.found is not None and t.found.jacobians)
        best = max(fits, key=lambda fit: fit.evidence, default=None)
        if best is None:
            return stage.before
        again = Found(stage.before.hypothesis, stage.before.coordinates.copy(), best.traits.copy(), best.start.copy())
        return joint.fit(again)

    def _may_be(self, effect: Effect) -> bool:
        return effect.name != "temperature_growth" or any(scene.has_temperature for scene in self.scenes)


def tried_on(before: Found, effect: Effect, fit: Found) -> Tried:
    """A cause on top of others; one that is too small to be worth a name gains nothing."""
    gain = evidence_for_last(before, fit)
    return Tried(effect, gain if _is_worth_a_name(fit) else min(gain, 0.0), fit)


def _is_worth_a_name(fit: Found) -> bool:
    """Whether the last cause of a fit is large enough to matter."""
    values = fit.values()[-1]
    return all(p.is_worth_a_name(values[p.name]) for p in fit.hypothesis.causes[-1].effect.parameters)


def started(found: Found) -> Found:
    """A fit to begin another one from, without what holds for its own runs alone."""
    return replace(found, residuals=[], jacobians=[])
