"""From runs to causes: which effects, alone or together, explain what the simulator gets wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import chance, claims, clocks, rhythm, search
from flora_lab.diagnose.alone import side_by_side
from flora_lab.diagnose.explanation import SWING, Accepted, Explanation, Stage, Tried
from flora_lab.diagnose.gusts import CALM, Gusts, best_gusts, covariance, power
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import Found, Joint, evidence_for_last, ready
from flora_lab.diagnose.knowledge import Knowledge, spectra_of
from flora_lab.diagnose.rhythm import Spectrum, Swing
from flora_lab.diagnose.scene import Answers, Scene
from flora_lab.diagnose.unnamed import Unnamed, unnamed
from flora_lab.effects import draught
from flora_lab.effects.catalogue import BY_NAME, CATALOGUE
from flora_lab.effects.effect import Effect

_AS_GOOD: Final = 1.0
"""Nats within which the first cause may be another one, and needs what that one would."""
FORM: Final = 0.015
"""Share of the evidence for causes in the plant that one cause more needs besides: what is wrong in the form of these
looks like something else. A camera or a clock that is off has no form, and another constant has that of the law."""
_MOST_OF_FORM: Final = 10.0
"""Nats that this comes to at most."""
OF_A_SWING: Final = 0.0001
"""The same share of a swing's, which comes to thousands of nats: it drifts, and hourly means keep a little of it."""
MOST_CAUSES: Final = 3
BESIDE, BESIDE_A_SWING = 0.15, 0.01
"""Share of all evidence for causes that something beside them must come to: no cause is quite what nature does. A
swing's evidence is from minutes, and leaves nothing in the hours' means in which anything else shows."""
_MUCH: Final = 3.0
"""So many times what healthy runs leave is left where the plants themselves were not found."""
_RESTARTS: Final = 2


@dataclass(frozen=True, slots=True)
class _Reached:
    """Where a search has come to.

    Attributes:
        joint: the runs, whitened for what was found.
        found: the causes but for a swing, fitted.
        swing: of the tip, where it is one of the causes.
        gusts: of a wind, where one is among the causes.
        accepted: all causes, and how each was come to.
    """

    joint: Joint
    found: Found
    swing: Swing | None = None
    gusts: Gusts = CALM
    accepted: tuple[Accepted, ...] = ()


