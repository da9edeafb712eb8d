"""From runs to causes: which effects, alone or together, explain what the simulator gets wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from flora_lab.diagnose import clocks
from flora_lab.diagnose.claims import NEXT_TO_NOTHING, Claims
from flora_lab.diagnose.explanation import Accepted, Explanation, Stage
from flora_lab.diagnose.gusts import CALM, Gusts
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.rhythm import Swing
from flora_lab.diagnose.scene import Scene
from flora_lab.diagnose.trials import Trials, started, tried_on
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
        trials: of causes on these runs; their ends may be left out, see :attr:`Trials.scenes`.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        known: Knowledge,
        on_search: Callable[[int], Callable[[], None]] = lambda _: lambda: None,
    ) -> None:
        self.trials = Trials(scenes, known, on_search)

    @property
    def scenes(self) -> Sequence[Scene]:
        """The runs as they are compared."""
        return self.trials.scenes

    @property
    def claims(self) -> Claims:
        """How much evidence it takes."""
        return self.trials.claims

    def explain(self) -> Explanation:
        """The causes, one after another while they are worth it; one that a later one makes worthless is dropped."""
        alone, joint, null = self.trials.begun()
        cut = clocks.cut_to_known_lamps(joint, null, self.claims.first)
        if cut is not None:
            self.trials.scenes = cut
            alone, joint, null = self.trials.begun()
        reached = _Reached(joint, null)
        stages: list[Stage] = []
        unswung: float | None = None
        while len(stages) <= MOST_CAUSES:
            stage = self.trials.settled(reached.joint, reached.found, reached.swing)
            if not stages and self.trials.known.swing is not None:  # while the runs are whitened about this very fit
                unswung = self.trials.left_without_swing(stage.before)
            reached = replace(reached, found=stage.before)
            stage, further = self._further(reached, stage)
            stages.append(stage)
            two = self._two_at_once(reached, stage) if further is None else None
            if two is not None:
                stage, further = two
                stages.append(stage)
            if further is None:
                break
            reached = further
        joint, swing, accepted = reached.joint, reached.swing, reached.accepted
        null = stages[0].before if swing is None else joint.fit(alone)
        beside = self._beside(stages[-1], accepted)
        first = self._needed(stages[0], ())
        return Explanation(null, reached.found, swing, tuple(stages), accepted, joint, first, beside, unswung)

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

    def _two_at_once(self, reached: _Reached, stage: Stage) -> tuple[Stage, _Reached] | None:
        """Where the best first cause is too little by itself, and with a second one beside it both are as much as two
        must be: the second one's stage, and what both lead to; None where they are not.

        Args:
            reached: where the search has come to.
            stage: the first one, of which nothing was taken.
        """
        first = stage.tried[0]
        if reached.accepted or first.found is None or self._is_outdone(stage, ()):
            return None
        if not NEXT_TO_NOTHING <= first.gain < self._needed(stage, ()):  # with more it has been weighed already
            return None
        one = self._with_the_best(reached, stage)
        if not isinstance(one, _Reached):
            return None
        beside = self.trials.settled(one.joint, one.found, one.swing)
        asked = self._needed(stage, ()) + self._needed(beside, one.accepted)
        if first.gain + beside.tried[0].gain < asked:
            return None
        beside, both = self._further(replace(one, found=beside.before), beside)
        if both is None or len(both.accepted) < 2 or both.swing is not None:
            return None
        # What there is for the first one, and in its place, beside the second.
        again = self.trials.stage(both.joint, both.joint.fit(_without(both.found, first.effect.name)), None)
        if again.tried[0].effect is not first.effect or again.tried[0].gain < self._least(first.effect, 0):
            return None
        return beside, replace(both, accepted=(Accepted(again.tried[0], again), *both.accepted[1:]))

    def _with_the_best(self, reached: _Reached, stage: Stage) -> _Reached | Stage:
        """With the best cause of a stage besides; where it comes to too little about the plants that have it, that
        stage with what it does come to."""
        best, swing = stage.tried[0], reached.swing
        accepted = [*reached.accepted, Accepted(best, stage)]
        if best.swing is not None:
            joint = self.trials.joint(best.swing)
            found = self._pruned(joint, joint.fit(started(reached.found)), accepted)
            return _Reached(joint, found, best.swing, reached.gusts, tuple(accepted))
        assert best.found is not None
        found = self._pruned(reached.joint, best.found, accepted)
        gusts = reached.gusts if best.gusts == CALM else best.gusts
        self.trials.answer(found, gusts)
        if swing is not None and self.trials.swing(found).gain < self.claims.first:
            # What seemed to swing was this cause.
            swing = None
            accepted = [one for one in accepted if one.tried.swing is None]
        joint = self.trials.joint(swing)
        found = joint.fit(started(found))
        # With what chance does about it, it may be next to nothing, and what it made worthless is not.
        of_push = tried_on(joint.fit(_without(found, best.effect.name)), best.effect, found).gain
        about_itself = of_push + best.gusts.evidence
        if about_itself >= self._least(best.effect, len(accepted) - 1):
            return _Reached(joint, found, swing, gusts, tuple(accepted))
        less = replace(best, gain=min(best.gain, about_itself))
        return replace(stage, tried=tuple(sorted((less, *stage.tried[1:]), key=lambda one: -one.gain)))

    def _least(self, effect: Effect, others: int) -> float:
        """Nats that a cause beside so many others must keep about the plants that have it."""
        return self.claims.causes[others] + (0.0 if others else min(0.0, effect.first_needs))

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
        claims = self.claims
        is_told = stage.has_no_name(self._told_from(accepted), claims.better)
        hides_weak = stage.has_no_name(claims.nameless, claims.better)
        return is_told or (hides_weak and stage.tried[0].gain < claims.nameless)

    def _beside(self, last: Stage, accepted: Sequence[Accepted]) -> Unnamed | None:
        """What is at work beside the causes, if it is worth a word."""
        is_alone = not accepted and last.tried[0].gain < NEXT_TO_NOTHING
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
