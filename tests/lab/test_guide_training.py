"""The stem finder's network is trained in floating point and used in whole numbers: the two must agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from flora_common.vision.path.convolutions import CHANNELS, MOST, Network
from guide import training
from guide.canvas import PX_PER_CM
from guide.examples import Example, read_examples, write_examples
from guide.samples import SIDE, sample, wanted
from guide.training import BATCH, Batches, Trained, averaged, train
from guide.whole import arrays_of, in_whole_numbers
from guide.wild import wild_example

SEEDS = range(3_000_000, 3_000_004)


@pytest.fixture(scope="module")
def plants() -> list[Example]:
    return [wild_example(seed) for seed in SEEDS]


def test_whole_numbers_say_what_floating_point_says(plants: list[Example]) -> None:
    """Of a network whose weights are drawn, and whose normalisation has seen some samples."""
    torch.manual_seed(3)
    net, rng = Trained(), np.random.default_rng(4)
    seen = torch.from_numpy(np.stack([sample(plants[k % len(plants)], rng)[0] for k in range(16)]))
    with torch.no_grad():
        for _ in range(20):
            net(seen)
        net.eval()
        whole = torch.round(seen)
        said = net(whole).numpy()
    network = Network(in_whole_numbers(net, seen))
    found = np.stack([network(one.numpy()) for one in whole])
    assert found.shape == said.shape == (16, 2, SIDE // 2, SIDE // 2)
    assert np.abs(found - said).mean() < 0.05 * said.std()
    for layer in arrays_of(in_whole_numbers(net, seen)).values():
        assert layer.dtype in (np.int16, np.float32)


def test_training_that_was_stopped_goes_on_to_the_same_weights(
    plants: list[Example], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "BATCH", 2)
    monkeypatch.setattr(training, "SAVED_EVERY", 2)

    class Stopped(Exception):
        pass

    def stop_in_the_third_step(*_: object) -> None:
        raise Stopped

    straight = train([plants], [1.0], 4, tmp_path / "straight.pt", 1, lambda *_: None)
    original, calls = training.sample, 0

    def sampled(example: Example, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        nonlocal calls
        calls += 1
        if calls > 2 * 2 + 1:
            stop_in_the_third_step()
        return original(example, rng)

    with monkeypatch.context() as patch:
        patch.setattr(training, "sample", sampled)
        with pytest.raises(Stopped):
            train([plants], [1.0], 4, tmp_path / "stopped.pt", 1, lambda *_: None)
    again = train([plants], [1.0], 4, tmp_path / "stopped.pt", 1, lambda *_: None)
    for name, value in straight.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


def test_the_mean_of_two_networks_has_their_mean_weights_and_a_normalisation_of_its_own(
    plants: list[Example], tmp_path: Path
) -> None:
    torch.manual_seed(3)
    early, late = Trained().state_dict(), Trained()
    now = {k: v.clone() for k, v in late.state_dict().items()}
    torch.save({"net": early}, tmp_path / "early.pt")
    some = Batches([plants], [1.0], range(3), BATCH)
    net = averaged(late, tmp_path / "early.pt", 0.75, (some[k] for k in range(3)))
    name = next(k for k in now if k.endswith("0.weight"))
    assert torch.allclose(net.state_dict()[name], 0.75 * now[name] + 0.25 * early[name])
    first = net.layers["e0"]
    with torch.no_grad():
        before = torch.cat([first[0](some[k][0]) for k in range(3)])
        after = first[1](before)
    assert float(after.mean(dim=(0, 2, 3)).abs().max()) < 0.05
    assert not net.training


def test_examples_are_kept_as_they_are(plants: list[Example], tmp_path: Path) -> None:
    write_examples(tmp_path / "some.npz", plants)
    for one, kept in zip(plants, read_examples(tmp_path / "some.npz"), strict=True):
        assert np.array_equal(one.plant, kept.plant)
        assert np.array_equal(one.code, kept.code)
        assert np.array_equal(one.line, kept.line)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wild_stem_lies_on_its_plant(seed: int) -> None:
    """Half of it at least: leaves before it are plant, too, and a stem as bright as the board hardly shows."""
    example = wild_example(seed)
    x, y = np.rint(example.line).astype(int).T
    assert (np.diff(example.line, axis=0) != 0).any(axis=1).all()
    assert np.hypot(*np.diff(example.line, axis=0).T).max() < PX_PER_CM / 2
    assert (example.plant[y, x] > 0).mean() > 0.5
    assert np.array_equal(wild_example(seed).code, example.code)


def test_a_sample_is_what_the_network_takes_and_its_answer_lies_on_the_stem(plants: list[Example]) -> None:
    rng = np.random.default_rng(1)
    for plant in plants:
        seen, maps = sample(plant, rng)
        assert seen.shape == (CHANNELS, SIDE, SIDE)
        assert 0.0 <= seen.min() <= seen.max() <= MOST
        assert maps.shape == (2, SIDE // 2, SIDE // 2)
    stem, apex = wanted(np.column_stack([np.full(30, 40.0), np.linspace(70.0, 20.0, 30)]))
    assert np.unravel_index(int(apex.argmax()), apex.shape) == (20, 40)
    assert stem[20:70, 40].min() > 0.9
    assert stem[:, 50].max() < 0.1
