"""A case: runs of healthy plants, runs of others with something hidden, runs to judge by, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal, get_args

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.errors import BadInput
from flora_common.runs import CameraSection, LampsSection, RunFile
from flora_common.suggest import did_you_mean
from flora_common.tracks import Track

from . import other, rod
from .effects import CATALOGUE, DAMAGE, INSEPARABLE, Effect, Parameters
from .individuals import Spread, add_drifts, draw_plant, draw_spread
from .outside import ON_REQUEST, OUTSIDE
from .record import recorded
from .scene import HOUR_S, LIGHT_CODES, ROW_S, Laws, Plant, Scene
from .schedules import OPEN_LOOPS, draw_schedule

Kind = Literal["single", "pair", "none", "outside"]
KINDS: tuple[Kind, ...] = get_args(Kind)
ALL_EFFECTS: dict[str, Effect] = {**CATALOGUE, **DAMAGE, **OUTSIDE, **ON_REQUEST}
HELD_OUT = 3
HOURS = 72.0
REFERENCE_TARGETS_CM = 4.0
LAST_ROWS = 12
HORIZONS_H = 1, 6, 24
AROUND_H = 0.5
MOST_SEED = 2**63

Oracle = dict[str, dict[str, dict[str, float]]]
"""Whose plant, over which part of the run, ``base_mm`` or ``extended_mm``: root mean square distances in mm."""


@dataclass(frozen=True)
class Run:
    """One run as it is written: what was recorded, and what a run file says of it."""

    track: Track
    file: RunFile
    schedule: str


@dataclass(frozen=True)
class Hidden:
    """An effect with its parameters."""

    name: str
    parameters: Parameters


@dataclass(frozen=True)
class Case:
    """A case.

    Attributes:
        seed, form, kind, number: what it was drawn from.
        hidden: the effects, in no order; empty for ``none``.
        reference: runs without an effect.
        measured: runs with it.
        held_out: further runs with it, that no finder learns from; the gain is judged on them.
        oracle: free runs of the ``typical`` plant and of each held-out run's ``own``, without drifts, over the whole
            ``run``, of all points, and, of the tip, at its ``end`` (the last hour) and :data:`HORIZONS_H` after its
            start (half an hour about it): root mean square distances, ``base_mm`` without and ``extended_mm`` with the
            true effect.
        hours: length of each run.
    """

    seed: int
    form: int
    kind: Kind
    hidden: tuple[Hidden, ...]
    reference: tuple[Run, ...]
    measured: tuple[Run, ...]
    held_out: tuple[Run, ...]
    oracle: Oracle
    number: int = 0
    hours: float = HOURS


@dataclass(frozen=True)
class _Species:
    """What all plants of a world share."""

    seed: int
    form: int
    laws: Laws
    typical: Plant
    spread: Spread
    camera_cm: float
    hours: float


def draw_case(
    seed: int,
    form: int,
    kind: Kind,
    runs: int = 3,
    reference: int = 9,
    *,
    effect: str | None = None,
    hours: float = HOURS,
    held_out: int = HELD_OUT,
    light: Sequence[str] = (),
    number: int = 0,
) -> Case:
    """A whole case, the same for the same arguments.

    Seed and form make a world: a species and its reference runs. Plants, noise and lamps follow from these and the
    number alone, so that cases of other kinds with the same seed and number differ by their effects only.

    Args:
        seed: any whole number from 0.
        form: 0 for the plain planar stem, 1 for other physics.
        kind: what is hidden: one effect of the catalogue, two, none, or one from outside.
        runs: measured runs.
        reference: runs without an effect; two in three open-loop in six-hour turns, the rest closed loops.
        effect: the name of the effect of a ``single`` or ``outside`` case; drawn where missing.
        hours: length of each run.
        held_out: further runs with the effect.
        light: schedule of each measured run, see :func:`.schedules.draw_schedule`; a mixture where empty. Which plants
            are measured does not depend on it.
        number: which plants of the world are measured and held out. Cases of other numbers have other plants, lamps,
            noise and strengths of the effect, and the same reference runs.

    Raises:
        BadInput: an unknown form, kind or effect, or numbers that make no case.
    """
    _check(seed, form, kind, runs, reference, effect, hours, number)
    species, rng = _species(seed, form, hours)
    # The first number adds nothing to what chance is made from: its cases are those of before there were others.
    own = [number] if number else []
    hidden = _draw_hidden(np.random.default_rng([seed, form, 2, KINDS.index(kind), *own]), kind, effect)
    order = np.random.default_rng([seed, form, 4, number]) if number else rng
    loops = ["closed_loop" if i >= reference - reference // 3 else "six_hour" for i in range(reference)]
    mixed = [str(name) for name in order.permutation([OPEN_LOOPS[i % 3] for i in range(max(runs, 3))])][:runs]
    judged = [OPEN_LOOPS[i % 3] for i in range(held_out)]
    measured_group, judging_group = _groups(number)
    tests = _runs(species, judging_group, judged, hidden)
    return Case(
        seed,
        form,
        kind,
        hidden,
        _runs(species, 0, loops, ()),
        _runs(species, measured_group, list(light) or mixed, hidden),
        tests,
        _oracle(species, judging_group, tests, hidden),
        number,
        hours,
    )


def named_mm(case: Case, named: Sequence[Hidden]) -> dict[str, float]:
    """What was named, put to the test about plants that are known: free runs of each held-out run's own plant.

    Args:
        case: any.
        named: effects as somebody told them; those outside :data:`.effects.CATALOGUE` do nothing.

    Returns:
        Root mean square distances in mm, to be held against ``base_mm`` and ``extended_mm`` of ``oracle["own"]``.
    """
    species, _ = _species(case.seed, case.form, case.hours)
    known = tuple(one for one in named if one.name in CATALOGUE)
    return _apart_mm(species, _groups(case.number)[1], case.held_out, known, None)


def _species(seed: int, form: int, hours: float) -> tuple[_Species, np.random.Generator]:
    """A world's plants, and the chance that they were drawn with, which goes on."""
    rng = np.random.default_rng([seed, form, 1])
    laws, typical = rod.laws_and_plant() if form == 0 else other.laws_and_plant(rng)
    spread = draw_spread(rng, form)
    camera_cm = float(rng.uniform(70.0, 80.0)) if form == 1 else 0.0
    return _Species(seed, form, laws, typical, spread, camera_cm, hours), rng


