"""``flora-lab train --recipe paper``: what it learns, what it writes, and what it refuses."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from flora_common.errors import BadInput
from flora_common.runs import RunFolder
from flora_lab.dataset.build import build
from flora_lab.dataset.recipe import Recipe
from flora_lab.dataset.store import Dataset, read_dataset, write_dataset
from flora_lab.main import main
from flora_lab.run_tracks import load_runs
from flora_lab.simulator.load import load
from flora_lab.simulator.paper import PaperSimulator
from flora_lab.simulator.store import read_stored
from flora_lab.train.curve import curve_png
from flora_lab.train.paper import initial_network
from flora_lab.train.split import SplitName, split
from flora_lab.train.stopping import EarlyStopping
from flora_twin.runs import dataset_runs


def write_runs(folder: Path, *, plants: int, hours: float) -> list[str]:
    """Run folders of virtual plants; their paths."""
    for made in dataset_runs(1, open_loops=plants - 1, closed_loops=1, hours=hours):
        run = RunFolder(folder / made.name)
        run.path.mkdir(parents=True)
        run.run_toml.write_text(made.run_text())
        run.track_csv.write_text(made.track_text())
    return [str(path) for path in sorted(folder.iterdir())]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_runs(tmp_path_factory.mktemp("runs") / "runs", plants=4, hours=24.0)


@pytest.fixture(scope="module")
def data(runs: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    tracks = load_runs([Path(run) for run in runs])
    path = tmp_path_factory.mktemp("data") / "data"
    write_dataset(path, build(tracks, Recipe()), tracks, Recipe())
    return path


@pytest.fixture(scope="module")
def trained(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained on the data until it stops by itself."""
    out = tmp_path_factory.mktemp("trained") / "sim"
    assert main(["train", str(data), "-o", str(out), "--recipe", "paper", "--quiet"]) == 0
    return out


def results(path: Path) -> dict[str, Any]:
    return dict(read_stored(path).info.provenance.results)


# What it learns


def test_a_trained_network_beats_a_stem_that_stays_as_it_is(trained: Path, data: Path) -> None:
    found = results(trained)
    for part in ("train", "validate", "test"):
        assert found[f"mae_{part}"] < found[f"nothing_moves_{part}"]
        assert found[f"mae_{part}"] <= 1.44e-3  # the paper's best, with real plants and cameras
        assert found[f"mae_{part}_mm"] == pytest.approx(found[f"mae_{part}"] * 650.0)
    pairs = read_dataset(data).pairs
    still = np.abs(pairs.outputs.astype(np.float64) - pairs.inputs[:, :18]).mean()
    weighed = sum(found[f"nothing_moves_{p}"] * found[f"vectors_{p}"] for p in ("train", "validate", "test"))
    assert weighed / len(pairs) == pytest.approx(still, rel=1e-6)
    # and it is light that it has learned something of: the tip goes to the lit lamp
    plant = load(trained)
    assert isinstance(plant, PaperSimulator)
    upright = pairs.inputs[np.abs(pairs.inputs[:, 16]) < 0.005][:50, :18]
    points = np.concatenate([np.zeros((len(upright), 1, 2)), upright.reshape(-1, 9, 2) * 65.0], axis=1)
    after = {}
    for side, levels in (("left", (1.0, 0.0)), ("right", (0.0, 1.0))):
        state = plant.start(points)
        for _ in range(12):
            state, stems = plant.step(state, np.tile(levels, (len(points), 1)), 300.0)
        after[side] = float(stems[:, -1, 0].mean())
    assert after["right"] > after["left"] + 0.1
    assert not plant.is_beyond_data(plant.start(points)).any()


def test_errors_told_are_those_of_the_simulator_that_was_written(trained: Path, data: Path) -> None:
    """By numpy, over all vectors of a split that is worked out anew."""
    stored, pairs = read_stored(trained), read_dataset(data).pairs
    parts = split(read_dataset(data).plants, "rows", np.random.default_rng([1, 2]), "data")
    plant = PaperSimulator.from_stored(stored)
    found = stored.info.provenance.results
    for part, chosen in parts.parts().items():
        predicted, _ = plant.network(pairs.inputs[chosen])
        error = np.abs(predicted.astype(np.float64) - pairs.outputs[chosen]).mean()
        assert found[f"mae_{part}"] == pytest.approx(error, rel=1e-4)
        assert found[f"vectors_{part}"] == len(chosen)