class Explainer:
    """Looks for causes.

    Args:
        scenes: the measured runs.
        known: what the reference tells.
        on_search: told how many causes are tried next, on top of those found; what it gives is called after each.

    Attributes:
        scenes: the runs as they are compared; their ends may be left out.
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

    def explain(self) -> Explanation:
        """The causes, one after another while they are worth it; one that a later one makes worthless is dropped."""
        alone, joint, null = self._begun()
        cut = clocks.cut_to_known_lamps(joint, null, self.claims.first)
        if cut is not None:
            self.scenes = cut
            alone, joint, null = self._begun()
        reached = _Reached(joint, null)
        stages: list[Stage] = []
        while len(stages) <= MOST_CAUSES:
            stage = self._settled(reached.joint, reached.found, reached.swing, _RESTARTS if not stages else 1)
            reached = replace(reached, found=stage.before)
            stage, further = self._further(reached, stage)
            stages.append(stage)
            if further is None:
                break
            reached = further
        joint, swing, accepted = reached.joint, reached.swing, reached.accepted
        null = stages[0].before if swing is None else joint.fit(alone)
        beside = self._beside(stages[-1], accepted)
        first = self._needed(stages[0], ())
        return Explanation(null, reached.found, swing, tuple(stages), accepted, joint, first, beside)

    def _is_worth_taking(self, stage: Stage, accepted: Sequence[Accepted]) -> bool:
        """Whether the best cause of a stage is one."""
        if len(accepted) == MOST_CAUSES:
            return False
        return stage.tried[0].gain >= self._needed(stage, accepted) and not self._is_outdone(stage, accepted)

    def _further(self, reached: _Reached, stage: Stage) -> tuple[Stage, _Reached | None]:
        """The stage with what its causes come to where they were weighed, and what the first that is worth it leads to.

        Each is weighed once: one that displaces others may be asked for more than it was chosen by.
        """
        weighed: set[str] = set()
        while self._is_worth_taking(stage, reached.accepted) and stage.tried[0].effect.name not in weighed:
            weighed.add(stage.tried[0].effect.name)
            taken = self._with_the_best(reached, stage)
            if isinstance(taken, _Reached):
                return stage, taken
            stage = taken
        return stage, None

    def _with_the_best(self, reached: _Reached, stage: Stage) -> _Reached | Stage:
        """With the best cause of a stage besides; where it comes to too little about the plants that have it, that
        stage with what it does come to."""
        best, swing = stage.tried[0], reached.swing
        accepted = [*reached.accepted, Accepted(best, stage)]
        if best.swing is not None:
            joint = self._joint(best.swing)
            found = self._pruned(joint, joint.fit(_started(reached.found)), accepted)
            return _Reached(joint, found, best.swing, reached.gusts, tuple(accepted))
        assert best.found is not None
        found = self._pruned(reached.joint, best.found, accepted)
        gusts = reached.gusts if best.gusts == CALM else best.gusts
        self._answer(found, gusts)
        if swing is not None and self._swing(found).gain < self.claims.first:
            # What seemed to swing was this cause.
            swing = None
            accepted = [one for one in accepted if one.tried.swing is None]
        joint = self._joint(swing)
        found = joint.fit(_started(found))
        # With what chance does about it, it may be next to nothing, and what it made worthless is not.
        of_push = _tried(joint.fit(_without(found, best.effect.name)), best.effect, found).gain
        about_itself = of_push + best.gusts.evidence
        if about_itself >= self._least(best.effect, len(accepted) - 1):
            return _Reached(joint, found, swing, gusts, tuple(accepted))
        less = replace(best, gain=min(best.gain, about_itself))
        return replace(stage, tried=tuple(sorted((less, *stage.tried[1:]), key=lambda one: -one.gain)))

    def _least(self, effect: Effect, others: int) -> float:
        """Nats that a cause beside so many others must keep about the plants that have it."""
        return self.claims.causes[others] + (0.0 if others else min(0.0, effect.first_needs))

    def first_stage(self) -> Stage:
        """All causes on top of none."""
        _, joint, null = self._begun()
        return self._settled(joint, null, None, _RESTARTS)

    def _begun(self) -> tuple[Found, Joint, Found]:
        """Each run by itself, all together, and how they are without a cause."""
        alone = side_by_side(self.scenes, self.known.base)
        self._answer(alone, CALM)
        joint = self._joint(None)
        null = joint.fit(alone)
        if self._is_much(null):
            # What is very wrong with the runs may have led each of them far astray.
            null = max(null, joint.fit(joint.null()), key=lambda fit: fit.evidence)
        return alone, joint, null

    def _settled(self, joint: Joint, before: Found, swing: Swing | None, restarts: int) -> Stage:
        """One step, once the plants are found: what many causes seem to explain may be plants that were not, and so
        these are looked for again from the winner's."""
        stage = self.stage(joint, before, swing)
        for _ in range(restarts):
            better = self._restarted(joint, stage)
            if better.evidence < stage.before.evidence + 1.0:
                break
            stage = self.stage(joint, better, swing)
        return stage

    def _needed(self, stage: Stage, accepted: Sequence[Accepted]) -> float:
        """Nats that the best cause of a stage must have, on top of those accepted."""
        if not accepted:
            as_good = stage.tried[0].gain - _AS_GOOD
            best = (one.effect for one in stage.tried if one.gain >= as_good)
            return max(self.claims.of(one.name, 0) + one.first_needs for one in best)
        formed = [one.tried for one in accepted if _has_form(one.tried.effect)]
        wrong = sum((FORM if tried.swing is None else OF_A_SWING) * tried.gain for tried in formed)
        return self.claims.of(stage.tried[0].effect.name, len(accepted)) + min(wrong, _MOST_OF_FORM)

    def _is_outdone(self, stage: Stage, accepted: Sequence[Accepted]) -> bool:
        """Whether something without a name comes before the best cause.

        Beside causes with much evidence it may be too little to be told: then a cause is named nevertheless that has as
        much as it takes to be told without a name.
        """
        is_told = self._has_no_name(stage, self._told_from(accepted))
        return is_told or (self._has_no_name(stage) and stage.tried[0].gain < self.claims.nameless)

    def _has_no_name(self, stage: Stage, least: float | None = None) -> bool:
        return stage.has_no_name(self.claims.nameless if least is None else least, self.claims.better)

    def _beside(self, last: Stage, accepted: Sequence[Accepted]) -> Unnamed | None:
        """What is at work beside the causes, if it is worth a word."""
        is_alone = not accepted and last.tried[0].gain < claims.NEXT_TO_NOTHING
        least = self.claims.nameless_alone if is_alone else self._told_from(accepted)
        return last.unnamed if last.unnamed is not None and last.unnamed.gain > least else None

    def _told_from(self, accepted: Sequence[Accepted]) -> float:
        """Nats from which something without a name is told beside causes."""
        shares = (BESIDE if one.tried.swing is None else BESIDE_A_SWING for one in accepted)
        return max(self.claims.nameless, sum(s * one.tried.gain for s, one in zip(shares, accepted, strict=True)))

    def _pruned(self, joint: Joint, found: Found, accepted: list[Accepted]) -> Found:
        """Without the causes that the last one has made worthless; ``accepted`` is changed."""
        for earlier in [a for a in accepted[:-1] if a.tried.found is not None]:
            name = earlier.tried.effect.name
            less = joint.fit(_without(found, name))
            if found.evidence - less.evidence + earlier.tried.gusts.evidence >= self.claims.first:
                continue
            found = less
            accepted.remove(earlier)
            last = accepted[-1].tried.effect.name
            again = next((t for t in earlier.stage.tried if t.effect.name == last), None)
            if again is not None and again.found is not None and again.gain >= self.claims.first:
                # It was compared with the dropped one there: that is where its rivals are.
                rest = (t for t in earlier.stage.tried if t is not again)
                accepted[-1] = Accepted(again, Stage(earlier.stage.before, (again, *rest)))
        return found

    def stage(self, joint: Joint, before: Found, swing: Swing | None) -> Stage:
        """All causes that are not yet in, on top of those that are, best first."""
        there = set(before.hypothesis.names())
        tried: list[Tried] = []
        effects = [e for e in CATALOGUE if e.forms and e.name != SWING and e.name not in there and self._may_be(e)]
        for effect, fit in search.best_of_each(joint, before, effects, self._on_search(len(effects))):
            tried.append(_tried(before, effect, fit))
        tried.sort(key=lambda t: -t.gain)
        while tried and tried[0].found is not None and not tried[0].found.jacobians:
            # Only looked at linearly so far.
            effect, fit = tried[0].effect, search.fitted(joint, before, tried[0].found)
            tried[0] = _tried(before, effect, fit)
            tried.sort(key=lambda t: -t.gain)
        tried = [self._in_gusts(joint, before, one) if one.effect is draught.EFFECT else one for one in tried]
        tried.sort(key=lambda t: -t.gain)
        beside: tuple[Joint, Found] | None = None
        if swing is None:
            own = self._swing(before)
            if own.gain > 0.0 and own.swing is not None:
                swinging = self._joint(own.swing)
                beside = swinging, swinging.fit(_started(before))
                # A swing explains something of the hours' means, too, and a cause may make fast errors vanish.
                slower = swinging.probability(beside[1]) - joint.probability(before)
                faster = max((t.gain + self._faster(before, t) for t in tried[:3] if t.found is not None), default=0.0)
                own = replace(own, gain=own.gain + max(0.0, slower))
                tried.insert(0 if own.gain > faster else 1, own)
        found = Stage(before, tuple(tried), self._unnamed(joint, before))
        if beside is not None and found.tried[0].swing is not None and self._has_no_name(found):
            # Hours' means keep some of a slow swing, which has no name as long as it is not known for what it is.
            found = replace(found, unnamed=self._unnamed(*beside))
        if swing is not None or before.hypothesis.causes:
            return found
        if self._has_no_name(found):
            return self._again(joint, found, lambda one: one.misfit > before.misfit + 1.0)
        if self._leaves_much(found):
            return self._again(joint, found, lambda one: one.hypothesis.causes[-1].effect.is_strong)
        return found

    def _in_gusts(self, joint: Joint, before: Found, tried: Tried) -> Tried:
        """A draught as a wind that comes and goes, where more speaks for that."""
        for form in draught.WINDS:
            fit = tried.found
            if fit is None or fit.hypothesis.causes[-1].form != form or not fit.jacobians:
                look = search.best_start(joint, before, Cause(tried.effect, form))
                fit = search.fitted(joint, before, look)
            if np.isfinite(fit.evidence) and _is_worth_a_name(fit):
                steady, gusts = _tried(before, tried.effect, fit), best_gusts(joint, self.scenes, self._answers, fit)
                wind = replace(steady, gain=steady.gain + gusts.evidence, gusts=gusts)
                tried = max(wind, tried, key=lambda one: one.gain)
        return tried

    def _unnamed(self, joint: Joint, found: Found) -> Unnamed:
        return unnamed(joint, found, self.scenes, self._answers, self.known.pushes)

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
            again = _tried(stage.before, one.effect, other) if other is not None else one
            tried.append(again if again.gain > one.gain else one)
        return replace(stage, tried=tuple(sorted(tried, key=lambda t: -t.gain)))

    def _swing(self, before: Found) -> Tried:
        """The best swing of the tip in what a fit leaves."""
        fast = (self._fast(scene, before, i, self._gusts) for i, scene in enumerate(self.scenes))
        left, expected = zip(*fast, strict=True)
        swing = rhythm.best_swing(left, expected, [scene.sideways for scene in self.scenes])
        usual = float(np.mean(np.maximum(np.sort(self.known.swing_evidence)[:-1], 0.0))) * len(self.scenes)
        gain = swing.evidence - usual if rhythm.is_plausible(swing) else 0.0
        return Tried(BY_NAME[SWING], gain, None, swing)

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

    def _answer(self, found: Found, gusts: Gusts) -> None:
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

    def _joint(self, swing: Swing | None) -> Joint:
        runs = []
        for scene, answers, (shift, errors) in zip(self.scenes, self._answers, self._errors, strict=True):
            besides = errors if swing is None else errors + chance.of_swing(scene, answers, swing)
            parts = chance.covariances(scene, answers)
            runs.append(ready(scene, self.known.base, parts, together=len(self.scenes), besides=besides, shift=shift))
        return Joint(runs, self.known.base)


