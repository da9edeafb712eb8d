"""The stem finder's network is trained in floating point and used in whole numbers: the two must agree."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from flora_common.vision.path.convolutions import CHANNELS, MOST, Network
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import in_steps, mean_colour
from guide import training
from guide.canvas import PX_PER_CM
from guide.examples import Example
from guide.packed import Packed, packed
from guide.pool import APEX_PX, SIDE, Pool
from guide.training import Trained, averaged, loss, train
from guide.whole import arrays_of, in_whole_numbers
from guide.wild import wild_example

SEEDS = range(3_000_000, 3_000_004)
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def plants() -> list[Example]:
    return [wild_example(seed) for seed in SEEDS]


@pytest.fixture(scope="module")
def pool(plants: list[Example]) -> Pool:
    return pool_of(plants)


def pool_of(plants: list[Example]) -> Pool:
    some = packed(plants)
    found = Pool([1.0], len(some.pixels), CPU)
    assert found.add(0, some)
    return found


def test_whole_numbers_say_what_floating_point_says(pool: Pool) -> None:
    """Of a network whose weights are drawn, and whose normalisation has seen some samples."""
    torch.manual_seed(3)
    net = Trained()
    seen, _ = pool.sample(16)
    with torch.no_grad():
        for _ in range(20):
            net(seen)
        net.eval()
        whole = torch.round(seen)
        said = net(whole).numpy()
    network = Network(in_whole_numbers(net, seen))
    found = np.stack([network(np.ascontiguousarray(one.numpy())) for one in whole])
    assert found.shape == said.shape == (16, 2, SIDE // 2, SIDE // 2)
    assert np.abs(found - said).mean() < 0.05 * said.std()
    for layer in arrays_of(in_whole_numbers(net, seen)).values():
        assert layer.dtype in (np.int16, np.float32)
    spread = Network(in_whole_numbers(net, seen, (1.5, -0.4)))(np.ascontiguousarray(whole[0].numpy()))
    assert np.allclose(spread[1], 1.5 * found[0, 1] - 0.4, atol=1e-4)
    assert np.array_equal(spread[0], found[0, 0])


def test_training_that_was_stopped_goes_on_to_the_same_weights(
    pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "BATCH", 2)
    monkeypatch.setattr(training, "SAVED_EVERY", 2)

    class Stopped(Exception):
        pass

    def progress(steps: int, _elapsed_s: float) -> float:
        return steps / 4

    def stopped(steps: int, elapsed_s: float) -> float:
        if steps == 3:
            raise Stopped
        return progress(steps, elapsed_s)

    straight = train(pool, progress, tmp_path / "straight.pt", lambda *_: None)
    with pytest.raises(Stopped):
        train(pool, stopped, tmp_path / "stopped.pt", lambda *_: None)
    again = train(pool, progress, tmp_path / "stopped.pt", lambda *_: None)
    for name, value in straight.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


def test_training_goes_on_for_so_long_and_takes_in_what_comes(
    plants: list[Example], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "BATCH", 2)
    monkeypatch.setattr(training, "TOLD_EVERY", 2)
    some = packed(plants[:2])
    pool = Pool([1.0], 2 * len(some.pixels), CPU)
    assert pool.add(0, some)
    elapsed: list[float] = []

    def progress(_steps: int, elapsed_s: float) -> float:
        elapsed.append(elapsed_s)
        return 1.0 if elapsed_s > 0.2 else 0.0

    net = train(pool, progress, tmp_path / "some.pt", lambda *_: None, lambda: pool.add(0, some) and None)
    assert not net.training
    assert pool.counts == [4]  # and no more, for there is no room
    assert elapsed == sorted(elapsed)
    assert elapsed[-1] > 0.2


def test_the_mean_of_two_networks_has_their_mean_weights_and_a_normalisation_of_its_own(
    pool: Pool, tmp_path: Path
) -> None:
    torch.manual_seed(3)
    early, late = Trained().state_dict(), Trained()
    now = {k: v.clone() for k, v in late.state_dict().items()}
    torch.save({"net": early}, tmp_path / "early.pt")
    net = averaged(late, tmp_path / "early.pt", 0.75, pool, 3)
    name = next(k for k in now if k.endswith("0.weight"))
    assert torch.allclose(net.state_dict()[name], 0.75 * now[name] + 0.25 * early[name])
    first = net.layers["e0"]
    torch.manual_seed(training.SEED)
    with torch.no_grad():
        before = torch.cat([first[0](pool.sample(training.BATCH)[0]) for _ in range(3)])
        after = first[1](before)
    assert float(after.mean(dim=(0, 2, 3)).abs().max()) < 0.05
    assert not net.training


def test_examples_are_kept_as_they_are(plants: list[Example], tmp_path: Path) -> None:
    some = packed(plants)
    some.write(tmp_path / "some.npz")
    kept = Packed.read(tmp_path / "some.npz")
    for name in Packed.__slots__:
        assert np.array_equal(getattr(some, name), getattr(kept, name))
    start = 0
    for k, one in enumerate(plants):
        width, height = some.size[k].astype(int)
        assert (height, width) == one.plant.shape
        planes = some.pixels[start : start + height * width].reshape(height, width, -1)
        assert np.array_equal(planes[..., 0], one.plant)
        assert np.array_equal(planes[..., 1:4], one.code)
        x, y = np.rint(one.line).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        assert planes[y[inside], x[inside], 4].max() <= 8  # the stem is within two px of itself
        assert np.allclose(some.line[k][[0, -1]], one.line[[0, -1]], atol=1e-3)
        start += height * width
    assert start == len(some.pixels)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wild_stem_lies_on_its_plant(seed: int) -> None:
    """Half of it at least: leaves before it are plant, too, and a stem as bright as the board hardly shows."""
    example = wild_example(seed)
    x, y = np.rint(example.line).astype(int).T
    assert (np.diff(example.line, axis=0) != 0).any(axis=1).all()
    assert np.hypot(*np.diff(example.line, axis=0).T).max() < PX_PER_CM / 2
    assert (example.plant[y, x] > 0).mean() > 0.5
    assert np.array_equal(wild_example(seed).code, example.code)


def test_a_sample_is_what_the_network_takes_and_its_answer_lies_on_the_stem(pool: Pool) -> None:
    torch.manual_seed(1)
    seen, maps = pool.sample(32)
    assert seen.shape == (32, CHANNELS, SIDE, SIDE)
    assert 0.0 <= float(seen.min()) <= float(seen.max()) <= MOST
    assert maps.shape == (32, 2, SIDE // 2, SIDE // 2)
    at_apex = maps[:, 1].flatten(1).max(dim=1)
    assert (at_apex.values > 0.86).sum() > 16  # the nearest pixel is within 0.71 px of it
    for k in torch.nonzero(at_apex.values > 0.86).flatten():
        assert float(maps[k, 0].flatten()[at_apex.indices[k]]) > 0.5
    apex = torch.tensor([[40.0, 20.0]])
    away = (torch.arange(SIDE // 2).float() - 40.0).abs().expand(1, SIDE // 2, -1)
    stem, end = pool.wanted(away, apex)[0]
    assert divmod(int(end.argmax()), SIDE // 2) == (20, 40)
    assert float(stem[20:70, 40].min()) > 0.9
    assert float(stem[:, 50].max()) < 0.1


def test_crops_are_where_the_plant_is_and_in_the_steps_that_the_finder_takes(
    plants: list[Example], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without chance, a crop is the plant about its apex at its own scale, as the finder shows it to the network."""
    pool, plant = pool_of(plants[:1]), plants[0]
    for name, value in (("rand", 0.5), ("randn", 0.0)):
        monkeypatch.setattr(torch, name, lambda *size, value=value, device: torch.full(_flat(size), value))
    seen, maps = pool.sample(1)
    scale = 12.0 / PX_PER_CM
    to_example = np.array([[1 / scale, 0, 0], [0, 1 / scale, 0]])
    to_example[:, 2] = plant.line[-1] - 0.5 * (SIDE - 1) / scale
    shown = in_steps(
        plant.plant.astype(np.float32),
        plant.code.astype(np.float32),
        mean_colour(Evidence((0, 0), plant.plant, plant.code, 1.0)),
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    expected = cv2.warpAffine(shown, to_example, (SIDE, SIDE), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    assert np.abs(seen[0].permute(1, 2, 0).numpy() - expected).mean() < 0.5
    row, column = divmod(int(maps[0, 1].argmax()), SIDE // 2)
    assert abs(row - (SIDE / 4 - 0.5)) <= 0.5
    assert abs(column - (SIDE / 4 - 0.5)) <= 0.5


def test_an_apex_counts_wherever_in_its_pixel_it_lies() -> None:
    """The loss asks for one pixel of each apex, and for none where there is no apex."""
    pool_size = SIDE // 2
    rows, columns = torch.meshgrid(torch.arange(pool_size), torch.arange(pool_size), indexing="ij")

    def maps(x: float, y: float) -> torch.Tensor:
        near = torch.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / APEX_PX**2)
        return torch.stack([torch.zeros_like(near), near])[None]

    said = torch.full((1, 2, pool_size, pool_size), -4.0)
    found = said.clone()
    found[0, 1, 20, 40] = 4.0
    for x, y in ((40.0, 20.0), (40.45, 20.3), (39.52, 20.45)):
        assert float(loss(found, maps(x, y))) < float(loss(said, maps(x, y)))
    assert float(loss(found, maps(-50.0, 20.0))) > float(loss(said, maps(-50.0, 20.0)))


def _flat(size: tuple[object, ...]) -> tuple[int, ...]:
    return tuple(size[0]) if size and isinstance(size[0], tuple) else size  # type: ignore[arg-type,return-value]