def test_it_stops_by_its_patience_and_keeps_the_best(trained: Path) -> None:
    found = results(trained)
    losses = found["loss_validate"]
    assert len(losses) == len(found["loss_train"]) == found["epochs"] <= 200
    assert found["epochs"] == min(200, found["best_epoch"] + 10)
    assert losses[found["best_epoch"] - 1] == min(losses) == found["mae_validate"]
    assert losses[0] > 1.2 * min(losses)


def test_weights_that_are_never_trained_are_those_of_the_start(trained: Path) -> None:
    weights = read_stored(trained).weights
    start = initial_network(np.random.default_rng([1, 1]))
    assert weights["w_hh"].tobytes() == start.cell.w_hh.tobytes()
    forget = slice(50, 100)
    assert weights["w_ih"][forget].tobytes() == start.cell.w_ih[forget].tobytes()
    assert (weights["b"][forget] == 1.0).all()
    assert (weights["w_ih"][:50] != start.cell.w_ih[:50]).mean() > 0.99
    identity = start.cell.w_hh.T.astype(np.float64) @ start.cell.w_hh
    assert np.abs(identity - np.eye(50)).max() < 1e-5


# What is written


def test_what_is_written_says_where_it_came_from(trained: Path, data: Path) -> None:
    info = read_stored(trained).info
    known = read_dataset(data).info
    assert (info.kind, info.step_s, info.scales) == ("paper", 300.0, {"unit_cm": 65.0, "stateful": False})
    provenance = info.provenance
    assert (provenance.recipe, provenance.seed) == ("paper", 1)
    assert provenance.dataset_sha256 == known.data_sha256
    assert provenance.settings["batch"] == 30
    assert provenance.settings["dataset"]["noise"]["theta_3"] == 100
    assert [(t.name, t.plant, t.sha256, t.part) for t in provenance.track] == [
        (run.name, run.plant, run.sha256, "all") for run in known.run
    ]
    assert "shuffled" in provenance.split
    assert (trained / "training.png").read_bytes().startswith(b"\x89PNG\r\n")
    assert [p.name for p in trained.parent.iterdir()] == ["sim"]


