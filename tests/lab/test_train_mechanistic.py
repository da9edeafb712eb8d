"""``--recipe mechanistic`` on runs of plants that the law itself made, with constants that are known."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from simulator_fakes import write_track

from flora_common.errors import BadInput
from flora_common.runs import CameraSection, LampsSection, RunFile, run_file_text
from flora_lab.main import main
from flora_lab.run_tracks import RunTrack, load_runs
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.interface import Chance, run
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import read_stored
from flora_lab.simulator.tropism_traits import NAMES, prior_doubt, prior_mean, prior_spread
from flora_lab.train.checkpoint import checkpoint_path
from flora_lab.train.mechanistic import lamps_of, train
from flora_lab.train.recipes import TrainOptions

numba.set_num_threads(1)


STEP_S = 300.0
LAMPS = LampsSection(35.0, 30.0)
SHIFT = np.array([0.7, 0.0, 0.0, 0.0, 0.0, 0.7, 0.7, -0.5, 0.7])
"""By how many of the sources' own doubts the true constants lie elsewhere than the sources say."""
TRUTH = prior_mean() + SHIFT * prior_doubt()
ONE_THREAD = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Products of small matrices wait for each other's threads where cores are busy."""


def grown(seeds: range, hours: int) -> list[MeasuredRun]:
    """Individuals about :data:`TRUTH`, with chance, each under lamps of its own."""
    plant = RodSimulator(LAMPS, Prior(TRUTH, prior_spread()), DriveNoise(), DataRange(30.0, 10.0))
    steps, count = hours * 12, len(seeds)
    right = (np.arange(steps)[:, None] // np.array([20 + 13 * (s % 5) for s in seeds])) % 2 == np.array(seeds) % 2
    light = np.stack([~right, right], axis=2).astype(np.float64)
    points = np.repeat(np.linspace(0.0, 1.0, 10)[None, :, None] * np.array([0.0, 7.0]), count, axis=0)
    stems = run(plant, plant.start(points, Chance(np.array(seeds))), light, STEP_S)
    told = np.concatenate([points[None], stems])
    told[1:, :, 1:] += 0.02 * np.random.default_rng(1).normal(size=told[1:, :, 1:].shape)
    time_s = np.arange(steps + 1, dtype=np.float64) * STEP_S
    return [
        MeasuredRun(f"run-{s}", f"plant {s}", "", told[:, i], light[:, i], time_s, STEP_S, {})
        for i, s in enumerate(seeds)
    ]


def written(folder: Path, one: MeasuredRun, lamps: LampsSection | None = LAMPS) -> Path:
    """A run folder; without ``lamps`` a track alone."""
    if lamps is None:
        return write_track(folder / f"{one.name}.csv", one)
    path = folder / one.name
    write_track(path / "track.csv", one)
    about = RunFile(camera=CameraSection(anchor_px=(820.0, 1100.0), px_per_cm=20.0), plant=one.plant, lamps=lamps)
    (path / "run.toml").write_text(run_file_text(about))
    return path


class Told:
    """A :class:`flora_lab.train.recipes.Progress` that remembers."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.epochs: list[int] = []
        self.begun: list[tuple[int, int]] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def stage(self, name: str) -> None:
        raise AssertionError("this recipe has no stages of its own")

    def begin(self, epochs: int, done: int = 0) -> None:
        self.begun.append((epochs, done))

    def epoch(self, number: int, losses: Mapping[str, float], patience_left: int | None = None) -> None:
        assert np.isfinite(losses["cm"])
        self.epochs.append(number)


def command(runs: list[Path], out: Path, *more: str) -> list[str]:
    return ["train", *map(str, runs), "-o", str(out), "--recipe", "mechanistic", "--epochs", "2", *more]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("data")
    return [written(folder, one) for one in grown(range(100, 104), 26)]


@pytest.fixture(scope="module")
def whole(data: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rounds in one go."""
    out = tmp_path_factory.mktemp("whole") / "sim"
    arguments = [sys.executable, "-m", "flora_lab.main", *command(data, out)]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120, env=ONE_THREAD)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:10]] == list(NAMES)
    assert lines[-1] == f"wrote {out}"
    return out


@pytest.fixture(scope="module")
def short() -> list[MeasuredRun]:
    """So short that a round takes no time, and tells little."""
    return grown(range(200, 202), 8)


# What is learned