def _tried(before: Found, effect: Effect, fit: Found) -> Tried:
    """A cause on top of others; one that is too small to be worth a name gains nothing."""
    gain = evidence_for_last(before, fit)
    return Tried(effect, gain if _is_worth_a_name(fit) else min(gain, 0.0), fit)


def _is_worth_a_name(fit: Found) -> bool:
    """Whether the last cause of a fit is large enough to matter."""
    values = fit.values()[-1]
    return all(p.is_worth_a_name(values[p.name]) for p in fit.hypothesis.causes[-1].effect.parameters)


def _has_form(effect: Effect) -> bool:
    """Whether nature may do it otherwise than our term does."""
    return effect.where == "plant" and not effect.is_of_constants


def _without(found: Found, name: str) -> Found:
    """The same start without one of the causes."""
    hypothesis = found.hypothesis
    shares = zip(hypothesis.causes, hypothesis.shares(found.coordinates), strict=True)
    kept = [(cause, own) for cause, own in shares if cause.effect.name != name]
    joined = np.concatenate([np.zeros(0), *(own for _, own in kept)])
    return Found(Hypothesis(tuple(cause for cause, _ in kept)), joined, found.traits.copy(), found.start.copy())


def _started(found: Found) -> Found:
    return replace(found, residuals=[], jacobians=[])
