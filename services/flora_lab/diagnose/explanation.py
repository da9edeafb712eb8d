"""What a search for causes comes to: those tried at each step, those taken, and what explains the runs in the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from flora_common.arrays import Array
from flora_lab.diagnose.gusts import CALM, Gusts
from flora_lab.diagnose.joint import Found, Joint
from flora_lab.diagnose.nameless import Unnamed
from flora_lab.diagnose.rhythm import Swing
from flora_lab.effects.effect import Effect

FIRST: Final = 3.0
"""Nats of evidence that the first cause needs, and any to be kept beside others; some need more where they come first
(:attr:`flora_lab.effects.effect.Effect.first_needs`). Weak effects have 3 to 4, which healthy runs hardly ever show for
the others (docs/results/discovery-history.md)."""
SECOND: Final = 2.0
"""Nats that the second one needs: where one is at work, another is no surprise. Of those with 2 to 4 nats about every
second one is there, and its confidence says so."""
THIRD: Final = 4.0
"""The same of a third one."""
SWING: Final = "circumnutation"


@dataclass(frozen=True, slots=True)
class Tried:
    """A cause on top of others.

    Attributes:
        effect: which.
        gain: evidence beyond that without it, nats, with what was known of the effect before.
        found: the fit, with the cause as its last; None for a swing, which is no part of it.
        swing: for a swing.
        gusts: for a wind; their evidence is a part of ``gain``.
    """

    effect: Effect
    gain: float
    found: Found | None
    swing: Swing | None = None
    gusts: Gusts = CALM


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of the search: all causes tried on top of those chosen before.

    Attributes:
        before: the fit without another cause.
        tried: best first, each effect once, in its best form.
        unnamed: the best of what is no cause of the catalogue, on top of the same.
    """

    before: Found
    tried: tuple[Tried, ...]
    unnamed: Unnamed | None = None

    def has_no_name(self, least: float, better: float) -> bool:
        """Whether something that is no cause has that much evidence, and is that much better than any that is; nats."""
        return self.unnamed is not None and self.unnamed.gain > max(self.tried[0].gain + better, least)


@dataclass(frozen=True, slots=True)
class Accepted:
    """A cause that was taken, and among which others."""

    tried: Tried
    stage: Stage


@dataclass(frozen=True, slots=True)
class Explanation:
    """What explains the runs best.

    Attributes:
        null: the simulator as it is.
        found: with all causes.
        swing: of the tip, where one was found.
        stages: how it was come to.
        accepted: the causes that were taken and kept.
        joint: the runs, as they were whitened at the end.
        claim: nats that the first cause had to have, or would have had to.
        unnamed: what is at work beside the causes, or in place of any; None where nothing seems to be.
        unswung: what is left without causes if plants did not swing by themselves, see :attr:`.joint.Found.left`; None
            where they do not.
    """

    null: Found
    found: Found
    swing: Swing | None
    stages: tuple[Stage, ...]
    accepted: tuple[Accepted, ...]
    joint: Joint
    claim: float = FIRST
    unnamed: Unnamed | None = None
    unswung: float | None = None

    @property
    def typical(self) -> Array:
        """Constants of the typical plant as these runs and the reference tell them together, shape (9,)."""
        return self.joint.base.mean_with(self.found.traits)

    @property
    def is_of_two(self) -> bool:
        """Whether the first cause is too little by itself, and was taken together with the second."""
        return len(self.accepted) > 1 and self.stages[0].tried[0].gain < self.claim

    @property
    def dropped(self) -> tuple[str, ...]:
        """Effects that were taken before others made them worthless, in this order."""
        kept = {one.tried.effect.name for one in self.accepted}
        taken = dict.fromkeys(stage.tried[0].effect.name for stage in self.stages[:-1])
        return tuple(name for name in taken if name not in kept)

    @property
    def nearest(self) -> Tried | None:
        """Where no cause was taken, the one for which most speaks; None where nothing speaks for any."""
        best = self.stages[0].tried[0]
        return best if not self.accepted and best.gain > 0.0 else None
