"""The compiled training loop of the paper's network, held to the readable one in torch."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from flora_common.arrays import Float32Array
from flora_lab.simulator.fast_tanh import fast_tanh
from flora_lab.simulator.lstm_cell import Dense, LstmCell
from flora_lab.simulator.paper import CELLS, COORDINATES, INPUTS, PaperNetwork
from flora_lab.train import fused_step, torch_reference
from flora_lab.train.fused_step import Training
from flora_lab.train.paper import initial_network
from flora_lab.train.torch_reference import ReferenceNetwork

torch.set_num_threads(1)


def rows(count: int, seed: int = 1) -> tuple[Float32Array, Float32Array]:
    """Inputs and outputs about as large as stems in units, and a light."""
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-0.3, 0.4, (count, INPUTS))
    inputs[:, -1] = rng.integers(0, 2, count)
    outputs = inputs[:, :COORDINATES] + 0.01 * rng.standard_normal((count, COORDINATES))
    return inputs.astype(np.float32), outputs.astype(np.float32)


def network(seed: int = 1, scale: float = 1.0) -> PaperNetwork:
    """Weights at the start of a training, or larger ones."""
    start = initial_network(np.random.default_rng(seed))
    cell = LstmCell(scale * start.cell.w_ih, start.cell.w_hh, scale * start.cell.b)
    bias = np.random.default_rng(seed).normal(size=COORDINATES)
    return PaperNetwork(cell, Dense.of(start.dense.w, 0.1 * bias))


def torch_gradients(net: PaperNetwork, inputs: Float32Array, outputs: Float32Array) -> dict[str, torch.Tensor]:
    """By autograd in float64, all parameters included."""
    reference = ReferenceNetwork.of(net).double()
    for parameter in reference.parameters():
        parameter.requires_grad_(True)
    predicted = reference(torch.from_numpy(inputs).double())
    torch.autograd.backward(torch.nn.functional.l1_loss(predicted, torch.from_numpy(outputs).double()))
    gradients = {name: parameter.grad for name, parameter in reference.named_parameters()}
    return {name: gradient for name, gradient in gradients.items() if gradient is not None}


def packed(gradients: dict[str, torch.Tensor]) -> Float32Array:
    """In the places of ``theta``."""
    values = {name: gradient.numpy() for name, gradient in gradients.items()}
    cell = LstmCell(values["lstm.weight_ih_l0"], values["lstm.weight_hh_l0"], values["lstm.bias_ih_l0"])
    return fused_step.pack(PaperNetwork(cell, Dense.of(values["dense.weight"], values["dense.bias"])))


def test_its_tanh_is_that_of_the_library() -> None:
    x = np.concatenate([np.linspace(-20.0, 20.0, 40_001), np.geomspace(1e-30, 1.0, 200)]).astype(np.float32)
    got = np.array([fast_tanh(value) for value in x])
    assert np.abs(got - np.tanh(x.astype(np.float64))).max() < 5e-7
    small = np.abs(x) < 1.0
    assert np.abs(got[small] - np.tanh(x[small])).max() < 5e-7
    assert (np.sign(got) == np.sign(x)).all()


def test_packing_keeps_what_is_trained_and_unpacking_takes_the_rest_from_the_start() -> None:
    net, other = network(1), network(2)
    back = fused_step.unpack(fused_step.pack(net), other)
    trained = np.ones(4 * CELLS, dtype=bool)
    trained[CELLS : 2 * CELLS] = False
    for name in ("w_ih", "b"):
        new, a, b = (getattr(n.cell, name) for n in (back, net, other))
        assert np.array_equal(new[trained], a[trained])
        assert np.array_equal(new[~trained], b[~trained])
    assert np.array_equal(back.cell.w_hh, other.cell.w_hh)
    assert np.array_equal(back.dense.w, net.dense.w)
    assert np.array_equal(back.dense.b, net.dense.b)
    # and the forward pass is the network's, though not a weight of the forget gate is in it
    inputs, outputs = rows(100)
    theta, every = fused_step.pack(net), np.arange(100)
    by_numpy = float(np.abs(net(inputs)[0].astype(np.float64) - outputs).mean())
    assert fused_step.mean_absolute_error(theta, inputs, outputs, every) == pytest.approx(by_numpy, rel=1e-5)
    assert fused_step.mean_absolute_error(theta, inputs, outputs, every[:1]) != pytest.approx(by_numpy, rel=1e-3)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 70), st.integers(0, 2**32 - 1), st.sampled_from([1.0, 5.0]))
def test_gradients_are_those_of_autograd(count: int, seed: int, scale: float) -> None:
    inputs, outputs = rows(count, seed)
    net = network(seed, scale)
    expected = packed(torch_gradients(net, inputs, outputs))
    got = fused_step.gradient(fused_step.pack(net), inputs, outputs)
    assert np.abs(expected).max() > 1e-3
    assert np.abs(got - expected).max() < 5e-6 * np.abs(expected).max()


def test_from_the_zero_state_recurrent_weights_and_forget_gate_have_no_gradient_at_all() -> None:
    gradients = torch_gradients(network(), *rows(64))
    assert torch.count_nonzero(gradients["lstm.weight_hh_l0"]) == 0
    forget = slice(CELLS, 2 * CELLS)
    for name in ("lstm.weight_ih_l0", "lstm.bias_ih_l0", "lstm.bias_hh_l0"):
        assert torch.count_nonzero(gradients[name][forget]) == 0
        assert torch.count_nonzero(gradients[name]) == 3 * gradients[name].numel() // 4


@pytest.mark.parametrize(("count", "batch"), [(1210, 30), (640, 64), (50, 7)])
def test_an_epoch_ends_in_the_weights_of_the_torch_loop(count: int, batch: int) -> None:
    inputs, outputs = rows(count)
    order = np.random.default_rng(3).permutation(count)
    start = network()
    reference = ReferenceNetwork.of(start).double()
    optimiser = torch_reference.adam(reference)
    expected_loss = torch_reference.train_epoch(reference, optimiser, inputs, outputs, order, batch)
    expected = fused_step.pack(reference.network())
    training = Training.of(start)
    loss, steps = fused_step.train_epoch(training, 0, inputs, outputs, order, batch)
    assert steps == -(-count // batch)
    assert loss == pytest.approx(expected_loss, rel=1e-5)
    moved = np.abs(expected - fused_step.pack(start))
    assert moved.max() > 0.004
    assert np.abs(training.theta - expected).max() < 0.02 * moved.max()
    assert np.abs(training.theta - expected).mean() < 1e-4 * moved.mean()
    assert np.array_equal(reference.network().cell.w_hh, start.cell.w_hh)


def test_what_fills_up_stays_zero() -> None:
    inputs, outputs = rows(300)
    training, ones = Training.of(network()), np.ones(1)
    fused_step.train_epoch(training, 0, inputs, outputs, np.arange(300), 30)
    full = PaperNetwork(
        LstmCell(np.broadcast_to(ones, (4 * CELLS, INPUTS)), np.zeros((4 * CELLS, CELLS)), np.ones(4 * CELLS)),
        Dense.of(np.ones((COORDINATES, CELLS)), np.ones(COORDINATES)),
    )
    used = fused_step.pack(full) == 1.0
    assert used.sum() == 150 * (INPUTS + 1) + COORDINATES * (CELLS + 1)
    for array in (training.theta, training.first, training.second):
        assert (array[~used] == 0.0).all()
        assert (array[used] != 0.0).mean() > 0.99


def test_rows_are_taken_in_the_order_told_and_others_are_left_alone() -> None:
    inputs, outputs = rows(90)
    order = np.array([5, 80, 3, 44, 12, 9, 60])
    one, two = Training.of(network()), Training.of(network())
    first = fused_step.train_epoch(one, 0, inputs, outputs, order, 3)
    second = fused_step.train_epoch(two, 0, inputs[order], outputs[order], np.arange(7), 3)
    assert first == second
    assert one.theta.tobytes() == two.theta.tobytes()
    three = Training.of(network())
    fused_step.train_epoch(three, 0, inputs, outputs, order[::-1].copy(), 3)
    assert three.theta.tobytes() != one.theta.tobytes()


DIGEST = "import test_train_fused as t; print(t.digest_after_an_epoch())"


def digest_after_an_epoch() -> str:
    """Of all weights after a short training."""
    inputs, outputs = rows(500)
    training = Training.of(network())
    fused_step.train_epoch(training, 0, inputs, outputs, np.random.default_rng(1).permutation(500), 30)
    error = fused_step.mean_absolute_error(training.theta, inputs, outputs, np.arange(500))
    return hashlib.sha256(training.theta.tobytes() + repr(error).encode()).hexdigest()


def test_compiled_anew_for_another_processor_it_gives_the_same_bits(tmp_path: Path) -> None:
    """Fused multiplication and addition, which numba can be allowed, breaks this; so does the width of registers."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(__file__).parent)}
    other = {**env, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    command = [sys.executable, "-c", DIGEST]
    done = subprocess.run(command, env=other, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == digest_after_an_epoch()
