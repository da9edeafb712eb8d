"""A learned simulator with a mechanistic part beside it: what is added, who is recognised, and the folder."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from evolve_simulators import paper
from simulator_contract import LEFT, RIGHT, check_contract
from simulator_fakes import upright

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.corrected import CorrectedSimulator, LearnedSimulator
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.interface import Chance, History, run
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.paper import PaperSimulator
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import Extension, Provenance, write_simulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread
from flora_twin.runs import dataset_runs

SHOWN = DataRange(20.0, 6.0)
CALM = DriveNoise(wander_per_cm_h=2e-3, nutation_per_cm_h=5e-3)
GROWTH = Extension("growth_rate", {"factor": 1.5})
DRAUGHT = Extension("draught", {"drive_per_cm_h": 0.1})
WARMTH = Extension("temperature_growth", {"per_degree": 0.07})


def rod() -> RodSimulator:
    prior = Prior(prior_mean(), prior_spread())
    return RodSimulator(LampsSection(), prior, CALM, SHOWN, usual_temperature_c=22.0)


def sequence() -> SequenceSimulator:
    """Random weights, so small that a stem stays a stem for days; its first trait is how fast it grows."""
    rng = np.random.default_rng(1)
    weights = {name: (0.05 * rng.normal(size=shape)).astype(np.float32) for name, shape in weight_shapes(2, 8).items()}
    return SequenceSimulator(NeuralLaw(weights, 6.0), Prior(np.zeros(len(TRAITS)), np.eye(len(TRAITS))), CALM, SHOWN)


both = pytest.mark.parametrize("make", [sequence, paper])


@pytest.fixture(scope="module")
def measured() -> list[MeasuredRun]:
    return [
        in_steps(RunTrack(r.name, r.run_file.plant, Path(f"{r.name}.csv"), f"{i:064d}", r.track))
        for i, r in enumerate(dataset_runs(1, open_loops=2, closed_loops=1, hours=4.0))
    ]


def lit(steps: int, *lamps: tuple[float, float]) -> Array:
    """Levels (steps, 1, 2): each lamp for an equal time."""
    return np.repeat(np.array(lamps), -(-steps // len(lamps)), axis=0)[:steps, None]


def test_it_keeps_what_simulated_plants_promise(measured: list[MeasuredRun]) -> None:
    plant = CorrectedSimulator(sequence(), rod().extended([DRAUGHT, WARMTH]))
    # Height that leaning cost the mechanistic plants comes back as they right themselves, whatever the learned does.
    check_contract(plant, measured, start_cm=1e-3, watch_cm=3e-3, merged_cm=0.02, shrink_cm=0.2, hours=24.0)


@both
def test_without_effects_it_is_the_learned_simulator(make: Callable[[], LearnedSimulator]) -> None:
    light = lit(48, RIGHT, LEFT)
    for extensions in ([], [Extension("gravitropism", {"factor": 1.0})]):
        plant, learned = CorrectedSimulator(make(), rod().extended(extensions)), make()
        told, own = (run(p, p.start(upright(), Chance(np.array([3]))), light, 300.0) for p in (plant, learned))
        if isinstance(learned, PaperSimulator):  # told at even heights
            assert np.abs(told[:, :, -1] - own[:, :, -1]).max() < 1e-6
            heights = told[:, 0, :, 1]
            assert np.abs(heights - np.linspace(0.0, 1.0, 10) * heights[:, -1:]).max() < 1e-5
        else:
            assert told.tobytes() == own.tobytes()


@both
def test_it_adds_what_the_effect_makes_of_the_mechanistic_plant(make: Callable[[], LearnedSimulator]) -> None:
    plain, light = rod(), lit(48, RIGHT, LEFT)
    extended = plain.extended([GROWTH, DRAUGHT])
    chance, before = Chance(np.array([7])), np.array([LEFT])
    tips = [
        run(p, p.start(upright(), chance, before), light, 300.0)[:, 0, -1]
        for p in (CorrectedSimulator(make(), extended), make(), extended, plain)
    ]
    assert tips[0] == pytest.approx(tips[1] + tips[2] - tips[3], abs=1e-9)
    assert np.abs(tips[0] - tips[1]).max() > 0.5
    assert list(CorrectedSimulator(make(), extended).members()) == []


def test_what_a_learned_plant_is_told_apart_by_is_not_the_effect() -> None:
    """The same individual is recognised from its track with the effect as from its track without."""
    learned, corrected = sequence(), CorrectedSimulator(sequence(), rod().extended([GROWTH]))
    light, first = lit(144, RIGHT, LEFT), upright()
    with_effect = np.concatenate([first[None], run(corrected, corrected.start(first), light, 300.0)])
    without = np.concatenate([first[None], run(learned, learned.start(first), light, 300.0)])
    alone = learned.watch(History(without, light, 300.0, {})).traits[0]
    fooled = learned.watch(History(with_effect, light, 300.0, {})).traits[0]
    state = corrected.watch(History(with_effect, light, 300.0, {}))
    assert np.abs(fooled - alone).max() > 4.0 * np.abs(state.learned.traits[0] - alone).max()
    own = state.extended.traits - corrected.mechanistic.added_traits
    assert state.plain.traits.tobytes() == own.tobytes()
    assert corrected.stems_cm(state)[0] == pytest.approx(with_effect[-1, 0], abs=3e-3)


def test_it_follows_the_temperature_that_the_learned_one_knows_nothing_of() -> None:
    plant = CorrectedSimulator(sequence(), rod().extended([WARMTH]))
    state = plant.start(upright(2))
    warm = {"temperature_c": np.repeat([[22.0, 30.0]], 144, axis=0)}
    after = run(plant, state, np.repeat(lit(144, RIGHT), 2, axis=1), 300.0, warm)[-1, :, -1, 1]
    assert after[1] > after[0] + 0.1


def test_a_stem_is_never_below_the_ground() -> None:
    """Though the effect takes away more height than the learned stem has."""
    slow = rod().extended([Extension("time_scale", {"factor": 20.0})])
    plant = CorrectedSimulator(sequence(), slow)
    stems = run(plant, plant.start(upright(1, 1.0)), lit(288, RIGHT), 1500.0)
    assert stems[..., 1].min() == 0.0
    assert np.isfinite(stems).all()
    tips = stems[:, 0, -1, 1]
    assert tips[-1] == 0.0 < tips[0]


def test_either_part_tells_that_it_was_never_shown_the_like() -> None:
    plant = CorrectedSimulator(sequence(), rod().extended([DRAUGHT]))
    points = np.concatenate([upright(1), upright(1, 20.1)])
    assert plant.is_beyond_data(plant.start(points)).tolist() == [False, True]
    wide = CorrectedSimulator(sequence(), RodSimulator(LampsSection(), rod().prior, CALM, DataRange(7.0, 6.0)))
    assert wide.is_beyond_data(wide.start(upright())).tolist() == [True]


@both
def test_a_light_and_a_step_that_the_learned_one_does_not_know_are_told(make: Callable[[], LearnedSimulator]) -> None:
    plant = CorrectedSimulator(make(), rod().extended([DRAUGHT]))
    state = plant.start(upright())
    with pytest.raises(BadInput):
        plant.step(state, np.array([RIGHT]), 450.0)
    with pytest.raises(BadInput):
        plant.step(state, np.array([[-1.0, 0.0]]), 300.0)


# The folder


def written(path: Path, plant: CorrectedSimulator, **changes: Any) -> Path:
    values: dict[str, Any] = {
        "weights": plant.weights(),
        "scales": plant.scales(),
        "extensions": plant.extensions,
        **changes,
    }
    provenance = Provenance(recipe="sequence", seed=1, software="flora")
    write_simulator(path, kind=plant.kind, step_s=plant.step_s, provenance=provenance, **values)
    return path


@both
def test_read_again_it_is_the_same_plant(tmp_path: Path, make: Callable[[], LearnedSimulator]) -> None:
    plant = CorrectedSimulator(make(), rod().extended([GROWTH, DRAUGHT, WARMTH]))
    folder = written(tmp_path / "sim", plant)
    again = load(folder)
    assert isinstance(again, CorrectedSimulator)
    assert again.extensions == plant.extensions
    assert (again.step_s, again.mechanistic.step_s) == (plant.step_s, plant.mechanistic.step_s)
    one, other = (run(p, p.start(upright(), Chance(np.array([2]))), lit(24, RIGHT), 300.0) for p in (plant, again))
    assert one.tobytes() == other.tobytes()
    written(tmp_path / "twice", again)
    for file in folder.iterdir():
        assert file.read_bytes() == (tmp_path / "twice" / file.name).read_bytes()


def without(table: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != name}


Change = Callable[[dict[str, Any]], dict[str, Any]]
SCALES: list[tuple[Change, str]] = [
    (lambda s: without(s, "learned_kind"), "scales.learned_kind is None; it must be one of paper, sequence"),
    (lambda s: {**s, "learned_kind": "mechanistic"}, "scales.learned_kind is mechanistic"),
    (lambda s: {**s, "learned_kind": ["paper"]}, "scales.learned_kind is ['paper']"),
    (lambda s: without(s, "mechanistic_step_s"), "scales.mechanistic_step_s is None"),
    (lambda s: without(s, "learned"), "scales.learned is missing, or no table"),
    (lambda s: {**s, "mechanistic": 3}, "scales.mechanistic is missing, or no table"),
    (lambda s: {**s, "learned": without(s["learned"], "zone_cm")}, "scales.learned.zone_cm is None"),
    (lambda s: {**s, "mechanistic": without(s["mechanistic"], "longest_cm")}, "scales.mechanistic.longest_cm is None"),
]
WEIGHTS: list[tuple[Change, str]] = [
    (lambda w: without(w, "learned.w_hh"), "holds no `learned.w_hh`"),
    (lambda w: without(w, "mechanistic.trait_mean"), "holds no `mechanistic.trait_mean`"),
    (lambda w: {**w, "mechanistic.trait_mean": np.zeros(2)}, "`mechanistic.trait_mean` is (2,); expected (9)"),
]


@pytest.mark.parametrize(
    ("part", "change", "said"), [*(("scales", *one) for one in SCALES), *(("weights", *one) for one in WEIGHTS)]
)
def test_parts_that_are_missing_are_told(tmp_path: Path, part: str, change: Change, said: str) -> None:
    plant = CorrectedSimulator(sequence(), rod().extended([DRAUGHT]))
    folder = written(tmp_path / "sim", plant, **{part: change(getattr(plant, part)())})
    with pytest.raises(BadInput) as told:
        load(folder)
    assert said in str(told.value)
    assert str(folder) in str(told.value)
    assert "\n" not in str(told.value)


def test_an_effect_that_no_simulator_can_have_is_told(tmp_path: Path) -> None:
    file = written(tmp_path / "sim", CorrectedSimulator(sequence(), rod().extended([DRAUGHT]))) / "simulator.toml"
    roll = [{"effect": "camera_roll", "parameters": {"angle_deg": 2.0}}]
    file.write_text(tomli_w.dumps({**tomllib.loads(file.read_text()), "extension": roll}))
    with pytest.raises(BadInput, match="effect `camera_roll` is one of the camera: correct the data for it"):
        load(tmp_path / "sim")
