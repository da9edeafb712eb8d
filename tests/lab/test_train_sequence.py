"""``--recipe sequence``: what is held out, what is learned, and a training that goes on to the bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from simulator_fakes import write_track

from flora_common.arrays import Array
from flora_common.errors import BadInput
from flora_common.runs import CameraSection, RunFile, run_file_text
from flora_lab.main import main
from flora_lab.run_tracks import RunTrack, load_runs
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.law import Stems
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun, in_steps
from flora_lab.simulator.neural_law import NeuralLaw
from flora_lab.simulator.rod import CAPACITY
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import read_stored
from flora_lab.train.checkpoint import Checkpoint, checkpoint_path
from flora_lab.train.recipes import TrainOptions
from flora_lab.train.sequence import judge, train
from flora_lab.train.sequence_fit import Curve, SequenceSettings, SequenceTraining, held_out
from flora_lab.train.sequence_net import LawNet, free_run
from flora_lab.train.windows import tracks_of
from flora_twin.runs import dataset_runs

torch.set_num_threads(1)
numba.set_num_threads(1)


SMALL = SequenceSettings(members=2, hidden=8, steps=24, windows=8, rate=8e-3, epochs=4, patience=50)


class Silent:
    """A :class:`flora_lab.train.recipes.Progress` that says nothing, and may end the training in an epoch."""

    def __init__(self, ends_in: int = 0) -> None:
        self.ends_in = ends_in

    def note(self, text: str) -> None: ...
    def stage(self, name: str) -> None: ...
    def begin(self, epochs: int, done: int = 0) -> None: ...

    def epoch(self, number: int, losses: Mapping[str, float], patience_left: int | None = None) -> None:
        assert all(np.isfinite(loss) for loss in losses.values())
        if number == self.ends_in:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def measured() -> list[MeasuredRun]:
    """Six plants of the virtual box, a day each."""
    virtual = dataset_runs(40, open_loops=3, closed_loops=1, random_loops=2, hours=24.0)
    return [
        in_steps(RunTrack(r.name, r.run_file.plant, Path(f"{r.name}.csv"), f"{i:064d}", r.track))
        for i, r in enumerate(virtual)
    ]


def cut(one: MeasuredRun, rows: int) -> MeasuredRun:
    return replace(one, points_cm=one.points_cm[:rows], light=one.light[: rows - 1], time_s=one.time_s[:rows])


def written(folder: Path, runs: Sequence[MeasuredRun]) -> list[Path]:
    """Folders of their first six hours."""
    for one in runs:
        write_track(folder / one.name / "track.csv", cut(one, 73))
        about = RunFile(camera=CameraSection(anchor_px=(820.0, 1100.0), px_per_cm=20.0), plant=one.plant)
        (folder / one.name / "run.toml").write_text(run_file_text(about))
    return [folder / one.name for one in runs]


def trained(
    runs: Sequence[MeasuredRun], folder: Path, settings: SequenceSettings = SMALL, seed: int = 1
) -> tuple[SequenceTraining, Curve]:
    training = SequenceTraining(tracks_of(runs, mirror=settings.mirror), settings, seed)
    return training, training.run(Checkpoint(folder / "checkpoint", {}), Silent(), resume=False)


def weights_of(training: SequenceTraining) -> dict[str, bytes]:
    return {name: value.detach().cpu().numpy().tobytes() for name, value in training.net.state_dict().items()}


# The learned law in torch and as it is simulated


def chain(length: Array, angle: Array, law: NeuralLaw) -> Stems:
    count = np.full(len(length), length.shape[1])
    room = np.zeros((len(length), CAPACITY - length.shape[1]))
    lengths, angles = (np.concatenate([part, room], axis=1) for part in (length, angle))
    return Stems(lengths, angles, count, np.zeros((len(length), *law.memory_shape)))


@pytest.mark.parametrize(("growth", "most_cm"), [(-30.0, 2e-5), (0.0, 0.05)])
def test_what_is_learned_is_what_is_simulated(measured: list[MeasuredRun], growth: float, most_cm: float) -> None:
    """But for growth: the simulated law looks where tissue has come to at each step, the other each half hour."""
    steps, windows = 72, 12
    net = LawNet(2, 8, 6, torch.Generator().manual_seed(3))
    with torch.no_grad():
        net.w_out.mul_(3.0)
        net.b_out[:, -1] = growth
    tracks = tracks_of(measured, mirror=True)
    row = np.array([0, 60])[np.arange(windows) % 2]
    length, angle = (part[np.arange(windows), row] for part in (tracks.length, tracks.angle))
    rng = np.random.default_rng(1)
    light = rng.choice([0.0, 1.0], size=(steps // 12, windows, 2)).repeat(12, axis=0).astype(np.float32)
    traits = rng.normal(size=(windows, 3)).astype(np.float32)  # in training, early and late growth are one
    with torch.no_grad():
        begin = (torch.from_numpy(part).expand(2, -1, -1) for part in (length, angle))
        told = free_run(net, next(begin), next(begin), torch.from_numpy(light), torch.from_numpy(traits), 6)
    moved = 0.0
    for m in range(2):
        law = NeuralLaw(net.law_weights(), float(np.exp(net.log_zone[m].item()))).member(m)
        stems = chain(length, angle, law)
        out = np.empty((steps // 6, windows, 10, 2))
        still, whole = np.zeros((steps, windows)), np.ones((steps, windows))
        law.advance(stems, traits[:, [0, 0, 1, 2]], light, still, whole, 1 / 12, 6, out)
        for k, (lengths, angles) in enumerate(told):
            tips = np.stack([(lengths * turn(angles)).sum(-1)[m].numpy() for turn in (torch.sin, torch.cos)], axis=-1)
            assert np.abs(tips - out[k, :, -1]).max() < most_cm, (m, k)
        moved = max(moved, float(np.abs(out[-1, :, -1] - out[0, :, -1]).max()))
    assert moved > 0.5


# What a member never sees


def test_each_plant_is_held_out_by_some_member_and_none_by_all() -> None:
    for plants, members in ((3, 4), (4, 4), (6, 4), (12, 4), (6, 2), (5, 1)):
        held = held_out(plants, members, 1)
        assert held.shape == (members, plants)
        assert held.any(axis=1).all()
        assert (held.sum(axis=1) <= max(1, -(-plants // 2))).all()
        assert held_out(plants, members, 1).tobytes() == held.tobytes()
    assert not held_out(2, 4, 1).any()
    assert held_out(12, 4, 1).any(axis=0).all()


def test_a_member_never_learns_from_plants_held_out(measured: list[MeasuredRun], tmp_path: Path) -> None:
    """With a single epoch there is no choice among epochs, in which held-out plants rightly have a say."""
    settings = replace(SMALL, epochs=1)
    training, _ = trained(measured, tmp_path, settings)
    alone = int(np.argmax(training.held[0] & ~training.held[1]))
    assert training.held[:, alone].tolist() == [True, False]
    name = sorted({one.plant for one in measured})[alone]
    other = [replace(one.mirrored(), light=one.light) if one.plant == name else one for one in measured]
    changed, _ = trained(other, tmp_path, settings)
    before, after = training.net.law_weights(), changed.net.law_weights()
    assert not np.array_equal(before["w_hh"][1], after["w_hh"][1])  # who learned from it knows
    assert {key: float(np.abs(before[key][0] - after[key][0]).max()) for key in before} == dict.fromkeys(before, 0.0)


# Learning


def test_plants_never_seen_are_foretold(measured: list[MeasuredRun], tmp_path: Path) -> None:
    training, curve = trained(measured, tmp_path, replace(SMALL, steps=72, epochs=16, hidden=12))
    assert curve.validate[-1] < 0.6 * curve.validate[0]
    assert curve.train[-1] < 0.5 * curve.train[0]
    law = NeuralLaw(training.net.law_weights(), float(np.exp(training.net.log_zone.detach().numpy()).mean()))
    prior = Prior(np.zeros(len(law.traits)), np.eye(len(law.traits)))
    plant = SequenceSimulator(law, prior, DriveNoise(), DataRange(30.0, 10.0))
    judged = judge(plant, measured, training.held, training.tracks.plant[: len(measured)])
    tip_mm, still_mm = np.nanmedian(judged.tip_mm, axis=0), np.nanmedian(judged.still_mm, axis=0)
    assert (tip_mm[1:] < 0.5 * still_mm[1:]).all()


def test_the_same_seed_gives_the_same_bytes(measured: list[MeasuredRun], tmp_path: Path) -> None:
    runs = [cut(one, 73) for one in measured]
    one, again, other = (weights_of(trained(runs, tmp_path, seed=seed)[0]) for seed in (1, 1, 2))
    assert one == again
    assert all(one[name] != other[name] for name in one)


def test_gaps_are_no_trouble(measured: list[MeasuredRun], tmp_path: Path) -> None:
    runs = []
    for i, one in enumerate(measured[:4]):
        points = one.points_cm.copy()
        points[5 + i : 20], points[30 : 40 : i + 1] = np.nan, np.nan
        runs.append(cut(replace(one, points_cm=points), 97 - 12 * i))  # and not all are as long
    training, curve = trained(runs, tmp_path)
    assert np.isfinite(curve.train + curve.validate).all()
    assert curve.train[-1] < curve.train[0]
    assert all(np.isfinite(array).all() for array in training.net.law_weights().values())


def test_mirror_images_are_other_tracks_of_the_same_plants(measured: list[MeasuredRun]) -> None:
    plain, both = (tracks_of(measured, mirror=mirror) for mirror in (False, True))
    assert (len(plain), len(both), both.plants) == (6, 12, 6)
    assert both.vectors == 2 * plain.vectors == 2 * 6 * 288
    assert np.array_equal(both.plant[6:], both.plant[:6])
    assert np.array_equal(both.angle[6:], -both.angle[:6])
    assert np.array_equal(both.light[6:], both.light[:6, :, ::-1])
    assert np.array_equal(both.line_cm[6:], both.line_cm[:6] * np.array([-1.0, 1.0], dtype=np.float32))


# Going on, and the command


def command(runs: Sequence[Path], out: Path, *more: str) -> list[str]:
    return ["train", *map(str, runs), "-o", str(out), "--epochs", "4", "--batch", "6", *more]


def test_left_in_any_epoch_and_gone_on_with_it_is_the_same(measured: list[MeasuredRun], tmp_path: Path) -> None:
    tracks = tracks_of([cut(one, 73) for one in measured], mirror=True)
    whole = SequenceTraining(tracks, SMALL, 1)
    curve = whole.run(Checkpoint(tmp_path / "whole", {}), Silent(), resume=False)
    for ends_in in (2, 3, 4):
        part = SequenceTraining(tracks, SMALL, 1)
        with pytest.raises(KeyboardInterrupt):
            part.run(Checkpoint(tmp_path / "part", {}), Silent(ends_in), resume=ends_in > 2)
    part = SequenceTraining(tracks, SMALL, 1)
    assert part.run(Checkpoint(tmp_path / "part", {}), Silent(), resume=True) == curve
    assert weights_of(part) == weights_of(whole)


@pytest.fixture(scope="module")
def data(measured: list[MeasuredRun], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return written(tmp_path_factory.mktemp("data"), measured[:3])


def test_interrupted_and_resumed_it_is_the_same_simulator(
    data: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, out = tmp_path / "whole", tmp_path / "sim"
    assert main(command(data, whole)) == 0
    assert f"wrote {whole}" in capsys.readouterr().out
    epoch = SequenceTraining._epoch

    def strike(training: SequenceTraining) -> float:
        found = epoch(training)
        if training.stopping.epoch == 2:
            raise KeyboardInterrupt  # the weights have moved on, but no epoch has ended
        return found

    with monkeypatch.context() as patch:
        patch.setattr(SequenceTraining, "_epoch", strike)
        assert main(command(data, out)) == 130
    assert "--resume goes on" in capsys.readouterr().err
    assert checkpoint_path(out).exists()
    assert main([*command(data, out, "--resume"), "--seed", "2"]) == 2
    assert "seed was 1 and is 2 now" in capsys.readouterr().err
    assert main(command(data, out, "--resume")) == 0
    for file in whole.iterdir():
        assert (out / file.name).read_bytes() == file.read_bytes(), file.name
    about = read_stored(out).info.provenance
    assert about.split == "each of 4 members learned without some whole plants (1, 1, 1, 1 of 3)"
    assert [track.sha256 for track in about.track] == [run.sha256 for run in load_runs(data)]
    assert isinstance(load(out), SequenceSimulator)


def test_a_checkpoint_of_other_plants_is_refused(measured: list[MeasuredRun], tmp_path: Path) -> None:
    """The same tracks, but two of them are now said to be of one plant: others are held out."""
    paths = written(tmp_path, measured[:4])
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=2, batch=6)
    with pytest.raises(KeyboardInterrupt):
        train(load_runs(paths), options, Silent(ends_in=2))
    written(tmp_path, [replace(one, plant=measured[max(i, 1)].plant) for i, one in enumerate(measured[:4])])
    with pytest.raises(BadInput, match="is of other work"):
        train(load_runs(paths), replace(options, resume=True), Silent())


def test_of_two_plants_none_is_held_out_and_that_is_said(data: list[Path], tmp_path: Path) -> None:
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=1, batch=6)
    learned = train(load_runs(data[:2]), options, Silent())
    assert learned.provenance.split == "fewer than three plants: none could be held out"
    assert learned.results["held_out_tip_mm"] == {}
    assert any("no error on plants that were never seen can be told" in line for line in learned.table)


def test_what_is_no_use_is_told(data: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (data[0] / "track.csv").read_text().splitlines()
    lines[6] = lines[6].rsplit(",", 1)[0] + ",nan"
    (tmp_path / "bad.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "short.csv").write_text("\n".join(lines[:6]) + "\n")
    for runs, more, said in (
        ([data[1], tmp_path / "bad.csv"], [], "bad.csv line 7: y10"),
        ([data[1], tmp_path / "short.csv"], [], "short.csv: is 0.3 h long; at least 2 h are needed"),
        (data, ["--split", "rows"], "--split rows: the sequence recipe holds out whole plants only"),
        (data, ["--no-mirror"], "No such option: --no-mirror"),
    ):
        assert main(command(runs, tmp_path / "sim", *more)) == 2
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.csv", "short.csv"]
