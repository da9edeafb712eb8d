"""Directions in which the law itself may be wrong: those in which an effect would show.

Reference runs, in which nothing is taken to be wrong, still seem to show a little of every effect, because no law is
right in everything. How much they seem to show, on the mean and from run to run, is learned, and what another run
seems to show is only news beyond that.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.catalogue import BY_NAME
from flora_lab.effects.effect import Change, Effect, Parameter

Array = npt.NDArray[Any]

_SHOWN: Final[tuple[tuple[str, int, tuple[tuple[str, float], ...]], ...]] = (
    ("phototropic_latency", 0, ()),
    ("adaptation", 0, (("time_constant_h", 1.6),)),
    ("lamp_asymmetry", 0, ()),
    ("lamp_ageing", 0, ()),
    ("diurnal_growth", 0, (("peak_h", 0.0),)),
    ("diurnal_growth", 0, (("peak_h", 6.0),)),
    ("growth_rate", 1, ()),
    ("sag", 0, ()),
    ("draught", 0, ()),
    ("camera_roll", 0, ()),
    ("camera_scale", 0, ()),
    ("camera_drift", 0, ()),
    ("clock_skew", 0, ()),
)
"""Effect, form, and what its other parameters are. Effects that only change a plant's constants are left out: how
plants differ in these is known anyway."""
_STEP: Final = 0.25
"""Of the differences, in standard deviations of what is plausible."""
EXPECTED_SHARE: Final = 0.05
"""How wrong the law is expected to be before any data, in the same."""


@dataclass(frozen=True, slots=True)
class _Direction:
    effect: Effect
    form: int
    strength: str
    others: tuple[tuple[str, float], ...]

    @property
    def _parameter(self) -> Parameter:
        return next(p for p in self.effect.parameters if p.name == self.strength)

    def change(self, sds: float) -> Change:
        p = self._parameter
        change = Change()
        self.effect.forms[self.form](change, {**dict(self.others), self.strength: p.value(p.centre + sds * p.spread)})
        return change


@functools.cache
def _directions() -> tuple[_Direction, ...]:
    found = []
    for name, form, others in _SHOWN:
        effect = BY_NAME[name]
        strength = next(p.name for p in effect.parameters if p.none is not None)
        found.append(_Direction(effect, form, strength, others))
    return tuple(found)


def names() -> list[str]:
    """What each direction is called."""
    return [f"{d.effect.name}{''.join(f'_{value:g}' for _, value in d.others)}" for d in _directions()]


def expected_sizes() -> Array:
    """Shape (k,): in standard deviations of what is plausible for the effect."""
    return np.full(len(_directions()), EXPECTED_SHARE)


def directions(scene: Scene, traits: Array, start: Array) -> Array:
    """How the features of a run would change with one standard deviation of each effect, shape (m, k).

    Args:
        scene: the run.
        traits: of its plant, shape (9,).
        start: tilt and bow of its first stem, shape (2,).
    """
    one_sided = [d.effect.name == "phototropic_latency" for d in _directions()]
    up = [d.change(_STEP) for d in _directions()]
    down = [Change() if alone else d.change(-_STEP) for d, alone in zip(_directions(), one_sided, strict=True)]
    changes = [*up, *down]
    shifts = np.stack([change.traits for change in changes])
    lanes = Lanes(traits + shifts, np.repeat(start[None], len(changes), axis=0), changes)
    told = scene.simulated(lanes)
    width = np.where(one_sided, _STEP, 2.0 * _STEP)
    return np.asarray(((told[: len(up)] - told[len(up) :]) / width[:, None]).T)