def _groups(number: int) -> tuple[int, int]:
    """Numbers of the measured runs' group and of that of the held-out ones; 0 is the reference."""
    return 1 + 2 * number, 2 + 2 * number


def _check(
    seed: int, form: int, kind: str, runs: int, reference: int, effect: str | None, hours: float, number: int
) -> None:
    if not 0 <= seed < MOST_SEED:
        raise BadInput(f"seed is {seed}; it must be a whole number from 0")
    if form not in {0, 1}:
        raise BadInput(f"form is {form}; there are 0 (planar stem) and 1 (other physics)")
    if kind not in KINDS:
        raise BadInput(f"kind `{kind}` does not exist{did_you_mean(kind, KINDS)}")
    if runs < 1 or reference < 1:
        raise BadInput(f"a case needs at least one measured and one reference run, not {runs} and {reference}")
    if number < 0:
        raise BadInput(f"number is {number}; it must be a whole number from 0")
    if not 1.0 <= hours <= HOURS:
        raise BadInput(f"hours is {hours:g}; it must lie in [1, {HOURS:g}]")
    if effect is None:
        return
    known = {**OUTSIDE, **ON_REQUEST} if kind == "outside" else {**CATALOGUE, **DAMAGE} if kind == "single" else {}
    if effect not in known:
        raise BadInput(f"no effect `{effect}` for a case of kind `{kind}`{did_you_mean(effect, list(known))}")


def _draw_hidden(rng: np.random.Generator, kind: Kind, effect: str | None) -> tuple[Hidden, ...]:
    names: list[str] = []
    if kind == "single":
        names = [effect or str(rng.choice(list(CATALOGUE)))]
    elif kind == "outside":
        names = [effect or str(rng.choice(list(OUTSIDE)))]
    elif kind == "pair":
        while len(names) != 2 or frozenset(names) in INSEPARABLE:
            names = [str(name) for name in rng.choice(list(CATALOGUE), 2, replace=False)]
    return tuple(Hidden(name, ALL_EFFECTS[name].draw(rng)) for name in names)


def _chance(species: _Species, group: int, number: int, what: int) -> np.random.Generator:
    return np.random.default_rng([species.seed, 3, species.form, group, number, what])


