"""From named effects to a plant that has them: what a list of extensions changes in the mechanistic simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_common.shapes import STEM_POINTS
from flora_common.suggest import did_you_mean
from flora_lab.effects import catalogue, law_forms
from flora_lab.effects.effect import RUN_H, Change, Effect, Parameter
from flora_lab.simulator.drives import REFERENCE_CM, DriveNoise
from flora_lab.simulator.law import standing
from flora_lab.simulator.measured import STEP_S
from flora_lab.simulator.rod import EARLY_CM
from flora_lab.simulator.store import Extension
from flora_lab.simulator.terms import NEUTRAL, ExtendedLaw
from flora_lab.simulator.tropism import TropismLaw

TEMPERATURE: Final = "temperature_c"
"""The covariate that growth may follow."""
_SMALL_PER_CM_H: Final = 1e-4
"""A bias that stems answer linearly."""


def change_of(extensions: Sequence[Extension], where: str) -> Change:
    """What some extensions change, one after another.

    Args:
        extensions: none leave everything as it is.
        where: that they stand in, for errors.

    Raises:
        BadInput: an effect that has no name here, or is one of the record; a form that it has not; parameters that are
            missing, unknown, not finite, or far from anything plausible.
    """
    change = Change()
    for extension in extensions:
        effect = _effect_of(extension, where)
        effect.forms[extension.form](change, effect.with_usual(extension.parameters))
    return change


def _effect_of(extension: Extension, where: str) -> Effect:
    known: Mapping[str, Effect] = {**catalogue.BY_NAME, **law_forms.BY_NAME}
    effect = known.get(extension.effect)
    if effect is None:
        raise BadInput(f"{where}: no effect `{extension.effect[:40]}`{did_you_mean(extension.effect, known)}")
    told = f"{where}: effect `{effect.name}`"
    if effect.is_of_the_record:
        raise BadInput(f"{told} is one of the {effect.where}: correct the data for it; it is no part of a simulator")
    if not effect.forms:
        raise BadInput(f"{told} is what a learned simulator may lack; the mechanistic one has it anyway")
    if not 0 <= extension.form < len(effect.forms):
        raise BadInput(f"{told} has no form {extension.form}; it has 0 to {len(effect.forms) - 1}")
    for name in extension.parameters:
        if name not in effect.names:
            raise BadInput(f"{told} has no parameter `{name[:40]}`{did_you_mean(name, effect.names)}")
    values = effect.with_usual(extension.parameters)
    for parameter in effect.parameters:
        if parameter.name not in values:
            raise BadInput(f"{told} lacks its parameter `{parameter.name}`")
        value = values[parameter.name]
        if not _is_thinkable(parameter, value):
            low, high = parameter.taken
            raise BadInput(
                f"{told}: `{parameter.name}` is {value:g}; {parameter.low:g} to {parameter.high:g} are plausible, and "
                f"{low:.3g} to {high:.3g} are taken"
            )
    return effect


def _is_thinkable(parameter: Parameter, value: float) -> bool:
    """Whether a value has no effect, or is one with which a simulator may be extended."""
    low, high = parameter.taken
    return value == parameter.none or low <= value <= high


def law_of(lamps: LampsSection, change: Change) -> TropismLaw:
    """The law with what is changed in it; the plain one, which is a little faster, where that is nothing."""
    if np.array_equal(change.terms, NEUTRAL):
        return TropismLaw(lamps)
    return ExtendedLaw(lamps, change.terms)


def noise_of(noise: DriveNoise, change: Change, law: TropismLaw, typical: Array) -> DriveNoise:
    """What happens by chance, with a swing of the tip beside the one that is in it already; both have its period.

    Args:
        noise: without it.
        change: with the amplitude and period of the tip.
        law: of the plants.
        typical: traits of the typical one, shape (9,).
    """
    if change.rhythm_cm == 0.0:
        return noise
    added = abs(change.rhythm_cm) * np.sqrt(0.5) / _swing_cm(noise.nutation_exponent, change.rhythm_h, law, typical)
    both = float(np.hypot(noise.nutation_per_cm_h, added))
    return replace(noise, nutation_per_cm_h=both, nutation_period_min=60.0 * change.rhythm_h)


def _swing_cm(exponent: float, period_h: float, law: TropismLaw, typical: Array) -> float:
    """Amplitude of the typical plant's tip, per 1/(cm h) of its bias's amplitude at 20 cm.

    The bias grows with the stem, and so does the tip's answer: it is the root of the mean square over a run in the
    dark that begins with an upright seedling. Sine and cosine side by side give the amplitude at each time.
    """
    step_h = STEP_S / 3600.0
    steps = round(RUN_H / step_h)
    upright = np.zeros((1, STEM_POINTS, 2))
    upright[0, :, 1] = np.linspace(0.0, EARLY_CM, STEM_POINTS)
    still = _tips_cm(law, upright, typical, np.zeros((steps, 1)))
    # A stem that stands upright is as long as it is high; it grows the same when it bends.
    length_cm = np.concatenate([[EARLY_CM], still[:-1, 0, 1]])
    phase = 2.0 * np.pi * (np.arange(steps) + 0.5) * step_h / period_h
    size = _SMALL_PER_CM_H * (length_cm / REFERENCE_CM) ** exponent
    swinging = _tips_cm(law, upright, typical, np.stack([size * np.sin(phase), size * np.cos(phase)], axis=1))
    away_cm = swinging[:, :, 0] - still[:, :, 0]
    return float(np.sqrt(np.mean(np.sum(away_cm**2, axis=1)))) / _SMALL_PER_CM_H


def _tips_cm(law: TropismLaw, first_cm: Array, traits: Array, bias: Array) -> Array:
    """Tips of one plant in the dark under biases (steps, lanes), shape (steps, lanes, 2)."""
    steps, lanes = bias.shape
    out = np.empty((steps, lanes, STEM_POINTS, 2))
    stems, light = standing(law, first_cm).repeated(lanes), np.zeros((steps, lanes, 2))
    law.advance(
        stems, np.repeat(traits[None], lanes, axis=0), light, bias, np.ones((steps, lanes)), STEP_S / 3600.0, 1, out
    )
    return np.asarray(out[:, :, -1])
