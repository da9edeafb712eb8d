"""The compiled losses of free runs and their gradients, beside those that torch differentiates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from flora_lab.simulator.measured import MeasuredRun
from flora_lab.train.sequence_losses import CompiledLosses, TorchLosses
from flora_lab.train.sequence_net import TRAITS, LawNet
from flora_lab.train.windows import Scale, Tracks, Windows, tracks_of, windows_at
from flora_twin.grow import grow

SHAPES = [(4, 32, 40), (1, 50, 36), (3, 16, 21)]
"""Members, cells, steps: a last telling before the window's end, too."""


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    runs = []
    for seed, hours in ((1, 9.0), (2, 5.0)):
        points = grow(seed, "2h", hours).points_cm.copy()
        points[20:26] = np.nan
        lit = np.arange(len(points) - 1) // 24 % 2
        light = np.stack([1.0 - lit, lit.astype(float)], axis=1)
        time_s = 300.0 * np.arange(len(points), dtype=np.float64)
        runs.append(MeasuredRun(str(seed), str(seed), "0" * 64, points, light, time_s, 300.0, {}))
    return tracks_of(runs, mirror=True)


def network(members: int, hidden: int) -> LawNet:
    draw = torch.Generator().manual_seed(3)
    net = LawNet(members, hidden, 2, draw)
    with torch.no_grad():
        net.w_out *= 5.0
        net.b_out.normal_(0.0, 0.3, generator=draw)
        net.traits.normal_(generator=draw)
        net.log_zone += torch.linspace(-0.3, 0.3, members)
    return net


def some_windows(tracks: Tracks, steps: int) -> tuple[Windows, np.ndarray]:
    random = np.random.default_rng(5)
    run = random.integers(0, len(tracks), 31)
    row = np.array([random.choice(np.flatnonzero(tracks.can_start[r])) for r in run])
    row[0] = tracks.rows[run[0]] - 9  # most of it lies beyond the run's end
    return windows_at(tracks, run, row, steps, Scale()), tracks.plant[run]


@pytest.mark.parametrize(("members", "hidden", "steps"), SHAPES)
def test_compiled_losses_and_gradients_are_torchs(tracks: Tracks, members: int, hidden: int, steps: int) -> None:
    windows, plant = some_windows(tracks, steps)
    random = np.random.default_rng(7)
    weight = ((random.random((members, len(plant))) < 0.75) * random.random((members, len(plant)))).astype(np.float32)
    learned = torch.ones(members, 2)
    found, wanted = network(members, hidden), network(members, hidden).double()
    totals = []
    for net, losses in ((found, CompiledLosses(found)), (wanted, TorchLosses(wanted))):
        traits = net.centred_traits(learned.to(net.b.dtype))[:, torch.from_numpy(plant)]
        totals.append(losses.learn(windows, traits, weight))
    assert totals[0] == pytest.approx(totals[1], rel=2e-5)
    exact = dict(wanted.named_parameters())
    for name, parameter in found.named_parameters():
        assert parameter.grad is not None
        assert exact[name].grad is not None
        scale = float(exact[name].grad.abs().max())
        assert scale > 0.0
        np.testing.assert_allclose(parameter.grad.numpy(), exact[name].grad.numpy(), atol=1e-4 * scale, rtol=0.0)


def test_losses_of_unknown_plants_are_torchs_and_need_no_gradient(tracks: Tracks) -> None:
    windows, plant = some_windows(tracks, 36)
    net = network(2, 16)
    weight = np.ones((2, len(plant)), dtype=np.float32)
    told = TorchLosses(net).tell(windows, weight)
    np.testing.assert_allclose(CompiledLosses(net).tell(windows, weight), told, rtol=1e-4, atol=1e-6)
    assert all(parameter.grad is None for parameter in net.parameters())
    assert told.shape == (2, len(plant)) == (2, windows.known.shape[0])
    assert (told[:, windows.known.any(axis=1)] > 0.0).all()


def test_windows_of_no_weight_teach_nothing(tracks: Tracks) -> None:
    windows, plant = some_windows(tracks, 36)
    gradients = []
    for line_cm in (
        windows.line_cm,
        windows.line_cm + np.where(np.arange(len(plant)) < 10, 3.0, 0.0)[:, None, None, None],
    ):
        net = network(2, 16)
        weight = np.tile((np.arange(len(plant)) >= 10).astype(np.float32), (2, 1))
        traits = torch.zeros(2, len(plant), TRAITS, requires_grad=True)
        CompiledLosses(net).learn(replace(windows, line_cm=line_cm.astype(np.float32)), traits, weight)
        gradients.append(net.w_ih.grad)
    assert gradients[0] is not None
    assert torch.equal(gradients[0], gradients[1])
