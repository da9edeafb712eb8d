"""The paper's simulator: its LSTM cell against torch's, and what it can do as a simulated plant."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from simulator_contract import LEFT, RIGHT, check_contract

from flora_common.arrays import Float32Array
from flora_common.errors import BadInput
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.interface import History, run
from flora_lab.simulator.load import load
from flora_lab.simulator.lstm_cell import Dense, LstmCell, rows_times
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.paper import Box, PaperNetwork, PaperSimulator
from flora_lab.simulator.store import INFO_FILE, WEIGHTS_FILE, Provenance, Stored, read_stored, write_simulator
from flora_twin.runs import dataset_runs

torch.set_num_threads(1)


def random_network(seed: int) -> PaperNetwork:
    rng = np.random.default_rng(seed)
    cell = LstmCell(
        0.5 * rng.normal(size=(200, 19)), 0.3 * rng.normal(size=(200, 50)), rng.normal(size=200).astype(np.float32)
    )
    return PaperNetwork(cell, Dense.of(0.02 * rng.normal(size=(18, 50)), np.linspace(0.0, 0.2, 18)))


BOX = Box(np.full(18, -0.2, dtype=np.float32), np.full(18, 0.4, dtype=np.float32))


def simulator(*, stateful: bool = False, seed: int = 1) -> PaperSimulator:
    return PaperSimulator(random_network(seed), BOX, unit_cm=65.0, step_s=300.0, stateful=stateful)


@pytest.fixture(scope="module")
def measured() -> list[MeasuredRun]:
    return [
        in_steps(RunTrack(r.name, r.run_file.plant, Path(f"{r.name}.csv"), f"{i:064d}", r.track))
        for i, r in enumerate(dataset_runs(1, open_loops=2, closed_loops=2, hours=6.0))
    ]


# The cell


def test_the_cell_is_torchs() -> None:
    net = random_network(3).cell
    lstm = torch.nn.LSTM(19, 50).double()
    values = {"weight_ih_l0": net.w_ih, "weight_hh_l0": net.w_hh, "bias_ih_l0": net.b, "bias_hh_l0": 0.0 * net.b}
    lstm.load_state_dict({name: torch.from_numpy(value) for name, value in values.items()})
    inputs = np.random.default_rng(1).normal(size=(40, 7, 19)).astype(np.float32)
    with torch.no_grad():
        expected, (_, cell) = lstm(torch.from_numpy(inputs).double())
    state = None
    for k, now in enumerate(inputs):
        state = net.step(now, state)
        assert np.abs(state.hidden - expected[k].numpy()).max() < 1e-5
    assert state is not None
    assert np.abs(state.cell - cell[0].numpy()).max() < 1e-5


def test_the_zero_state_is_no_state() -> None:
    cell = random_network(1).cell
    inputs = np.random.default_rng(1).normal(size=(5, 19)).astype(np.float32)
    with_zeros, without = cell.step(inputs, cell.zero_state(5)), cell.step(inputs)
    assert with_zeros.hidden.tobytes() == without.hidden.tobytes()
    assert with_zeros.cell.tobytes() == without.cell.tobytes()


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 131), st.integers(0, 2**32 - 1), st.data())
def test_a_row_is_the_same_to_the_last_bit_in_any_company(count: int, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    net = random_network(seed % 5)
    inputs = rng.normal(size=(count, 19)).astype(np.float32)
    state = net.cell.step(rng.normal(size=(count, 19)).astype(np.float32))
    together, after = net(inputs, state)
    row = data.draw(st.integers(0, count - 1))
    one = type(state)(state.hidden[[row]], state.cell[[row]])
    alone, after_alone = net(inputs[[row]], one)
    assert alone.tobytes() == together[[row]].tobytes()
    assert after_alone.cell.tobytes() == after.cell[[row]].tobytes()
    matrix = rng.normal(size=(19, 18)).astype(np.float32)
    product = rows_times(inputs, matrix)
    assert rows_times(inputs[[row]], matrix).tobytes() == product[[row]].tobytes()
    assert np.allclose(product, inputs.astype(np.float64) @ matrix, atol=1e-4)


def test_no_plants_are_no_trouble() -> None:
    plant = simulator()
    state, stems = plant.step(plant.start(np.zeros((0, 10, 2))), np.zeros((0, 2)), 300.0)
    assert stems.shape == (0, 10, 2)
    assert plant.is_beyond_data(state).shape == (0,)


@pytest.mark.parametrize(
    "shapes",
    [((200, 19), (200, 49), (200,)), ((200, 19), (200, 50), (199,)), ((150, 19), (200, 50), (200,)), ((200,),) * 3],
)
def test_shapes_that_are_no_cell_are_refused(shapes: Sequence[tuple[int, ...]]) -> None:
    with pytest.raises(ValueError, match="of no LSTM cell"):
        LstmCell(*(np.zeros(shape) for shape in shapes))
    with pytest.raises(ValueError, match="of no linear layer"):
        Dense.of(np.zeros((18, 50)), np.zeros(17))


# The plant


@pytest.mark.parametrize("stateful", [False, True])
def test_it_keeps_what_simulated_plants_promise(measured: list[MeasuredRun], stateful: bool) -> None:
    plant = simulator(stateful=stateful)
    # Points pass through float32; and nothing keeps this network's stems from getting shorter.
    check_contract(plant, measured, start_cm=1e-5, watch_cm=1e-5, shrink_cm=np.inf, hours=12.0)


def points_of(runs: list[MeasuredRun], row: int = 0) -> Any:
    return np.stack([r.points_cm[row] for r in runs])


def test_a_step_is_the_network_on_points_in_units_and_the_light(measured: list[MeasuredRun]) -> None:
    plant, points = simulator(), points_of(measured)
    light = np.array([LEFT, RIGHT, RIGHT, LEFT])
    _, stems = plant.step(plant.start(points), light, 300.0)
    inputs = np.concatenate([points[:, 1:].reshape(4, 18) / 65.0, [[0.0], [1.0], [1.0], [0.0]]], axis=1)
    w_ih, b, dense = plant.network.cell.w_ih, plant.network.cell.b, plant.network.dense
    i, _, g, o = np.split(inputs @ w_ih.T.astype(np.float64) + b, 4, axis=1)
    hidden = np.tanh(np.tanh(g) / (1.0 + np.exp(-i))) / (1.0 + np.exp(-o))
    expected = (hidden @ dense.w.T + dense.b).reshape(4, 9, 2) * 65.0
    assert np.abs(stems[:, 1:] - expected).max() < 1e-4
    assert (stems[:, 0] == 0.0).all()


def test_without_memory_only_the_last_stem_counts(measured: list[MeasuredRun]) -> None:
    light = np.array([run.light for run in measured]).transpose(1, 0, 2)
    points = np.array([run.points_cm for run in measured]).transpose(1, 0, 2, 3)
    history = History(points, light, 300.0, {})
    after = np.repeat(light[-1:], 20, axis=0)
    plain = simulator()
    watched = run(plain, plain.watch(history), after, 300.0)
    fresh = run(plain, plain.start(points[-1]), after, 300.0)
    assert watched.tobytes() == fresh.tobytes()
    # run statefully, the same network goes elsewhere, through recurrent weights that no training ever touched
    memory = simulator(stateful=True)
    remembered = run(memory, memory.watch(history), after, 300.0)
    assert np.abs(remembered - watched).max() > 0.1
    forgot = run(memory, memory.start(points[-1]), after, 300.0)
    assert np.abs(remembered[0] - forgot[0]).max() > 0.01
    # a first step from the zero state has nothing to remember
    assert forgot[0].tobytes() == fresh[0].tobytes()
    cell, dense = plain.network.cell, plain.network.dense
    other = PaperNetwork(LstmCell(cell.w_ih, cell.w_hh + 1.0, cell.b), dense)
    unlike = PaperSimulator(other, BOX, unit_cm=65.0, step_s=300.0)
    assert run(unlike, unlike.start(points[-1]), after, 300.0).tobytes() == fresh.tobytes()


def test_only_whole_steps_and_either_lamp_are_known(measured: list[MeasuredRun]) -> None:
    plant, points = simulator(), points_of(measured)
    state, light = plant.start(points), np.tile(LEFT, (4, 1))
    for dt_s in (299.0, 150.0, 450.0, 0.0, -300.0, float("nan"), float("inf")):
        with pytest.raises(BadInput, match="multiples of 300 s only"):
            plant.step(state, light, dt_s)
    for levels, said in (((0.0, 0.0), "0 left and 0 right"), ((1.0, 1.0), "1 left and 1 right"), ((0.5, 0.5), "0.5")):
        with pytest.raises(BadInput, match=said):
            plant.step(state, np.array([LEFT, levels, RIGHT, LEFT]), 300.0)
    dark = History(np.stack([points, points]), np.zeros((1, 4, 2)), 300.0, {})
    assert plant.watch(dark).points.shape == (4, 18)
    with pytest.raises(BadInput, match="0 left and 0 right"):
        simulator(stateful=True).watch(dark)
    with pytest.raises(BadInput, match="steps of 600 s"):
        simulator(stateful=True).watch(History(np.stack([points, points]), np.tile(LEFT, (1, 4, 1)), 600.0, {}))


def test_it_knows_where_it_was_shown_nothing() -> None:
    inputs = np.repeat(np.linspace(0.0, 1.0, 10_001, dtype=np.float32)[:, None], 19, axis=1)
    box = Box.around(inputs)
    assert np.abs(box.low - 0.001).max() < 1e-6
    assert np.abs(box.high - 0.999).max() < 1e-6
    plant = PaperSimulator(random_network(1), box, unit_cm=10.0, step_s=300.0)
    inside = np.full((10, 2), 5.0)
    left, high = inside.copy(), inside.copy()
    left[9, 0], high[1, 1] = -0.1, 10.1
    assert plant.is_beyond_data(plant.start(np.stack([inside, left, high]))).tolist() == [False, True, True]


# Its folder


def written(tmp_path: Path, plant: PaperSimulator, **changes: Any) -> Path:
    values: dict[str, Any] = {"weights": dict(plant.weights()), "scales": dict(plant.scales()), **changes}
    provenance = Provenance(recipe="paper", seed=1, software="flora")
    write_simulator(tmp_path / "sim", kind="paper", step_s=plant.step_s, provenance=provenance, **values)
    return tmp_path / "sim"


@pytest.mark.parametrize("stateful", [False, True])
def test_read_again_it_is_the_same_plant(tmp_path: Path, measured: list[MeasuredRun], stateful: bool) -> None:
    plant, points = simulator(stateful=stateful), points_of(measured)
    again = load(written(tmp_path, plant))
    assert isinstance(again, PaperSimulator)
    assert (again.unit_cm, again.step_s, again.stateful) == (65.0, 300.0, stateful)
    light = np.tile(RIGHT, (10, 4, 1))
    assert (
        run(again, again.start(points), light, 300.0).tobytes()
        == run(plant, plant.start(points), light, 300.0).tobytes()
    )
    assert again.box.low.tobytes() == plant.box.low.tobytes()


@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ({"unit_cm": 65.0}, "scales.stateful is None"),
        ({"unit_cm": 65.0, "stateful": 1}, "scales.stateful is 1"),
        ({"stateful": False}, "scales.unit_cm is None"),
        ({"unit_cm": -1.0, "stateful": False}, "must be above 0"),
        ({"unit_cm": True, "stateful": False}, "not a number"),
    ],
)
def test_scales_that_are_wrong_are_told(tmp_path: Path, scales: dict[str, Any], said: str) -> None:
    path = written(tmp_path, simulator(), scales=scales)
    with pytest.raises(BadInput, match=said) as told:
        PaperSimulator.from_stored(read_stored(path))
    assert INFO_FILE in str(told.value)


@pytest.mark.parametrize("name", ["w_ih", "w_hh", "b", "out_w", "out_b", "box_low", "box_high"])
def test_weights_that_are_wrong_are_told(tmp_path: Path, name: str) -> None:
    stored = read_stored(written(tmp_path, simulator()))
    weights: dict[str, Float32Array] = dict(stored.weights)
    for changed, said in (({**weights, name: weights[name][1:]}, f"`{name}` is"), ({**weights}, "holds no")):
        if said == "holds no":
            del changed[name]
        with pytest.raises(BadInput, match=said) as told:
            PaperSimulator.from_stored(Stored(stored.path, stored.info, changed))
        assert WEIGHTS_FILE in str(told.value)
    assert hashlib.sha256((stored.path / WEIGHTS_FILE).read_bytes()).hexdigest() == stored.info.weights_sha256
