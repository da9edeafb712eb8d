"""Growing simulators of both kinds: what all promise, what they remember, and their folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from simulator_contract import LEFT, RIGHT, check_contract
from simulator_fakes import upright

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange, GrowingSimulator
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.interface import Chance, History, run
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import Provenance, write_simulator
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread
from flora_twin.runs import dataset_runs

Make = Callable[[], GrowingSimulator]
COUNT = len(TRAITS)
SHOWN = DataRange(longest_cm=20.0, widest_cm=6.0)
CALM = DriveNoise(wander_per_cm_h=2e-3, nutation_per_cm_h=5e-3)


def rod() -> RodSimulator:
    return RodSimulator(LampsSection(), Prior(prior_mean(), prior_spread()), DriveNoise(), SHOWN)


def sequence(members: int = 2) -> SequenceSimulator:
    """Random weights, so small that a stem stays a stem for three days."""
    rng = np.random.default_rng(1)
    shapes = weight_shapes(members, 8)
    weights = {name: (0.05 * rng.normal(size=shape)).astype(np.float32) for name, shape in shapes.items()}
    weights["b_out"][:] += 0.3 * rng.normal(size=weights["b_out"].shape).astype(np.float32) * [*[0.0] * 10, 1.0]
    return SequenceSimulator(NeuralLaw(weights, 6.0), Prior(np.zeros(COUNT), np.eye(COUNT)), CALM, SHOWN)


KINDS: dict[str, Make] = {
    "mechanistic": rod,
    "sequence": sequence,
    "one member": lambda: sequence().members()[1],
}
both_kinds = pytest.mark.parametrize("make", [rod, sequence])


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """As fast as it gets for a few plants."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    yield
    numba.set_num_threads(before)


@pytest.fixture(scope="module")
def measured() -> list[MeasuredRun]:
    return [
        in_steps(RunTrack(r.name, r.run_file.plant, Path(f"{r.name}.csv"), f"{i:064d}", r.track))
        for i, r in enumerate(dataset_runs(1, open_loops=2, closed_loops=2, hours=6.0))
    ]