def test_the_constants_are_those_of_the_law(whole: Path) -> None:
    plant = load(whole)
    assert isinstance(plant, RodSimulator)
    assert plant.lamps == LAMPS
    error = dict(zip(NAMES, np.abs(plant.prior.mean - TRUTH) / prior_doubt(), strict=True))
    for name in ("growth_early_cm_per_day", "photoception_per_cm_h", "graviception_per_cm_h", "photo_latency_min"):
        assert error[name] < 0.35, name  # they were 0.7 away
    between = np.sqrt(np.diag(plant.prior.covariance) / 4)
    assert (np.abs(plant.prior.mean - TRUTH) < 3.0 * between + 0.1).all()
    spread = np.sqrt(np.diag(plant.prior.covariance) / np.diag(prior_spread()))
    assert spread.min() > 0.5
    assert spread.max() < 2.0
    noise, real = plant.noise, DriveNoise()
    for size in ("wander_per_cm_h", "nutation_per_cm_h", "growth_share"):
        assert 1 / 3.5 < getattr(noise, size) / getattr(real, size) < 3.5, size


def test_the_folder_tells_where_it_comes_from(whole: Path, data: list[Path]) -> None:
    info = read_stored(whole).info
    about, runs = info.provenance, load_runs(data)
    assert (info.kind, info.step_s, about.recipe) == ("mechanistic", 300.0, "mechanistic")
    assert [(t.name, t.plant, t.sha256) for t in about.track] == [(r.name, r.plant, r.sha256) for r in runs]
    assert about.settings == {"rounds": 2}
    assert all(0.02 < cm < 0.4 for cm in about.results["free_run_residual_cm"].values())
    longest = max(np.hypot(*np.diff(r.track.points_cm[-1], axis=0).T).sum() for r in runs)
    assert longest < info.scales["longest_cm"] < 1.2 * longest


# Going on


INTERRUPTED = """
import sys
from flora_lab.main import main
from flora_lab.train import mechanistic

rounds, improved = 0, mechanistic.improved

def improve_and_strike(*arguments):
    global rounds
    rounds += 1
    if rounds == 2:
        raise KeyboardInterrupt
    return improved(*arguments)

mechanistic.improved = improve_and_strike
sys.exit(main(sys.argv[1:]))
"""


def test_interrupted_after_a_round_and_resumed_it_is_the_same(data: list[Path], whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "sim"
    arguments = [sys.executable, "-c", INTERRUPTED, *command(data, out)]
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=120, env=ONE_THREAD)
    assert ended.returncode == 130, ended.stderr
    assert "--resume goes on" in ended.stderr
    assert [p.name for p in tmp_path.iterdir()] == [".sim.checkpoint"]
    arguments = [sys.executable, "-m", "flora_lab.main", *command(data, out, "--resume", "--json")]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120, env=ONE_THREAD)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["results"]["rounds"] == 2
    assert [p.name for p in tmp_path.iterdir()] == ["sim"]
    for file in whole.iterdir():
        assert (out / file.name).read_bytes() == file.read_bytes(), file.name


def test_rounds_are_told_and_a_checkpoint_of_other_runs_is_refused(short: list[MeasuredRun], tmp_path: Path) -> None:
    runs = load_runs([written(tmp_path, one) for one in short])
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=1)
    told, anew = Told(), Told()
    train(runs, options, told)
    assert (told.begun, told.epochs, told.notes) == ([(1, 0)], [1], [])
    train(runs, replace(options, checkpoint=tmp_path / "none", resume=True), anew)
    assert ["none: nothing is kept there to go on from" in note for note in anew.notes] == [True]
    more = Told()
    train(runs, replace(options, epochs=2, resume=True), more)
    assert (more.begun, more.epochs) == ([(2, 1)], [2])
    with pytest.raises(BadInput, match=r"is of other work, tracks\[1\] was"):
        train(runs[:1], replace(options, resume=True), Told())


def test_fewer_rounds_than_are_done_already_are_refused(short: list[MeasuredRun], tmp_path: Path) -> None:
    runs = load_runs([written(tmp_path, one) for one in short])
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=2)
    train(runs, options, Told())
    before = options.checkpoint.read_bytes()
    with pytest.raises(BadInput, match="c: holds 2 rounds and 1 are asked for; give --epochs 2 or more, or --force"):
        train(runs, replace(options, epochs=1, resume=True), Told())
    assert options.checkpoint.read_bytes() == before
    told = Told()
    assert train(runs, replace(options, resume=True), told).results["rounds"] == 2
    assert (told.begun, told.epochs) == ([(2, 2)], [])


