"""What a named effect is: its parameters, and what it changes in the model of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

import numpy as np

from flora_common.arrays import Array
from flora_lab.simulator.terms import NEUTRAL
from flora_lab.simulator.tropism_traits import NAMES

Values = Mapping[str, float]
Where = Literal["plant", "camera", "clock", "simulator"]

_FAR_END: Final = 2.0
"""Standard deviations of what is plausible between no effect and the far end of that."""
_NEXT_TO_NOTHING: Final = 0.01
"""In standard deviations of what is plausible: with so little of an effect, something else has done what it seems."""

RUN_H: Final = 72.0
"""The length of a run that parameters given "over the run" refer to."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: with its unit, where it has one.
        none: the value at which there is no effect; None for a number that only says what kind of effect it is.
        low, high: what is plausible.
        scale: ``log`` for factors and times, ``linear``, or ``day`` for hours on a clock of 24.
        meaning: in a few words.
        source: of the range.
        starts: values from which a search sets out, where ``none`` will not do.
        least: how far from ``none`` a value must be to be worth a name. Of what shows strongly in every run, so little
            is within what no law is right to.
        usual: what it is where an extension does not tell it; None for a number that must be told.
        most: what a simulator is extended with at most, where more may be found than a search would reach.
    """

    name: str
    none: float | None
    low: float
    high: float
    scale: Literal["log", "linear", "day"]
    meaning: str
    source: str
    starts: tuple[float, ...] = ()
    least: float = 0.0
    usual: float | None = None
    most: float | None = None

    def coordinate(self, value: float) -> float:
        """In which the search moves: the logarithm on a ``log`` scale."""
        return float(np.log(value)) if self.scale == "log" else value

    def value(self, coordinate: float) -> float:
        """Undo :meth:`coordinate`."""
        return float(np.exp(coordinate)) if self.scale == "log" else coordinate

    @property
    def reach(self) -> tuple[float, float]:
        """Coordinates between which it is searched: some way beyond what is plausible, but never to the other side of
        where there is no effect, if all that is plausible lies on one."""
        low, high = self.coordinate(self.low), self.coordinate(self.high)
        if self.is_cyclic:
            return -math.inf, math.inf
        if self.none is None:
            room = 0.1 * (high - low)
            return low - room, high + room
        none, room = self.coordinate(self.none), 0.6 * (high - low)
        return (none if none <= low else low - room), (none if none >= high else high + room)

    @property
    def taken(self) -> tuple[float, float]:
        """Values between which a simulator may be extended: twice the plausible range, about its middle, or as far as
        is searched, where that is farther."""
        low, high = self.coordinate(self.low), self.coordinate(self.high)
        room = 0.5 * (high - low)
        ends = (low - room, high + room) if self.is_cyclic else self.reach
        most = self.value(max(high + room, ends[1]))
        return self.value(min(low - room, ends[0])), most if self.most is None else max(most, self.most)

    def is_worth_a_name(self, value: float) -> bool:
        """Whether a value is so far from none that it matters."""
        if self.none is None:
            return True
        away = abs(self.coordinate(value) - self.centre)
        return abs(value - self.none) >= self.least and away > _NEXT_TO_NOTHING * self.spread

    def is_plausible(self, value: float) -> bool:
        """Whether a value lies no farther from none than the far end of what is plausible."""
        away = abs(self.coordinate(value) - self.centre)
        return self.none is None or away <= _FAR_END * self.spread

    @property
    def centre(self) -> float:
        """Coordinate about which it is expected: where there is no effect, or the middle of the range."""
        if self.none is not None:
            return self.coordinate(self.none)
        return 0.5 * (self.coordinate(self.low) + self.coordinate(self.high))

    @property
    def is_cyclic(self) -> bool:
        """Whether all values are as likely before any data, since none is the first or the last."""
        return self.scale == "day"

    @property
    def spread(self) -> float:
        """Standard deviation of the coordinate before any data: the far end of the range lies two of them away. Of what
        is cyclic, that of a normal density that is as high as the even one."""
        if self.is_cyclic:
            return (self.high - self.low) / math.sqrt(2.0 * math.pi)
        ends = (abs(self.coordinate(self.low) - self.centre), abs(self.coordinate(self.high) - self.centre))
        return max(ends) / _FAR_END


class Push(Protocol):
    """What drives the law along a course that each run tells for itself: see :mod:`flora_lab.diagnose.courses`."""

    @property
    def drive(self) -> str:
        """Of the law."""

    @property
    def course(self) -> Any:
        """What it follows."""

    def along(self, columns: Array) -> Array:
        """What it adds to the drive, shape (k,), where the course is ``columns``, shape (k, columns)."""


@dataclass(slots=True)
class Change:
    """What effects change in the model of a run; as made, nothing.

    Attributes:
        traits: added to the logarithms of the plant's constants, shape (9,).
        terms: see :mod:`flora_lab.simulator.terms`, shape (26,).
        turn_deg: of the camera, positive when stems look as if they leant more to the right.
        drift_deg: the same, growing from 0 to this over 72 h.
        scale: centimetres that the camera takes one for.
        late_h: by how much the record of the lamps runs before what they did.
        late_per_h: by how much more with each hour.
        rhythm_cm: amplitude of the tip's own swing.
        rhythm_h: its period.
        pushes: on the law's drives, of what is no term of it.
    """

    traits: Array = field(default_factory=lambda: np.zeros(len(NAMES)))
    terms: Array = field(default_factory=NEUTRAL.copy)
    turn_deg: float = 0.0
    drift_deg: float = 0.0
    scale: float = 1.0
    late_h: float = 0.0
    late_per_h: float = 0.0
    rhythm_cm: float = 0.0
    rhythm_h: float = 1.64
    pushes: tuple[Push, ...] = ()

    def times(self, trait: str, factor: float) -> None:
        """Multiply one of the plant's constants."""
        self.traits[NAMES.index(trait)] += np.log(factor)

    def turned_rad(self, time_h: Array) -> Array:
        """How far pictures are turned at some times since the start of the run, h."""
        return np.asarray(np.radians(self.turn_deg + self.drift_deg * time_h / RUN_H))

    def is_but_for_traits(self, other: Change) -> bool:
        """Whether it is the same as another one, whatever both do to the plant's constants."""
        mine, its = (
            (c.turn_deg, c.drift_deg, c.scale, c.late_h, c.late_per_h, c.rhythm_cm, c.rhythm_h, c.pushes)
            for c in (self, other)
        )
        return mine == its and bool(np.array_equal(self.terms, other.terms))


