"""How much better each cause of the catalogue explains some runs than what explains them so far."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose.hypothesis import Cause, Hypothesis
from flora_lab.diagnose.joint import STEPS, Found, Joint
from flora_lab.effects.effect import Effect, Parameter

_STEPS: Final = 10
FULLY: Final = 7
"""Effects that are fitted in full, at least: those that come to most where all is taken for linear."""
_LOST: Final = 10.0
"""Nats below what there was before, at which a fit has lost its way."""
_NEARLY: Final = 0.4
"""An effect that comes to more than this share of the best one's gain there is fitted in full too."""


def best_of_each(
    joint: Joint, before: Found, effects: Sequence[Effect], on_effect: Callable[[], None] = lambda: None
) -> list[tuple[Effect, Found]]:
    """Each effect in its best form, on top of what explains the runs so far.

    Args:
        joint: the runs.
        before: the explanation without another cause, fitted.
        effects: to be tried.
        on_effect: told that one is done.

    Returns:
        Effect and fit, in no order; those that came to little where all was taken for linear are only that far.
    """
    looks = {effect.name: [best_start(joint, before, cause) for cause in forms_of(effect)] for effect in effects}
    gains = {name: max(found.evidence for found in forms) - before.evidence for name, forms in looks.items()}
    ranked = sorted(effects, key=lambda effect: -gains[effect.name])
    out = []
    for place, effect in enumerate(ranked):
        forms = looks[effect.name]
        if place < FULLY or gains[effect.name] > _NEARLY * gains[ranked[0].name]:
            forms = [fitted(joint, before, found, _STEPS) for found in forms]
        out.append((effect, max(forms, key=lambda found: found.evidence)))
        on_effect()
    return out


def fitted(joint: Joint, before: Found, look: Found, steps: int = STEPS) -> Found:
    """The fit from where all is taken for linear; once more from where there is no effect, if that was too far off.

    A cause more cannot explain less, but for what its being one more costs.
    """
    fit = joint.fit(look, steps)
    if fit.evidence > before.evidence - _LOST:
        return fit
    last = look.hypothesis.causes[-1].parameters
    kinds = look.coordinates[len(before.coordinates) :]
    none = [own if p.none is None else p.centre for p, own in zip(last, kinds, strict=True)]
    still = Found(look.hypothesis, np.append(before.coordinates, none), before.traits.copy(), before.start.copy())
    return max(fit, joint.fit(still, steps), key=lambda found: found.evidence)


def best_start(joint: Joint, before: Found, cause: Cause) -> Found:
    """Where the best of a cause's starts leads, where all is taken for linear."""
    looks = [joint.screened(before, cause, start) for start in _starts(cause.parameters)]
    return max(looks, key=lambda found: found.evidence)


def from_typical(joint: Joint, before: Found, effect: Effect) -> Found | None:
    """The best form of an effect that is there at its starts, if all plants are typical to begin with.

    What is very wrong with the runs was laid upon their plants before; from there a strong cause may not be found. None
    where the effect tells no start.
    """
    if not any(p.starts for p in effect.parameters):
        return None
    typical = joint.null()
    fits = [
        joint.fit(
            Found(
                Hypothesis((*before.hypothesis.causes, cause)),
                np.concatenate([before.coordinates, start]),
                typical.traits.copy(),
                typical.start.copy(),
            ),
            _STEPS,
        )
        for cause in forms_of(effect)
        for start in _starts(cause.parameters)
    ]
    return max(fits, key=lambda found: found.evidence)


def forms_of(effect: Effect) -> Iterator[Cause]:
    """The effect in each of its forms."""
    return (Cause(effect, form) for form in range(len(effect.forms)))


def _starts(parameters: Sequence[Parameter]) -> Iterator[Array]:
    """Coordinates from which to set out: every combination of the starts told, and no effect of every kind.

    From no effect what only changes a plant's constants is found at once, since there all is linear; from far away what
    is not.
    """
    told = []
    for p in parameters:
        starts = [p.coordinate(value) for value in p.starts]
        told.append(starts if starts and p.none is None else [*starts, p.centre])
    for chosen in itertools.product(*told):
        yield np.array(chosen)