def test_a_checkpoint_of_lamps_elsewhere_is_refused(short: list[MeasuredRun], tmp_path: Path) -> None:
    paths = [written(tmp_path, one) for one in short]
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=1)
    train(load_runs(paths), options, Told())
    for one in short:
        written(tmp_path, one, LampsSection(20.0, 10.0))
    with pytest.raises(BadInput, match="is of other work"):
        train(load_runs(paths), replace(options, epochs=2, resume=True), Told())


# Its runs


def test_what_is_missing_from_the_tracks_does_no_harm(short: list[MeasuredRun], tmp_path: Path) -> None:
    options = TrainOptions(seed=1, checkpoint=tmp_path / "c", epochs=1)
    means = {}
    for name, gone in (("none", []), ("few", [5, 6, 7, 29, 30, 31]), ("many", [*range(20, 37), 59, 60, 61])):
        points = short[0].points_cm.copy()
        points[gone] = np.nan
        runs = [replace(short[0], points_cm=points), short[1]]
        learned = train(load_runs([written(tmp_path / name, one) for one in runs]), options, Told())
        assert all(np.isfinite(array).all() for array in learned.weights.values())
        means[name] = learned.weights["trait_mean"]
    for name, most in (("few", 0.1), ("many", 0.8)):  # none of the eight full hours; three of them
        moved = (means[name] - means["none"]) / prior_doubt()
        assert np.sqrt(np.mean(moved**2)) < most, name
    assert means["many"].tobytes() != means["none"].tobytes()


def test_nothing_is_drawn(short: list[MeasuredRun], tmp_path: Path) -> None:
    runs = load_runs([written(tmp_path, one) for one in short])
    one, other = (
        train(runs, TrainOptions(seed=seed, checkpoint=tmp_path / f"{seed}", epochs=1), Told()) for seed in (1, 2)
    )
    assert all(one.weights[name].tobytes() == other.weights[name].tobytes() for name in one.weights)
    assert one.scales == other.scales


def told_by(capsys: pytest.CaptureFixture[str], arguments: list[str], out: Path) -> str:
    """The one line of an error."""
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert not out.exists()
    assert not checkpoint_path(out).exists()
    return err


def test_boxes_with_lamps_in_different_places_are_refused(
    short: list[MeasuredRun], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [written(tmp_path, short[0]), written(tmp_path, short[1], LampsSection(20.0, 30.0))]
    said = told_by(capsys, command(paths, tmp_path / "sim"), tmp_path / "sim")
    assert f"{paths[1]}/track.csv: its lamps hang elsewhere than those of {paths[0]}/track.csv" in said


@pytest.mark.parametrize("option", [("--split", "plant"), ("--batch", "7"), ("--patience", "3")])
def test_options_that_it_has_no_use_for_are_refused(
    short: list[MeasuredRun], tmp_path: Path, capsys: pytest.CaptureFixture[str], option: tuple[str, str]
) -> None:
    said = told_by(capsys, command([written(tmp_path, short[0])], tmp_path / "sim", *option), tmp_path / "sim")
    assert f"{option[0]}: has no effect, --recipe mechanistic has no use for it; leave it out" in said


def test_a_track_in_millimetres_or_pixels_is_refused(
    short: list[MeasuredRun], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for scale in (10.0, 18.4):
        path = written(tmp_path, replace(short[0], points_cm=scale * short[0].points_cm))
        said = told_by(capsys, command([path], tmp_path / "sim"), tmp_path / "sim")
        assert "is more than 60 cm from the anchor" in said
        assert "points are in cm, not in mm or px" in said


def test_a_run_that_is_too_short_is_refused(
    short: list[MeasuredRun], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = replace(short[0], points_cm=short[0].points_cm[:24], light=short[0].light[:23], time_s=short[0].time_s[:24])
    paths = [written(tmp_path, short[1]), written(tmp_path, tiny)]
    said = told_by(capsys, command(paths, tmp_path / "sim"), tmp_path / "sim")
    assert f"{paths[1]}/track.csv: is 1.9 h long; at least 2 h are needed" in said


def test_where_the_lamps_hang_is_asked_for_or_taken_to_be_as_usual(short: list[MeasuredRun], tmp_path: Path) -> None:
    far = LampsSection(44.0, 22.0)
    alone = load_runs([written(tmp_path, one, None) for one in short])
    mixed: list[RunTrack] = [alone[0], *load_runs([written(tmp_path, short[1], far)])]
    told = Told()
    assert lamps_of(mixed, told) == far
    assert told.notes == []
    assert lamps_of(alone, told) == LampsSection()
    assert told.notes == ["no run.toml tells where the lamps hang: taken to be 35 cm to either side, 30 cm high"]