@dataclass(frozen=True, slots=True)
class Effect:
    """A cause with a name.

    Attributes:
        name: as in ``diagnosis.json``.
        title: for people.
        where: what it is an effect of: the plant, or the record of it.
        parameters: what it has.
        forms: ways in which nature may do it; each writes its change. The data choose between them.
        same_as: effects that track and light hardly tell from it, or not at all, with what would.
        exactly: those of them that are the same in every light, to the last digit.
        sentence: what it means, given its values.
        prior: how much more often it is met than another one, before any data.
        first_needs: nats that it needs besides where it is the first cause, read off healthy plants
            (docs/results/discovery-history.md): some look a little like it where they grow by another law than ours.
            Negative where none ever does.
    """

    name: str
    title: str
    where: Where
    parameters: tuple[Parameter, ...]
    forms: tuple[Callable[[Change, Values], None], ...]
    sentence: Callable[[Values], str]
    same_as: Mapping[str, str] = field(default_factory=dict)
    exactly: frozenset[str] = frozenset()
    prior: float = 1.0
    first_needs: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def with_usual(self, values: Values) -> Values:
        """Values of the parameters, those that are not told as usual."""
        return {**{p.name: p.usual for p in self.parameters if p.usual is not None}, **values}

    @property
    def is_of_the_record(self) -> bool:
        """Whether it is in the pictures or the clocks, so that the data are corrected for it and no simulator is."""
        return self.where in ("camera", "clock")

    @property
    def is_of_constants(self) -> bool:
        """Whether it is but another value of constants in which plants differ anyway."""
        change = Change()
        self.forms[0](change, {p.name: p.high for p in self.parameters})
        return self.where == "plant" and change.is_but_for_traits(Change())

    @property
    def is_strong(self) -> bool:
        """Whether it shows in every run so much that a little of it is not worth a name."""
        return any(parameter.least > 0.0 for parameter in self.parameters)


def is_same(one: Effect, other: Effect) -> bool:
    """Whether it takes more than light and track to tell two effects apart, or very much of them."""
    return other.name in one.same_as or one.name in other.same_as
