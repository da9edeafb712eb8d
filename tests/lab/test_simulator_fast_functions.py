"""Functions for SIMD loops: how exact they are, that loops over them are SIMD, and that its width changes nothing."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import pytest

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_lab.simulator.fast_functions import fast_exp, fast_log1p, fast_sincos
from flora_lab.simulator.fast_lstm import MOST_CELLS, lstm_step
from flora_lab.simulator.fast_product import ROWS
from flora_lab.simulator.fast_scratch import row_of, scratch
from flora_lab.simulator.lstm_cell import LstmCell, LstmState
from flora_lab.simulator.lstm_rows import SAID, RowWeights, lined_up, lstm_rows, row_weights
from flora_lab.simulator.neural_law import INPUTS, OUTPUTS, WEIGHTS, NeuralLaw, weight_shapes

jit = numba.njit(error_model="numpy")
on_x86 = pytest.mark.skipif(platform.machine() != "x86_64", reason="names x86 processors and their instructions")
EXACT = 4e-16
exact_reference = pytest.mark.skipif(
    np.finfo(np.longdouble).eps > 1e-18, reason="numpy has no longer numbers here to compare with"
)


@jit
def exps(x: Array, out: Array) -> None:
    for j in range(x.shape[0]):
        out[j] = fast_exp(x[j])


@jit
def logs(x: Array, out: Array) -> None:
    for j in range(x.shape[0]):
        out[j] = fast_log1p(x[j])


@jit
def sines(x: Array, out: Array) -> None:
    for j in range(x.shape[0]):
        out[j] = fast_sincos(x[j])[0]


@jit
def cosines(x: Array, out: Array) -> None:
    for j in range(x.shape[0]):
        out[j] = fast_sincos(x[j])[1]


LOOPS: dict[str, Any] = {"exp": exps, "log1p": logs, "sin": sines, "cos": cosines}


def of(name: str, x: npt.ArrayLike) -> Array:
    told = np.asarray(x, dtype=np.float64)
    out = np.empty_like(told)
    LOOPS[name](told, out)
    return out


def drawn(low: float, high: float) -> Array:
    """A dense grid and random numbers."""
    rng = np.random.default_rng(1)
    return np.concatenate([np.linspace(low, high, 100_001), rng.uniform(low, high, 100_000)])


RIGHT_ANGLES = np.arange(-50, 51) * (np.pi / 2)
CASES = {
    "exp": [drawn(-708.0, 709.0), drawn(-1.0, 1.0), 10.0 ** drawn(-18.0, 0.0)],
    "log1p": [drawn(0.0, 5.0), 10.0 ** drawn(-18.0, 12.0)],
    "sin": [drawn(-7.0, 7.0), drawn(-1e5, 1e5), 10.0 ** drawn(-18.0, 0.0), RIGHT_ANGLES],
    "cos": [drawn(-7.0, 7.0), drawn(-1e5, 1e5), 10.0 ** drawn(-18.0, 0.0), RIGHT_ANGLES],
}


@exact_reference
@pytest.mark.parametrize("name", LOOPS)
def test_they_are_those_of_the_library_but_for_the_last_bits(name: str) -> None:
    function: Callable[[Array], Array] = getattr(np, name)
    for x in CASES[name]:
        right = function(x.astype(np.longdouble))
        error = np.abs(of(name, x) - right) / np.maximum(np.abs(right), np.finfo(np.float64).tiny)
        assert error.max() <= EXACT


def test_nothing_is_nothing_and_signs_are_kept() -> None:
    assert of("exp", [0.0, -0.0]).tolist() == [1.0, 1.0]
    assert of("log1p", [0.0]).tolist() == [0.0]
    assert (of("sin", [0.0])[0], of("cos", [0.0])[0]) == (0.0, 1.0)
    x = drawn(0.0, 30.0)
    assert of("sin", -x).tolist() == (-of("sin", x)).tolist()
    assert of("cos", -x).tobytes() == of("cos", x).tobytes()


def test_the_exponential_ends_where_numbers_do() -> None:
    ends = of("exp", [-708.0, 709.0])
    assert of("exp", [-np.inf, -1e300, -709.0]).tolist() == [ends[0]] * 3
    assert of("exp", [np.inf, 1e300, 710.0]).tolist() == [ends[1]] * 3
    assert 0.0 < ends[0] < 1e-300
    assert 1e300 < ends[1] < np.inf


@pytest.mark.parametrize("name", LOOPS)
def test_what_is_no_number_stays_none(name: str) -> None:
    assert np.isnan(of(name, [np.nan, 1.0])).tolist() == [True, False]
    if name != "exp":
        assert np.isnan(of(name, [np.inf])).all()


@on_x86
@pytest.mark.parametrize("name", LOOPS)
def test_loops_over_them_do_several_at_once(name: str) -> None:
    of(name, [1.0])
    (code,) = LOOPS[name].inspect_asm().values()
    assert re.search(r"\sv?mulpd\s", code)
    assert re.search(r"\bcallq?\s+\S*(exp|log|sin|cos)", code) is None


WIDTHS = """
import hashlib
import numpy as np
from flora_lab.simulator import neural_law, tropism
from flora_lab.simulator.lstm_rows import SAID, lined_up, lstm_rows, row_weights
from flora_lab.simulator.rod import CAPACITY, points_lane