def _scene(
    species: _Species,
    group: int,
    number: int,
    schedule: str,
    hidden: tuple[Hidden, ...],
    *,
    plant: Plant | None = None,
    drifting: bool = True,
) -> Scene:
    """One run before it is grown: its plant, or another one, its lamps, its drifts, its effects."""
    lamps = _chance(species, group, number, 0)
    scene = Scene(
        deepcopy(plant) or draw_plant(_chance(species, group, number, 1), species.typical, species.spread),
        species.laws,
        draw_schedule(lamps, schedule, species.hours),
        species.hours,
        target_x_cm=float(lamps.uniform(-REFERENCE_TARGETS_CM, REFERENCE_TARGETS_CM)),
        camera_cm=species.camera_cm,
    )
    steady = scene.series.copy()
    add_drifts(_chance(species, group, number, 2), scene, species.spread)
    if not drifting:
        scene.series = steady
    chance = _chance(species, group, number, 3)
    for effect in hidden:
        ALL_EFFECTS[effect.name].apply(scene, effect.parameters, chance)
    return scene


def _runs(species: _Species, group: int, schedules: list[str], hidden: tuple[Hidden, ...]) -> tuple[Run, ...]:
    return tuple(_run(species, group, number, schedule, hidden) for number, schedule in enumerate(schedules))


def _run(species: _Species, group: int, number: int, schedule: str, hidden: tuple[Hidden, ...]) -> Run:
    """One run. Of the groups, 0 is the reference; after it each case of the world has two, measured and held out."""
    role = 0 if group == 0 else 2 - group % 2
    scene = _scene(species, group, number, schedule, hidden)
    track = recorded(scene, species.spread, _chance(species, group, number, 4))
    file = RunFile(
        CameraSection((820.0, 984.0), 18.4),
        rig="box1",
        plant=f"plant {'rmh'[role]}{number + 1}",
        start=datetime(2026, 5, 1, tzinfo=UTC) + timedelta(days=4 * number + 60 * role),
        lamps=LampsSection(round(species.laws.lamp_x_cm, 2), round(species.laws.lamp_y_cm, 2)),
    )
    return Run(track, file, schedule)


def _oracle(species: _Species, group: int, runs: tuple[Run, ...], hidden: tuple[Hidden, ...]) -> Oracle:
    """What knowing the effect is worth on the held-out runs, a group: for the typical plant, and for each run's own."""
    found: Oracle = {}
    for whose, plant in (("typical", species.typical), ("own", None)):
        for name, effects in (("base_mm", ()), ("extended_mm", hidden)):
            for when, rms in _apart_mm(species, group, runs, effects, plant).items():
                found.setdefault(whose, {}).setdefault(when, {})[name] = rms
    return found


def _apart_mm(
    species: _Species, group: int, runs: tuple[Run, ...], effects: tuple[Hidden, ...], plant: Plant | None
) -> dict[str, float]:
    """How far free runs of a plant, or of each run's own, with these effects are from a group's runs."""
    squares: dict[str, list[FloatArray]] = {name: [] for name in ("run", "end", *(f"{hour}h" for hour in HORIZONS_H))}
    for number, run in enumerate(runs):
        rows = np.rint(run.track.time_s / ROW_S).astype(np.int64)
        scene = _scene(species, group, number, run.schedule, effects, plant=plant, drifting=False)
        # Nobody knows more of the lamps than the record tells; who knows the effect knows how late it tells it.
        scene.schedule = believed_lamps(run.track, len(scene.schedule), scene.record.offset_h)
        scene.record.gap_share = 0.0
        off = ((recorded(scene).points_cm[rows] - run.track.points_cm)[:, 1:] ** 2).sum(axis=2) * 100.0
        squares["run"].append(off.ravel())
        squares["end"].append(off[-LAST_ROWS:, -1])
        for hour in HORIZONS_H:
            away_h = np.abs((run.track.time_s - run.track.time_s[0]) / HOUR_S - hour)
            squares[f"{hour}h"].append(off[away_h <= AROUND_H, -1])
    known = {when: np.concatenate(parts) for when, parts in squares.items()}
    return {when: float(np.sqrt(own.mean())) for when, own in known.items() if len(own)}


def believed_lamps(track: Track, rows: int, ahead_h: float) -> np.ndarray:
    """The schedule that a record tells: a row's lamp shone over the interval before it.

    Args:
        track: the record; before its first row and after its last the lamps are taken to be as in these.
        rows: of the schedule.
        ahead_h: how far the record's lamps are ahead of its pictures.
    """
    stamp_s = (np.arange(rows) + 1) * ROW_S - ahead_h * HOUR_S
    after = np.searchsorted(track.time_s, stamp_s)
    return np.array([LIGHT_CODES.index(track.light[min(int(row), len(track.light) - 1)]) for row in after])