def lit(steps: int, count: int, *lamps: tuple[float, float]) -> Array:
    """Levels (steps, count, 2): each lamp for an equal time."""
    share = -(-steps // len(lamps))
    return np.repeat(np.repeat(np.array(lamps), share, axis=0)[:steps, None], count, axis=1)


# What all promise


@pytest.mark.parametrize("kind", KINDS)
def test_it_keeps_what_simulated_plants_promise(measured: list[MeasuredRun], kind: str) -> None:
    # The spline comes back within 0.01 mm; chance in two steps is not that of one twice as long.
    check_contract(KINDS[kind](), measured, start_cm=1e-3, watch_cm=3e-3, merged_cm=0.02, hours=48.0)


@both_kinds
def test_without_chance_long_steps_are_several_short_ones(make: Make) -> None:
    plant = make()
    for state in (plant.start(upright(2)), plant.start(upright(2), before=np.array([LEFT, RIGHT]))):
        short = run(plant, state, lit(36, 2, RIGHT), 300.0)
        for times in (2, 4, 36):
            long = run(plant, state, lit(36 // times, 2, RIGHT), 300.0 * times)
            assert np.abs(long - short[times - 1 :: times]).max() < 1e-12


@both_kinds
def test_what_it_cannot_be_asked_for_is_told_in_one_line(make: Make) -> None:
    plant, light = make(), lit(1, 2, RIGHT)[0]
    state = plant.start(upright(2))
    missing, tiny = upright(2), 0.01 * upright(2)
    missing[1, 4, 0] = np.nan
    unknown_s = 86_401.0 if isinstance(plant, RodSimulator) else 450.0  # the network takes multiples of its step
    for ask in (
        lambda: plant.step(state, light, unknown_s),
        lambda: plant.step(state, light[:1], 300.0),
        lambda: plant.step(state, -light, 300.0),
        lambda: plant.step(state, np.nan * light, 300.0),
        lambda: plant.start(missing),
        lambda: plant.start(tiny),
    ):
        with pytest.raises(BadInput) as told:
            ask()
        assert "\n" not in str(told.value)


def test_dark_and_both_lamps_are_known() -> None:
    plant = rod()
    for lamps in ((0.0, 0.0), (1.0, 1.0), (0.3, 0.3)):
        stems = run(plant, plant.start(upright(1)), lit(72, 1, lamps), 300.0)
        assert np.abs(stems[..., 0]).max() < 1e-9  # nothing tells left from right
        assert stems[-1, 0, -1, 1] > 8.5
    learned, lamps_too = sequence(), (LEFT, (0.0, 0.0), (1.0, 1.0))
    told = [run(learned, learned.start(upright(1)), lit(36, 1, lamps), 300.0) for lamps in lamps_too]
    assert all(np.abs(told[0] - other).max() > 1e-6 for other in told[1:])


@both_kinds
def test_lamps_that_shone_before_are_remembered(make: Make) -> None:
    plant, points = make(), upright(3)
    fresh = plant.start(points)
    lamps = plant.start(points, before=np.array([LEFT, RIGHT, (0.0, 0.0)]))
    assert plant.stems_cm(lamps).tobytes() == plant.stems_cm(fresh).tobytes()
    plain, told = (run(plant, state, lit(12, 3, RIGHT), 300.0) for state in (fresh, lamps))
    assert np.abs(told[-1, 0] - told[-1, 1]).max() > 1e-5
    assert np.abs(told[-1, :2] - plain[-1, :2]).max(axis=(1, 2)).min() > 1e-5
    if isinstance(plant, RodSimulator):  # in the dark it sees nothing; and the lag behind the right lamp is over
        assert np.abs(told[-1, 2] - plain[-1, 2]).max() == 0.0
        assert told[0, 1, -1, 0] > 3.0 * plain[0, 1, -1, 0]


@both_kinds
def test_the_number_of_threads_changes_no_bit(make: Make, measured: list[MeasuredRun]) -> None:
    def everything() -> bytes:
        plant = make()
        points = np.stack([one.points_cm[0] for one in measured])
        free = run(plant, plant.start(points, Chance(np.arange(4))), lit(12, 4, LEFT, RIGHT), 300.0)
        told = np.stack([one.points_cm[:25] for one in measured], axis=1)
        light = np.stack([one.light[:24] for one in measured], axis=1)
        return free.tobytes() + plant.watch(History(told, light, 300.0, {})).traits.tobytes()

    alone = everything()
    if int(os.environ.get("NUMBA_NUM_THREADS", os.cpu_count() or 1)) == 1:
        pytest.skip("there is a single thread here")
    numba.set_num_threads(2)
    assert everything() == alone


@both_kinds
def test_it_tells_when_it_was_never_shown_the_like(make: Make) -> None:
    plant = make()
    points = np.concatenate([upright(1), upright(1, 19.9), upright(1, 20.1), upright(2)])
    points[3, :, 0], points[4, :, 0] = -np.linspace(0.0, 5.9, 10), np.linspace(0.0, 6.1, 10)
    state = plant.start(points)
    assert plant.is_beyond_data(state).tolist() == [False, False, True, False, True]
    state, _ = plant.step(state, lit(1, 5, LEFT)[0], 86_400.0)
    assert plant.is_beyond_data(state)[1]  # by now it has grown


# The folder


def written(path: Path, plant: GrowingSimulator, **changes: Any) -> Path:
    values: dict[str, Any] = {"weights": plant.weights(), "scales": plant.scales(), **changes}
    provenance = Provenance(recipe=plant.kind, seed=1, software="flora")
    write_simulator(path, kind=plant.kind, step_s=plant.step_s, provenance=provenance, **values)
    return path


@both_kinds
def test_read_again_it_is_the_same_plant(tmp_path: Path, make: Make) -> None:
    plant = make()
    again = load(written(tmp_path / "sim", plant))
    assert isinstance(again, type(plant))
    assert (again.noise, again.shown, again.step_s) == (plant.noise, plant.shown, plant.step_s)
    light = lit(24, 3, RIGHT, LEFT)
    one, other = (run(p, p.start(upright(3), Chance(np.arange(3))), light, 300.0) for p in (plant, again))
    assert one.tobytes() == other.tobytes()
    written(tmp_path / "twice", again)
    for file in (tmp_path / "sim").iterdir():
        assert file.read_bytes() == (tmp_path / "twice" / file.name).read_bytes()


def without(table: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != name}


Change = Callable[[dict[str, Any]], dict[str, Any]]
NOISE: list[tuple[Change, str]] = [
    (lambda n: without(n, "growth_h"), " must name"),
    (lambda n: {**n, "mood": 1.0}, " must name"),
    (lambda n: {**n, "growth_h": 0.0}, ".growth_h is 0.0, not a positive"),
    (lambda n: {**n, "growth_h": float("nan")}, ".growth_h is nan"),
    (lambda n: {**n, "growth_h": "long"}, ".growth_h is long"),
    (lambda n: {**n, "growth_h": True}, ".growth_h is True"),
]
SCALES: list[tuple[Change, str]] = [
    *((lambda s, change=change: {**s, "noise": change(s["noise"])}, "scales.noise" + said) for change, said in NOISE),
    (lambda s: without(s, "noise"), "scales.noise must name"),
    (lambda s: {**s, "noise": 3}, "scales.noise must name"),
    (lambda s: without(s, "longest_cm"), "scales.longest_cm is None"),
    (lambda s: {**s, "widest_cm": "wide"}, "scales.widest_cm is wide"),
]
FLAT = np.eye(COUNT)  # but of too low a rank, though rounding may leave its least eigenvalue above zero
FLAT[:3, :3] = [[2.5, -2.08, -0.78], [-2.08, 2.18, 0.42], [-0.78, 0.42, 0.36]]
NO_COVARIANCE = "not symmetric, or not positive"
WEIGHTS: list[tuple[Change, str]] = [
    (lambda w: without(w, "trait_covariance"), "holds no `trait_covariance`"),
    (lambda w: {**w, "trait_mean": np.zeros(2)}, f"`trait_mean` is (2,); expected ({COUNT})"),
    (lambda w: {**w, "trait_covariance": np.eye(2)}, f"`trait_covariance` is (2, 2); expected ({COUNT}, {COUNT})"),
    (lambda w: {**w, "trait_covariance": FLAT}, NO_COVARIANCE),
    (lambda w: {**w, "trait_covariance": -np.eye(COUNT)}, NO_COVARIANCE),
    (lambda w: {**w, "trait_covariance": np.diag(np.arange(float(COUNT)))}, NO_COVARIANCE),
    (lambda w: {**w, "trait_covariance": np.triu(np.ones((COUNT, COUNT)))}, NO_COVARIANCE),
    (lambda w: without(w, "w_hh"), "holds no `w_hh`"),
    (lambda w: {**w, "w_hh": w["w_hh"][0]}, "`w_hh` is"),
    (lambda w: {**w, "w_hh": w["w_hh"][:, :0]}, "there must be at least one member and one cell"),
    (lambda w: {**w, "w_ih": w["w_ih"][:, :-1]}, "`w_ih` is"),
    (lambda w: {**w, "b_out": w["b_out"][:1]}, "`b_out` is"),
]


def told_on_loading(folder: Path) -> str:
    with pytest.raises(BadInput) as told:
        load(folder)
    assert str(folder) in str(told.value)
    assert "\n" not in str(told.value)
    return str(told.value)


@pytest.mark.parametrize(("change", "said"), SCALES)
@both_kinds
def test_scales_that_are_none_are_told(tmp_path: Path, make: Make, change: Change, said: str) -> None:
    plant = make()
    assert said in told_on_loading(written(tmp_path / "sim", plant, scales=change(plant.scales())))


@pytest.mark.parametrize(("change", "said"), WEIGHTS)
def test_weights_that_do_not_fit_are_told(tmp_path: Path, change: Change, said: str) -> None:
    plant = sequence()
    assert said in told_on_loading(written(tmp_path / "sim", plant, weights=change(plant.weights())))


@pytest.mark.parametrize(("make", "name"), [(rod, "lamp_distance_cm"), (rod, "lamp_height_cm"), (sequence, "zone_cm")])
@pytest.mark.parametrize("value", [None, "far", float("inf")])
def test_scales_that_a_kind_needs_are_missed(tmp_path: Path, make: Make, name: str, value: Any) -> None:
    plant = make()
    scales = without(plant.scales(), name) | ({} if value is None else {name: value})
    assert f"scales.{name} is {value}" in told_on_loading(written(tmp_path / "sim", plant, scales=scales))


LOADING = """
import importlib, json, sys, time
from pathlib import Path
from flora_lab.simulator import load, rod_simulator, sequence
start = time.perf_counter()
load.load(Path(sys.argv[1]))
print(json.dumps({"load_s": time.perf_counter() - start, "heavy": [n for n in HEAVY if n in sys.modules]}))
"""


@both_kinds
def test_it_loads_at_once_and_without_torch(tmp_path: Path, make: Make) -> None:
    folder = written(tmp_path / "sim", make())
    code = LOADING.replace("HEAVY", "('torch', 'scipy.optimize', 'matplotlib', 'neat')")
    times_s = []
    for _ in range(3):
        done = subprocess.run(
            [sys.executable, "-c", code, str(folder)], capture_output=True, text=True, timeout=60, check=True
        )
        told = json.loads(done.stdout)
        assert told["heavy"] == []
        times_s.append(told["load_s"])
    assert min(times_s) < 0.05