rng, told, out = np.random.default_rng(1), hashlib.sha256(), np.empty((10, 2))
weights = [0.2 * rng.normal(size=s).astype(np.float32) for s in neural_law.weight_shapes(2, 13).values()]
constants = np.array([3.0, 7.0, 6.0, 5.0, 13.0, 0.3, 0.3, 0.7, 20.0])
for learned in (False, True):
    n, length, angle = 19, np.full(CAPACITY, 0.35), np.linspace(0.0, 0.4, CAPACITY)
    seen, memory, traits = np.zeros((2, 2)), np.zeros((2, 2, 13)), rng.normal(size=4)
    for step in range(288):
        (left, right), bias, growth = rng.choice([0.0, 1.0], size=2), 0.05 * rng.normal(), rng.uniform(0.5, 3.0)
        if learned:
            n = neural_law.step_lane(length, angle, n, memory, traits, *weights, 6.0, left, right, bias, growth)
        else:
            lamps_cm = np.array([35.0, 30.0])
            n = tropism.step_lane(length, angle, n, seen, constants, lamps_cm, left, right, bias, growth, 1.0 / 12.0)
        points_lane(length, angle, n, out)
        told.update(out.tobytes())
    assert n > 19 and np.isfinite(out).all()
four = row_weights(dict(zip(neural_law.WEIGHTS, weights)))
inputs, h, c, said = lined_up((8, 13)), lined_up((8, 2, 13)), lined_up((8, 2, 13)), lined_up((8, SAID))
for step in range(20):
    inputs[:7] = rng.normal(size=(7, 13))
    for m in range(2):
        lstm_rows(0, 7, m, four, inputs, h, c, lined_up((4, *four.b.shape[1:])), said)
        told.update(said.tobytes() + h.tobytes() + c.tobytes())
