"""How much better each cause of the catalogue explains some runs than the simulator as it is."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.diagnose.joint import Cause, Found, Hypothesis, Joint
from flora_lab.effects.effect import Effect, Parameter

Array = npt.NDArray[Any]

_FIRST: Final = 2
_THEN: Final = 8
"""Steps of every start, and of the best one of them."""


def forms_of(effect: Effect) -> Iterator[Cause]:
    """The effect in each of its forms."""
    return (Cause(effect, form) for form in range(len(effect.forms)))


def with_cause(joint: Joint, before: Found, cause: Cause) -> Found:
    """The best explanation with one cause more, from all its starts.

    Args:
        joint: the runs.
        before: the explanation without it.
        cause: which.
    """
    hypothesis = Hypothesis((*before.hypothesis.causes, cause))
    tried = [
        joint.fit(Found(hypothesis, np.concatenate([before.coordinates, own]), before.traits, before.start), _FIRST)
        for own in _starts(cause.parameters)
    ]
    best = max(tried, key=lambda found: found.evidence)
    return joint.fit(Found(hypothesis, best.coordinates, best.traits, best.start), _THEN)


def _starts(parameters: Sequence[Parameter]) -> Iterator[Array]:
    """Coordinates from which to set out: where there is no effect, and every combination of the starts told."""
    told = [[p.coordinate(value) for value in p.starts] or [p.centre] for p in parameters]
    return (np.array(chosen) for chosen in itertools.product(*told))
