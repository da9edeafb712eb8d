"""What the simulator gets wrong, before anything is explained: where, when, how much, and whether by chance.

Whole runs are compared: the same numbers are told of each measured run and of each reference run, the latter simulated
by a typical plant that was learned without it, and the runs exchanged in all ways. Nine reference runs make that test
coarse, and a single measured run makes it blunt. So a second one stands beside it: how improbable the simulator's own
chance makes the runs, against how improbable it makes reference runs. The smaller of the two p-values counts, doubled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.stats

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose import residual_statistics as statistics
from flora_lab.diagnose.diagnosis import Residuals
from flora_lab.diagnose.joint import Base, Found
from flora_lab.diagnose.replayed import MM, PLANTS, Plant, Replayed, replayed
from flora_lab.diagnose.residual_statistics import SIDES, mean, rms
from flora_lab.diagnose.residual_words import Looks, description
from flora_lab.diagnose.rhythm import LINES, Swing, amplitude_of, spectrum
from flora_lab.diagnose.scene import Scene
from flora_lab.effects.effect import Change

SIGNIFICANT: Final = 0.05
_LEAST_LOG_SD: Final = 0.2
"""How runs in which nothing is wrong differ in the logarithm of their misfit, at the least: the chance that reference
runs are judged by was fitted to them, so that they differ less than others do."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What residuals of some runs look like, by the simulated plant.

    Attributes:
        numbers: shape (runs, k), see :mod:`flora_lab.diagnose.residual_statistics`.
        by_switch_mm: sideways residual by side and time since the switch, shape (runs, 2, FINE_BINS).
        by_clock_mm_h: growth residual by hours since the start, modulo a day, shape (runs, CLOCKS).
        profile_mm: root mean square of points 2 to 10, shape (runs, 9).
        swing_mm: amplitude of the swing of the tip that the simulator lacks, at :data:`SWING_PERIODS_H`, by plants with
            constants of their own, shape (runs, 200).
    """

    numbers: dict[Plant, Array]
    by_switch_mm: dict[Plant, Array]
    by_clock_mm_h: dict[Plant, Array]
    profile_mm: dict[Plant, Array]
    swing_mm: Array


_BY_PLANT: Final = ("numbers", "by_switch_mm", "by_clock_mm_h", "profile_mm")


@dataclass(frozen=True, slots=True)
class ReferenceResiduals:
    """The same numbers of the reference runs, to compare with. Small: kept beside the base.

    Attributes:
        shown: what they look like. The typical plant was learned from the other runs.
        misfit: mean of the squared whitened residuals of each run's own fit, shape (runs,).
        swing: that the simulator's plants have by themselves, a part of ``shown`` already.
    """

    shown: Shown
    misfit: Array
    swing: Swing | None = None


@dataclass(frozen=True, slots=True)
class ResidualTables:
    """What pictures are drawn from.

    Attributes:
        runs: measured and simulated.
        shown: what their residuals look like.
        reference: what those of reference runs look like.
        plant: of the two that are simulated, the one by which the residuals stand out more from the reference runs'.
    """

    runs: tuple[Replayed, ...]
    shown: Shown
    reference: Shown
    plant: Plant


FINE_H: Final = 0.5
FINE_BINS: Final = 24
"""The times since a switch of ``by_switch_mm``: half hours, up to twelve hours."""
SWING_PERIODS_H: Final = np.geomspace(0.75, 4.0, 200)
"""Where the amplitude of a swing is told."""


def reference_residuals(scenes: Sequence[Scene], base: Base, fits: Sequence[Found]) -> ReferenceResiduals:
    """The numbers of the runs that a base was learned from.

    Args:
        scenes: one per run.
        base: that was learned from them.
        fits: each run's own, as :func:`flora_lab.diagnose.learn.learned` tells them.
    """
    traits = np.concatenate([fit.traits for fit in fits])
    others = max(len(fits) - 1, 1)
    runs = []
    for scene, fit in zip(scenes, fits, strict=True):
        without = base.mean + (traits.mean(axis=0) - fit.traits[0]) / others
        runs.append(replayed(scene, base, without, fit.traits[0], fit.start[0], Change()))
    misfit = np.array([2.0 * fit.misfit / scene.size for scene, fit in zip(scenes, fits, strict=True)])
    return ReferenceResiduals(_shown(runs), misfit)


def as_arrays(reference: ReferenceResiduals) -> dict[str, Array]:
    """To be kept beside a base."""
    shown = reference.shown
    by_plant = {f"{name}_{plant}": getattr(shown, name)[plant] for name in _BY_PLANT for plant in PLANTS}
    return {**by_plant, "swing_mm": shown.swing_mm, "misfit": reference.misfit}


def from_arrays(arrays: Mapping[str, Array]) -> ReferenceResiduals:
    """Undo :func:`as_arrays`; raises KeyError where one is missing."""
    numbers, switch, clock, profile = ({p: arrays[f"{name}_{p}"] for p in PLANTS} for name in _BY_PLANT)
    return ReferenceResiduals(Shown(numbers, switch, clock, profile, arrays["swing_mm"]), arrays["misfit"])


def residuals_of(
    scenes: Sequence[Scene], base: Base, null: Found, reference: ReferenceResiduals
) -> tuple[Residuals, ResidualTables]:
    """What a simulator gets wrong about measured runs.

    Args:
        scenes: one per run.
        base: what is known of plants.
        null: the fit of the plants. Its causes, where it has any, are part of the simulator that is judged.
        reference: of the runs that the base was learned from.
    """
    change = null.hypothesis.change(null.coordinates)
    runs = [
        replayed(scene, base, base.mean, traits, start, change)
        for scene, traits, start in zip(scenes, null.traits, null.start, strict=True)
    ]
    shown = _shown(runs)
    if reference.swing is not None:
        for numbers in shown.numbers.values():  # how far tips swing differs from plant to plant, and is not asked
            numbers[:, statistics.of_group("swing")] = np.nan
    known = reference.shown
    groups = [statistics.of_group(group) for group in statistics.GROUPS]
    compared = statistics.compared(
        np.concatenate([shown.numbers["typical"], shown.numbers["own"]], axis=1),
        np.concatenate([known.numbers["typical"], known.numbers["own"]], axis=1),
        [*groups, *(group + statistics.COUNT for group in groups)],
    )
    p_by_fit = _misfit_p(scenes, null, reference)
    p_value = min(1.0, 2.0 * min(p_by_fit, compared.p_value))
    looks = Looks(shown.numbers, known.numbers, compared, p_value, p_by_fit)
    plant = looks.clearer_plant
    size_mm = rms(np.concatenate([_tip_mm(run, "typical") for run in runs]))
    said = Residuals(
        where=_where(runs),
        when=_when(runs, shown, looks),
        size_mm=size_mm,
        significant=bool(p_value <= SIGNIFICANT),
        description=description(looks, runs, p_value <= SIGNIFICANT),
    )
    return said, ResidualTables(tuple(runs), shown, known, plant)


def _shown(runs: Sequence[Replayed]) -> Shown:
    def each(numbers: Callable[[Replayed, Plant], Array]) -> dict[Plant, Array]:
        return {plant: np.stack([numbers(run, plant) for run in runs]) for plant in PLANTS}

    swing_mm = np.stack([_swing_mm(run) for run in runs])
    return Shown(each(statistics.numbers_of), each(_by_switch_mm), each(_by_clock_mm_h), each(_profile_mm), swing_mm)


def _swing_mm(run: Replayed) -> Array:
    """Amplitude of a swing that would have the power in a narrow band about each period."""
    own = spectrum(run.error_mm("own")[:, -1, 0], run.step_h)
    if len(own.per_hour) < LINES:
        return np.full(len(SWING_PERIODS_H), np.nan)
    density = np.interp(1.0 / SWING_PERIODS_H, own.per_hour, statistics.smoothed(own.power, LINES))
    return amplitude_of(density * own.spacing_per_hour * LINES)


def _tip_mm(run: Replayed, plant: Plant) -> Array:
    """Distance of measured and simulated tip, shape (n,)."""
    return np.asarray(np.hypot(*run.error_mm(plant)[:, -1].T))


def _by_switch_mm(run: Replayed, plant: Plant) -> Array:
    error = run.error_mm(plant)[:, -1, 0]
    place = ((run.since_h - 1e-9) // FINE_H).astype(np.int64)
    sides = (run.is_left, run.is_right)
    return np.array([[mean(error[side & (place == k)]) for k in range(FINE_BINS)] for side in sides])


def _by_clock_mm_h(run: Replayed, plant: Plant) -> Array:
    rate = statistics.growth_error_mm_h(run, plant)
    place = (run.time_h - 1e-9) % 24.0 // statistics.CLOCK_H
    return np.array([mean(rate[place == k]) for k in range(statistics.CLOCKS)])


def _profile_mm(run: Replayed, plant: Plant) -> Array:
    error = np.linalg.norm(run.error_mm(plant), axis=-1)
    return np.array([rms(error[:, point]) for point in range(1, error.shape[1])])


def _misfit_p(scenes: Sequence[Scene], null: Found, reference: ReferenceResiduals) -> float:
    """Probability that runs in which nothing is wrong fit as badly; misfits are log-normal over runs.

    1 where plants swing by themselves: hours' means keep more of that than is allowed for, and reference runs show
    nothing of it.
    """
    if reference.swing is not None:
        return 1.0
    count = len(scenes)
    here = float(np.log(2.0 * null.misfit / sum(scene.size for scene in scenes)))
    logs = np.log(reference.misfit)
    spread = max(float(logs.std(ddof=1)), _LEAST_LOG_SD)
    away = (here - float(logs.mean())) / (spread * np.sqrt(1.0 / count + 1.0 / len(logs)))
    return float(scipy.stats.t.sf(away, len(logs) - 1))


def _where(runs: Sequence[Replayed]) -> dict[str, Any]:
    """Along the stem: sideways (positive: farther to the right than simulated), upwards, and altogether."""
    found: dict[str, Any] = {}
    for point in range(1, STEM_POINTS):
        error, own = (np.concatenate([run.error_mm(plant)[:, point] for run in runs]) for plant in PLANTS)
        found[_place(point)] = _rounded(
            right_mm=mean(error[:, 0]),
            up_mm=mean(error[:, 1]),
            rms_mm=rms(np.hypot(*error.T)),
            rms_own_constants_mm=rms(np.hypot(*own.T)),
        )
    return found


def _place(point: int) -> str:
    return "tip" if point == STEM_POINTS - 1 else f"point_{point + 1}"


def _when(runs: Sequence[Replayed], shown: Shown, looks: Looks) -> dict[str, Any]:
    error = np.concatenate([run.error_mm("typical")[:, -1] for run in runs])
    height_cm = np.concatenate([run.measured_cm[:, -1, 1] for run in runs])
    time_h = np.concatenate([run.time_h for run in runs]) - 1e-9
    rate = np.concatenate([statistics.growth_error_mm_h(run, "typical") for run in runs])

    def part(rows: Array) -> dict[str, float | None]:
        chosen = error[rows]
        return _rounded(right_mm=mean(chosen[:, 0]), up_mm=mean(chosen[:, 1]), rms_mm=rms(np.hypot(*chosen.T)))

    clocks = {}
    for k in range(statistics.CLOCKS):
        rows = (time_h % 24.0) // statistics.CLOCK_H == k
        clocks[statistics.clock_label(k)] = {**part(rows), **_rounded(growth_mm_per_h=mean(rate[rows]))}
    heights = {}
    for k, low_cm in enumerate(statistics.HEIGHTS_CM[:-1]):
        heights[statistics.height_label(k)] = part((height_cm >= low_cm) & (height_cm < statistics.HEIGHTS_CM[k + 1]))
    sideways = shown.numbers["typical"][:, statistics.of_group("sideways")].reshape(len(runs), len(SIDES), -1)
    since = {
        f"{side} lamp": {
            statistics.since_label(k): _rounded(right_mm=mean(sideways[:, s, k])) for k in range(sideways.shape[2])
        }
        for s, side in enumerate(SIDES)
    }
    return {
        "since_switch": since,
        "hours_of_the_day_from_the_start": clocks,
        "height": heights,
        "age": {f"day {day + 1}": part(time_h // 24.0 == day) for day in range(statistics.DAYS)},
        "one_step": _one_step(runs),
        "one_step_along_the_stem": _one_step_along(runs),
        "runs": {run.name: _rounded(rms_mm=rms(_tip_mm(run, "typical"))) for run in runs},
        "p_value": looks.p_value,
        "p_value_by_exchange": looks.compared.p_value,
        "ways_to_exchange": looks.compared.ways,
        "p_value_by_misfit": looks.p_by_fit,
    }


def _one_step(runs: Sequence[Replayed]) -> dict[str, Any]:
    """After one step from each measured stem, by the typical plant: little, for an effect takes hours to show."""
    error = MM * np.concatenate([run.step_error_cm[:, -1] for run in runs])
    found: dict[str, Any] = _rounded(
        minutes=60.0 * runs[0].step_h,
        rms_mm=rms(np.hypot(*error.T)),
        right_mm=mean(error[:, 0]),
        up_mm=mean(error[:, 1]),
    )
    for s, side in enumerate(SIDES):
        shines = np.concatenate([(run.is_left, run.is_right)[s][run.step_rows] for run in runs])
        found[f"right_mm_{side}_lamp"] = _rounded(x=mean(error[shines, 0]))["x"]
    return found


def _one_step_along(runs: Sequence[Replayed]) -> dict[str, Any]:
    """The same of each point."""
    found: dict[str, Any] = {}
    for point in range(1, STEM_POINTS):
        error = MM * np.concatenate([run.step_error_cm[:, point] for run in runs])
        found[_place(point)] = _rounded(
            right_mm=mean(error[:, 0]), up_mm=mean(error[:, 1]), rms_mm=rms(np.hypot(*error.T))
        )
    return found


def _rounded(**values: float) -> dict[str, float | None]:
    """To a thousandth; None for what no run tells, since JSON has no other word for it."""
    return {name: round(value, 3) if np.isfinite(value) else None for name, value in values.items()}