assert np.abs(said[0]).max() > 0.01
print(told.hexdigest())
"""


@pytest.mark.slow
@on_x86
def test_plants_do_not_depend_on_the_width_of_registers() -> None:
    # two numbers at a time, four, and as many as this processor can
    told = set()
    for cpu in ("x86-64", "haswell", "host"):
        environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "NUMBA_CPU_NAME": cpu}
        if cpu == "host":
            del environment["NUMBA_CPU_NAME"]
        else:
            environment["NUMBA_CPU_FEATURES"] = "+avx2" if cpu == "haswell" else "+sse2"
        done = subprocess.run(
            [sys.executable, "-c", WIDTHS], capture_output=True, text=True, timeout=300, check=True, env=environment
        )
        told.add(done.stdout.strip())
    assert len(told) == 1


@jit
def two_scratches(rounds: int) -> tuple[float, float]:
    first, second = scratch(np.float64, 5), scratch(np.float32, 3)
    for _ in range(rounds):
        again = scratch(np.float64, 1)
        again[0] = 7.0
        for j in range(first.shape[0]):
            first[j] = j
        for j in range(second.shape[0]):
            second[j] = 0.1
    return first.sum(), float(second.sum())


def test_scratch_arrays_are_apart_and_of_their_kind() -> None:
    told = two_scratches(3)
    assert told[0] == 10.0
    assert told[1] == pytest.approx(0.3, abs=1e-7)
    assert told[1] != pytest.approx(0.3, abs=1e-12)  # float32


@pytest.mark.parametrize("hidden", [1, 5, 32, MOST_CELLS])
def test_a_step_of_the_lstm_is_that_of_the_plain_cell(hidden: int) -> None:
    rng = np.random.default_rng(hidden)
    shapes = {"w_ih": (13, 4 * hidden), "w_hh": (hidden, 4 * hidden), "b": (4 * hidden,), "w_out": (hidden, 11)}
    w = {name: rng.normal(0.0, 0.5, size=shape).astype(np.float32) for name, shape in shapes.items()}
    end, inputs = rng.normal(size=11).astype(np.float32), rng.normal(size=13).astype(np.float32)
    memory = rng.normal(0.0, 0.5, size=(2, hidden))
    before = LstmState(*memory[:, None].astype(np.float32))
    out = np.empty(11, dtype=np.float32)
    taken(inputs, memory, w["w_ih"], w["w_hh"], w["b"], w["w_out"], end, out)
    after = LstmCell(w["w_ih"].T.copy(), w["w_hh"].T.copy(), w["b"]).step(inputs[None], before)
    assert memory[0] == pytest.approx(after.hidden[0], abs=1e-5)
    assert memory[1] == pytest.approx(after.cell[0], abs=1e-5)
    assert out == pytest.approx(after.hidden[0] @ w["w_out"] + end, abs=1e-4)


@jit
def taken(
    inputs: Array, memory: Array, w_ih: Array, w_hh: Array, b: Array, w_out: Array, b_out: Array, out: Array
) -> None:
    lstm_step(inputs, memory, w_ih, w_hh, b, w_out, b_out, out)


@jit
def one_by_one(
    told: Array, memory: Array, w_ih: Array, w_hh: Array, b: Array, w_out: Array, b_out: Array, said: Array
) -> None:
    for row in range(len(told)):
        for m in range(len(b)):
            lstm_step(told[row], memory[row, m], w_ih[m], w_hh[m], b[m], w_out[m], b_out[m], said[m, row])


@jit
def four_at_once(
    rows: int, weights: RowWeights, told: Array, hidden: Array, cell: Array, gates: Array, said: Array
) -> None:
    for m in range(len(said)):
        lstm_rows(0, rows, m, weights, told, hidden, cell, gates, said[m])


@pytest.mark.parametrize("cells", [1, 5, 32, MOST_CELLS])
@pytest.mark.parametrize("rows", [1, 4, 7])
def test_plants_at_once_are_those_one_by_one_to_the_bit(cells: int, rows: int) -> None:
    rng, members = np.random.default_rng([cells, rows]), 3
    weights = {
        name: rng.normal(0.0, 0.5, size=shape).astype(np.float32)
        for name, shape in weight_shapes(members, cells).items()
    }
    told = lined_up((-(-rows // ROWS) * ROWS, INPUTS))
    told[:rows] = rng.normal(size=(rows, INPUTS))
    memory = rng.normal(0.0, 0.5, size=(rows, members, 2, cells)).astype(np.float32)
    hidden, cell = lined_up((len(told), members, cells)), lined_up((len(told), members, cells))
    hidden[:rows], cell[:rows] = memory[:, :, 0], memory[:, :, 1]
    packed = row_weights(weights)
    gates, together = lined_up((ROWS, *packed.b.shape[1:])), lined_up((members, len(told), SAID))
    alone, kept = np.empty((members, rows, OUTPUTS), dtype=np.float32), memory.astype(np.float64)
    for _ in range(3):
        one_by_one(told[:rows], kept, *(weights[name] for name in WEIGHTS), alone)
        four_at_once(rows, packed, told, hidden, cell, gates, together)
        assert together[:, :rows, :OUTPUTS].tobytes() == alone.tobytes()
        assert hidden[:rows].tobytes() == kept[:, :, 0].astype(np.float32).tobytes()
        assert cell[:rows].tobytes() == kept[:, :, 1].astype(np.float32).tobytes()
    assert np.abs(alone).min() > 0.0


@jit
def of_rows(array: Array) -> tuple[float, float, int]:
    total = 0.0
    for i in range(array.shape[0]):
        for j in range(array.shape[1]):
            total += 10.0**j * row_of(row_of(array, i), j).sum()
    row_of(array, 1)[0, 0] = -1.0
    return total, row_of(array, array.shape[0] - 1)[0, 0], row_of(array, 0).ndim


def test_rows_that_are_looked_at_are_those_of_the_array() -> None:
    array = np.arange(12.0).reshape(2, 3, 2)
    told = of_rows(array.copy())
    assert told == (sum(10.0**j * array[:, j].sum() for j in range(3)), -1.0, 2)


def test_a_network_that_there_is_no_room_for_is_refused() -> None:
    for cells in (MOST_CELLS, MOST_CELLS + 1):
        weights = {name: np.zeros(shape) for name, shape in weight_shapes(1, cells).items()}
        if cells <= MOST_CELLS:
            assert NeuralLaw(weights, 6.0).memory_shape == (1, 2, cells)
        else:
            with pytest.raises(BadInput, match=f"{cells} cells per member; there is room for {MOST_CELLS}"):
                NeuralLaw(weights, 6.0)
