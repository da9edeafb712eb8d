"""What a simulator's own swing of the tip, by which it was extended, adds to what is usual of its plants.

How far a tip swings differs from plant to plant, and a simulator has one swing, so that none is looked for beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_lab.diagnose import residual_statistics as statistics
from flora_lab.diagnose import rhythm
from flora_lab.diagnose.knowledge import Knowledge
from flora_lab.diagnose.replayed import MM, PLANTS
from flora_lab.diagnose.residuals import SWING_PERIODS_H, ReferenceResiduals, Shown
from flora_lab.diagnose.rhythm import Spectrum, Swing
from flora_lab.effects import circumnutation
from flora_lab.simulator.store import Extension

_RUN_H: Final = 72.0
"""Length of the runs in whose spectra it is expected."""


def swing_of(extensions: Sequence[Extension], coherence_h: float) -> Swing | None:
    """The swing that some extensions add; None where they add none.

    Args:
        extensions: of a simulator.
        coherence_h: over which its swings keep their phase.
    """
    told = [one.parameters for one in extensions if one.effect == circumnutation.EFFECT.name]
    if not told:
        return None
    period_h, amplitude_cm = told[-1]["period_h"], told[-1]["amplitude_cm"]  # the last one takes the others' place
    return Swing(period_h, amplitude_cm, coherence_h, 0.0, (period_h, period_h), (amplitude_cm, amplitude_cm))


def with_swing(known: Knowledge, swing: Swing) -> Knowledge:
    """What is known of plants that swing besides."""
    grid = Spectrum(known.swings.per_hour, known.swings.power, _RUN_H)
    power = known.swings.power + rhythm.power_of(swing, grid)
    shown = _shown(known.residuals.shown, swing)
    return replace(
        known,
        swings=replace(known.swings, power=power),
        residuals=ReferenceResiduals(shown, known.residuals.misfit, swing),
        swing=swing,
    )


def _shown(shown: Shown, swing: Swing) -> Shown:
    """What reference runs would leave, if their plants swung."""
    grid = Spectrum(1.0 / SWING_PERIODS_H, np.zeros(len(SWING_PERIODS_H)), _RUN_H)
    density = rhythm.power_of(swing, grid)
    narrow_mm = MM * rhythm.amplitude_of(density * rhythm.LINES / _RUN_H)
    numbers = {plant: _numbers(shown.numbers[plant], swing.amplitude_cm) for plant in PLANTS}
    return replace(shown, numbers=numbers, swing_mm=np.hypot(shown.swing_mm, narrow_mm))


def _numbers(numbers: Array, amplitude_cm: float) -> Array:
    """With the swing's part in the size of all that is left, which is a logarithm of mm."""
    out, places = numbers.copy(), statistics.of_group("size")
    out[:, places] = 0.5 * np.log(np.exp(2.0 * out[:, places]) + 0.5 * (MM * amplitude_cm) ** 2)
    return out