def test_runs_give_the_network_of_the_training_set_made_of_them(
    runs: list[str], data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, inputs in (("runs", runs), ("data", [str(data)])):
        assert main(["train", *inputs, "-o", str(tmp_path / name), "--recipe", "paper", "--epochs", "3", "--json"]) == 0
    one, two = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert one["results"] == two["results"]
    assert one["weights_sha256"] == two["weights_sha256"]
    assert (one["dataset_sha256"], two["dataset_sha256"]) == ("", read_dataset(data).info.data_sha256)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(data: Path, tmp_path: Path) -> None:
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        options = ["--epochs", "2", "--seed", seed, "--quiet"]
        assert main(["train", str(data), "-o", str(tmp_path / name), "--recipe", "paper", *options]) == 0
    for file in ("simulator.toml", "weights.safetensors", "training.png"):
        a, b, c = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert a == b
        assert a != c


def test_by_plant_whole_plants_are_held_out(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sim"
    assert main(["train", str(data), "-o", str(out), "--recipe", "paper", "--split", "plant", "--epochs", "4"]) == 0
    said = capsys.readouterr().out
    info = read_stored(out).info
    parts = {track.plant: track.part for track in info.provenance.track}
    assert sorted(parts.values()) == ["test", "train", "train", "validate"]
    plants = read_dataset(data).plants
    found = info.provenance.results
    for part in ("train", "validate", "test"):
        assert found[f"vectors_{part}"] == sum((plants == plant).sum() for plant in parts if parts[plant] == part)
    assert "whole plants held out: 2 to train, 1 to validate, 1 to test" in said


def test_what_it_says(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sim"
    assert (
        main(
            [
                "train",
                str(data),
                "-o",
                str(out),
                "--recipe",
                "paper",
                "--epochs",
                "2",
                "--batch",
                "64",
                "--patience",
                "1",
            ]
        )
        == 0
    )
    said, err = capsys.readouterr()
    print(said)
    found = results(out)
    assert err == ""
    assert "1 unit = 65 cm" in said
    rows = {line.split()[0]: line.split()[1:] for line in said.splitlines()[2:5]}
    assert {part: row[2] for part, row in rows.items()} == {
        "train": "1.55e-03",
        "validate": "1.55e-03",
        "test": "1.44e-03",
    }
    assert rows["test"][1] == f"{found['mae_test']:.3e}"
    assert rows["test"][3] == f"{found['nothing_moves_test']:.3e}"
    assert rows["test"][4] == f"{found['mae_test'] * 650.0:.3f}"
    assert f"kept epoch {found['best_epoch']} (paper: stopped at 27)" in said
    assert said.endswith(f"wrote {out}\n")
    assert read_stored(out).info.provenance.settings["batch"] == 64


# What is refused


def refused(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one line with which a command ends that has bad input."""
    capsys.readouterr()
    assert main(["train", "--recipe", "paper", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return err


def test_wrong_inputs_and_options_are_told(
    runs: list[str], data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["-o", str(tmp_path / "sim")]
    assert "no INPUTS given" in refused(capsys, out)
    assert "-o is missing" in refused(capsys, [str(data)])
    assert "no such run or track" in refused(capsys, [str(tmp_path / "absent"), *out])
    assert "name it alone, or runs only" in refused(capsys, [str(data), runs[0], *out])
    assert "did you mean `paper`" in refused(capsys, [str(data), *out, "--recipe", "papper"])
    assert "--epochs" in refused(capsys, [str(data), *out, "--epochs", "0"])
    assert "--split" in refused(capsys, [str(data), *out, "--split", "moon"])
    track = write_runs(tmp_path / "one", plants=1, hours=24.0)[0]
    assert "1 plant; a split by plant needs at least 3" in refused(capsys, [track, *out, "--split", "plant"])
    (tmp_path / "sim").mkdir()
    assert "is there already" in refused(capsys, [str(data), *out])
    assert "is not a simulator and is not replaced" in refused(capsys, [str(data), *out, "--force"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one", "sim"]


def test_dark_rows_lead_to_the_command_that_can_leave_them_out(
    runs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (Path(runs[0]) / "track.csv").read_text().splitlines()
    lines[5] = ",".join(["1200.0", "dark", *lines[5].split(",")[2:]])
    (tmp_path / "dark.csv").write_text("\n".join(lines) + "\n")
    said = refused(capsys, [str(tmp_path / "dark.csv"), "-o", str(tmp_path / "sim")])
    assert "dark.csv row 5" in said
    assert "(an option of `flora-lab dataset`; train on what that makes)" in said


def changed(data: Path, folder: Path, name: str, place: tuple[int, int], value: float) -> Dataset | Path:
    """A copy of the training set in which one number is another, with the right hash."""
    folder.mkdir()
    with np.load(data / "data.npz") as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays[name][place] = value
    np.savez(folder / "data.npz", **arrays)
    info = tomllib.loads((data / "dataset.toml").read_text())
    info["data_sha256"] = hashlib.sha256((folder / "data.npz").read_bytes()).hexdigest()
    (folder / "dataset.toml").write_text(tomli_w.dumps(info))
    return folder


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["inputs", "outputs"])
def test_a_number_that_is_none_is_told_with_its_vector(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, value: float
) -> None:
    bad = changed(data, tmp_path / "bad", name, (123, 7), value)
    said = refused(capsys, [str(bad), "-o", str(tmp_path / "sim")])
    pairs = read_dataset(data).pairs
    assert f"bad/data.npz: `{name}` of vector 124 (run {pairs.run[123] + 1}, row {pairs.row[123] + 1})" in said
    assert not (tmp_path / "sim").exists()


def test_other_damage_to_the_data_is_told_as_ever(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "dataset.toml").write_bytes((data / "dataset.toml").read_bytes())
    out = ["-o", str(tmp_path / "sim")]
    assert "cannot be read" in refused(capsys, [str(bad), *out])
    (bad / "data.npz").write_bytes((data / "data.npz").read_bytes()[:1000])
    assert "is damaged" in refused(capsys, [str(bad), *out])


@pytest.mark.skipif(importlib.util.find_spec("tensorboard") is not None, reason="tensorboard is installed")
def test_tensorboard_that_is_missing_is_told(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["-o", str(tmp_path / "sim"), "--tensorboard", str(tmp_path / "board")]
    assert "`pip install tensorboard`" in refused(capsys, [str(data), *out])
    assert list(tmp_path.iterdir()) == []


def test_help_and_bad_input_wait_for_no_learning_library(tmp_path: Path) -> None:
    code = (
        "import sys; from flora_lab.main import main; status = main(sys.argv[1:]);"
        "print(status, [m for m in ('torch', 'numba', 'matplotlib', 'scipy') if m in sys.modules])"
    )
    for arguments, status in ((["train", "--help"], 0), (["train", str(tmp_path), "-o", str(tmp_path)], 2)):
        command = [sys.executable, "-c", code, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        assert done.stdout.splitlines()[-1] == f"{status} []"


# Its parts


@given(st.integers(10, 300), st.integers(3, 9), st.integers(0, 2**32 - 1), st.sampled_from(["rows", "plant"]))
def test_every_row_is_in_one_part(count: int, plants: int, seed: int, by: SplitName) -> None:
    names = np.array([f"plant {i % plants}" for i in range(count)])
    parts = split(names, by, np.random.default_rng(seed), "data")
    together = np.concatenate([parts.train, parts.validate, parts.test])
    assert sorted(together.tolist()) == list(range(count))
    assert min(len(parts.train), len(parts.validate), len(parts.test)) >= 1
    if by == "plant":
        found = [set(names[rows].tolist()) for rows in parts.parts().values()]
        assert sum(map(len, found)) == plants
        for part, there in zip(parts.parts(), found, strict=True):
            assert {plant for plant, its in parts.part_of.items() if its == part} == there
    else:
        assert len(parts.train) == round(0.7 * count)
        assert len(parts.validate) == round(0.2 * count)


def test_too_little_to_split_is_told() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(BadInput, match="9 vectors; at least 10"):
        split(np.array(["a"] * 9), "rows", rng, "data")
    with pytest.raises(BadInput, match="2 plants; a split by plant needs at least 3"):
        split(np.array(["a", "b"] * 9), "plant", rng, "data")


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), st.integers(1, 12))
def test_stopping_is_as_keras_does_it(losses: list[float], patience: int) -> None:
    stopping = EarlyStopping(patience)
    best, waited = float("inf"), 0
    for number, loss in enumerate(losses, start=1):
        improved = stopping.update(loss)
        assert improved == (loss < best)
        best, waited = (loss, 0) if improved else (best, waited + 1)
        assert stopping.is_over == (waited >= patience)
        assert stopping.patience_left == patience - waited
        again = EarlyStopping(patience)
        again.restore(json.loads(json.dumps(stopping.state())))
        assert again.state() == stopping.state()
        assert (stopping.best, stopping.epoch) == (best, number)
        if stopping.is_over:
            break
    assert losses[stopping.best_epoch - 1] == min(losses[: stopping.epoch])


def test_the_curve_is_a_picture_of_its_numbers() -> None:
    one = curve_png([2e-3, 1.6e-3], [1.8e-3, 1.55e-3], [2], level=("nothing moves", 1e-3))
    assert one.startswith(b"\x89PNG\r\n")
    assert one == curve_png([2e-3, 1.6e-3], [1.8e-3, 1.55e-3], [2], level=("nothing moves", 1e-3))
    assert one != curve_png([2e-3, 1.6e-3], [1.8e-3, 1.55e-3], [2])
    assert one != curve_png([2e-3, 1.6e-3], [1.8e-3, 1.45e-3], [2], level=("nothing moves", 1e-3))
