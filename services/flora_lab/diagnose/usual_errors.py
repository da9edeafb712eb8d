"""How much of every effect the reference runs seem to show, though nothing is taken to be wrong with them.

No law is right in everything, and what it is wrong in looks a little like one effect or another, now in this run, now
in that. Each effect is estimated in every reference run by itself. The mean of these estimates, and how much more they
scatter than chance lets them, belong into the null hypothesis: an effect in other runs is news only beyond them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from flora_lab.diagnose.joint import Cause, Found, Joint
from flora_lab.effects.catalogue import CATALOGUE
from flora_lab.effects.effect import Effect, Parameter

Array = npt.NDArray[Any]

_EXPECTED: Final = 0.05
"""Scatter that is expected before any data, in standard deviations of what is plausible for the effect; it counts as
much as :data:`_STRENGTH` runs."""
_STRENGTH: Final = 3.0
_OF_INDIVIDUALS: Final = (
    "growth_rate",
    "stiffening",
    "gravitropism",
    "proprioception",
    "phototropic_gain",
    "time_scale",
)
"""Effects on what plants differ in anyway: by how much they do is known of the base, and is not counted twice."""
_FARTHEST: Final = 3.0


@dataclass(frozen=True, slots=True)
class Told:
    """What runs alone tell of the strength of an effect.

    Attributes:
        value: the most probable coordinate, without what was known of it before.
        variance: of it.
    """

    value: float
    variance: float


def strength_of(effect: Effect) -> int:
    """Which parameter says how strong the effect is."""
    return next(i for i, p in enumerate(effect.parameters) if p.none is not None)


def told(found: Found) -> Told:
    """Of the last cause of a fit."""
    cause = found.hypothesis.causes[-1]
    own = strength_of(cause.effect)
    at = len(found.coordinates) - len(cause.parameters) + own
    p = cause.parameters[own]
    return _alone(p, float(found.coordinates[at]), float(found.covariance[at, at]))


def _alone(p: Parameter, value: float, variance: float) -> Told:
    """An estimate without what was known before."""
    # Never narrower than numbers are good for, never wider than what was known before is of use.
    precision = max(1.0 / max(variance, 1e-12) - p.spread**-2.0, 1e-3 * p.spread**-2.0)
    return Told((value / max(variance, 1e-12) - p.centre * p.spread**-2.0) / precision, 1.0 / precision)


@dataclass(frozen=True, slots=True)
class UsualErrors:
    """Of every cause of the catalogue, in the order of :func:`causes`.

    Attributes:
        mean: of the strength's coordinate beyond where there is no effect, shape (causes,).
        sd: by which runs scatter beyond chance, shape (causes,).
        runs: that this was learned from.
    """

    mean: Array
    sd: Array
    runs: int

    def beyond(self, found: Found, gain: float, together: int) -> float:
        """The evidence for the last cause of a fit, beyond what healthy runs seem to show of it, nats.

        Args:
            found: the fit.
            gain: its evidence, if the law were right.
            together: number of runs that it is of.
        """
        cause = found.hypothesis.causes[-1]
        at = causes().index((cause.effect.name, cause.form))
        p = cause.parameters[strength_of(cause.effect)]
        seen = told(found)
        away, before = seen.value - p.centre, p.spread**2
        # Far from no effect nothing is linear any more: as wide as the evidence that was really found makes it.
        wide = _as_wide_as(away, gain, seen.variance, before)
        scatter = self.sd[at] ** 2 * (1.0 / together + 1.0 / self.runs)
        known = _log_odds(away, wide + scatter, float(self.mean[at]), before)
        return gain - _log_odds(away, wide, 0.0, before) + known


def _as_wide_as(away: float, gain: float, variance: float, spread_2: float) -> float:
    """The variance at which an estimate has this evidence; its own where it has no more than that with it.

    It is found to the last digit: where there are hundreds of nats, a tenth of them would be a claim.
    """
    least, most = variance, max(variance, spread_2)
    if _log_odds(away, least, 0.0, spread_2) <= gain:
        return least
    for _ in range(60):
        middle = float(np.sqrt(least * most))
        if _log_odds(away, middle, 0.0, spread_2) > gain:
            least = middle
        else:
            most = middle
    return most


def _log_odds(away: float, variance: float, usual: float, spread_2: float) -> float:
    """Logarithm of how much more probable an estimate is with the effect than without it."""
    wide = variance + spread_2
    with_it = -0.5 * np.log(wide) - 0.5 * (away - usual) ** 2 / wide
    without = -0.5 * np.log(variance) - 0.5 * (away - usual) ** 2 / variance
    return float(with_it - without)


def causes() -> list[tuple[str, int]]:
    """Effect and form of all that have a strength in the fits."""
    return [(e.name, form) for e in CATALOGUE if e.name != "circumnutation" for form in range(len(e.forms))]


def usual_errors(joints: Sequence[Joint], fits: Sequence[Found], has_temperature: bool) -> UsualErrors:
    """Of reference runs, each by itself.

    Args:
        joints: one run each.
        fits: of them, without any cause.
        has_temperature: whether the runs tell it.
    """
    by_name: Mapping[str, Effect] = {effect.name: effect for effect in CATALOGUE}
    mean, sd = [], []
    for name, form in causes():
        effect = by_name[name]
        p = effect.parameters[strength_of(effect)]
        expected = _EXPECTED * p.spread
        if name in _OF_INDIVIDUALS or (name == "temperature_growth" and not has_temperature):
            mean.append(0.0)
            sd.append(0.0 if name in _OF_INDIVIDUALS else expected)
            continue
        cause, own = Cause(effect, form), strength_of(effect)
        means, wide = zip(
            *(_of_kind(joints, fits, cause, own, at, expected) for at in _kinds(effect, own)), strict=True
        )
        # What kind of effect it would be (a time of day, a time constant) is not known: the worst of them counts.
        mean.append(float(np.mean(means)))
        sd.append(max(wide))
    # The answer to light and the clock are late alike; a delay alone cannot be less than none, which hides its scatter.
    late, clock = causes().index(("phototropic_latency", 0)), causes().index(("clock_offset", 0))
    mean[late], sd[late] = mean[clock], sd[clock]
    return UsualErrors(np.array(mean), np.array(sd), len(fits))


def _kinds(effect: Effect, own: int) -> list[Array]:
    """Coordinates at which there is no effect, for every combination of what else is told of it."""
    told = [
        [p.centre] if i == own or not p.starts else [p.coordinate(value) for value in p.starts]
        for i, p in enumerate(effect.parameters)
    ]
    return [np.array(chosen) for chosen in itertools.product(*told)]


def _of_kind(
    joints: Sequence[Joint], fits: Sequence[Found], cause: Cause, own: int, at: Array, expected: float
) -> tuple[float, float]:
    """Mean and scatter of the strength, if the effect is of one kind."""
    p = cause.parameters[own]
    values, variances = [], []
    for joint, fit in zip(joints, fits, strict=True):
        found, variance = joint.estimated(fit, cause, at)
        seen = _alone(p, float(found[own]), float(variance[own]))
        values.append(seen.value - p.centre)
        variances.append(seen.variance)
    return _scatter(np.clip(values, -_FARTHEST * p.spread, _FARTHEST * p.spread), np.array(variances), expected)


def _scatter(values: Array, variances: Array, expected: float) -> tuple[float, float]:
    """Mean and scatter beyond chance, of estimates with these variances.

    The scatter's posterior mode under an inverse gamma prior about what is expected, on a grid; the mean is as wide
    before any data as the scatter and what is expected of it are.
    """
    tried = expected * np.geomspace(0.2, 40.0, 60)
    best, most = (0.0, expected), -np.inf
    for scatter in tried.tolist():
        wide = variances + scatter**2
        weight = 1.0 / wide
        before = scatter**2 + expected**2
        mean = float((weight @ values) / (weight.sum() + 1.0 / before))
        fit = -0.5 * float(np.log(wide).sum() + ((values - mean) ** 2 / wide).sum()) - 0.5 * mean**2 / before
        prior = -_STRENGTH * np.log(scatter) - 0.5 * _STRENGTH * (expected / scatter) ** 2
        if fit + prior > most:
            best, most = (mean, scatter), fit + prior
    return best
