"""A training that is interrupted, terminated or killed, and goes on: the simulator is the same to the last byte."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy

from flora_common.errors import BadInput
from flora_lab.dataset.build import build
from flora_lab.dataset.recipe import Recipe
from flora_lab.dataset.store import write_dataset
from flora_lab.main import main
from flora_lab.run_tracks import RunTrack
from flora_lab.train import fused_step
from flora_lab.train.checkpoint import Checkpoint, checkpoint_path
from flora_twin.runs import dataset_runs
from folders import same_folders

COMMAND = """
import os, signal, sys
from flora_lab.main import main
from flora_lab.train import checkpoint, fused_step

{every}
epochs = 0
train_epoch = fused_step.train_epoch

def train_and_strike(*arguments):
    global epochs
    epochs += 1
    if epochs == 6:
        os.kill(os.getpid(), signal.{signal})
    return train_epoch(*arguments)

fused_step.train_epoch = train_and_strike
sys.exit(main(sys.argv[1:]))
"""


def write_data(path: Path, seed: int) -> Path:
    tracks = [
        RunTrack(run.name, run.run_file.plant, Path(f"{run.name}.csv"), f"{seed + i:064d}", run.track)
        for i, run in enumerate(dataset_runs(seed, open_loops=2, closed_loops=1, hours=12.0))
    ]
    write_dataset(path, build(tracks, Recipe()), tracks, Recipe())
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data(tmp_path_factory.mktemp("data") / "data", 1)


def command(data: Path, out: Path, *more: str) -> list[str]:
    return ["train", str(data), "-o", str(out), "--recipe", "paper", "--epochs", "20", "--patience", "50", *more]


@pytest.fixture(scope="module")
def whole(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty epochs in one go."""
    out = tmp_path_factory.mktemp("whole") / "sim"
    assert main([*command(data, out), "--quiet"]) == 0
    return out


def interrupted_after(epochs: int, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
    """Ctrl-C in the middle of the epoch after these."""
    done = 0
    train_epoch = fused_step.train_epoch

    def train_and_stop(training: Any, *more: Any) -> Any:
        nonlocal done
        result = train_epoch(training, *more)
        if done == epochs:
            raise KeyboardInterrupt  # the arrays have moved on, but no epoch has ended
        done += 1
        return result

    with monkeypatch.context() as patch:
        patch.setattr(fused_step, "train_epoch", train_and_stop)
        assert main(arguments) == 130


# The command


@pytest.mark.parametrize("parts", [(10,), (1, 7, 11)])
def test_interrupted_and_resumed_it_is_the_same_simulator(
    data: Path,
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    parts: tuple[int, ...],
) -> None:
    out = tmp_path / "sim"
    done = 0
    for number, part in enumerate(parts):
        interrupted_after(part, monkeypatch, command(data, out, *(["--resume"] if number else [])))
        done += part
        said = capsys.readouterr().err.splitlines()
        assert said[-2].startswith("what was learned is kept in ")
        assert "--resume goes on" in said[-2]
        assert said[-1] == "flora-lab: interrupted"
        assert [p.name for p in tmp_path.iterdir()] == [".sim.checkpoint"]
    assert main(command(data, out, "--resume")) == 0
    assert f"going on after epoch {done}, from {checkpoint_path(out)}" in capsys.readouterr().err
    assert same_folders(out, whole)
    assert [p.name for p in tmp_path.iterdir()] == ["sim"]


def test_interrupted_before_the_first_epoch_ends_nothing_is_left(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted_after(0, monkeypatch, command(data, tmp_path / "sim"))
    assert capsys.readouterr().err == "flora-lab: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "every", "status"),
    [
        ("SIGTERM", "", 143),
        ("SIGINT", "", 130),
        ("SIGKILL", "checkpoint.Checkpoint.__init__.__kwdefaults__['every_s'] = 0.0", -int(signal.SIGKILL)),
    ],
)
def test_signals_leave_what_was_learned(
    data: Path, whole: Path, tmp_path: Path, name: str, every: str, status: int
) -> None:
    out = tmp_path / "sim"
    code = COMMAND.format(signal=name, every=every)
    ended = subprocess.run(
        [sys.executable, "-c", code, *command(data, out)], capture_output=True, text=True, timeout=60
    )
    assert ended.returncode == status, ended.stderr
    assert ("--resume goes on" in ended.stderr) == (name != "SIGKILL")
    assert "Traceback" not in ended.stderr
    assert [p.name for p in tmp_path.iterdir()] == [".sim.checkpoint"]
    with (tmp_path / "said").open("w") as said:
        resumed = subprocess.run(
            [sys.executable, "-m", "flora_lab.main", *command(data, out, "--resume")], stdout=said, timeout=60
        )
    assert resumed.returncode == 0
    assert same_folders(out, whole)


def test_a_training_may_go_on_for_longer_than_was_meant(
    data: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "sim"
    interrupted_after(4, monkeypatch, [*command(data, out), "--epochs", "5"])
    assert main(command(data, out, "--resume", "--quiet")) == 0
    assert same_folders(out, whole)


def test_what_was_learned_is_dropped_only_when_that_is_asked_for(
    data: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sim"
    interrupted_after(4, monkeypatch, [*command(data, out), "--seed", "9"])
    before = checkpoint_path(out).read_bytes()
    capsys.readouterr()
    assert main(command(data, out)) == 2
    said = capsys.readouterr().err
    assert f"{checkpoint_path(out)}: holds an unfinished training; --resume goes on with it, --force drops it" in said
    assert main(command(data / "nowhere", out, "--force")) == 2
    assert checkpoint_path(out).read_bytes() == before
    capsys.readouterr()
    assert main(command(data, out, "--force")) == 0
    assert "going on" not in capsys.readouterr().err
    assert same_folders(out, whole)


def test_to_replace_a_simulator_and_to_go_on_go_together(
    data: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sim"
    assert main([*command(data, out), "--seed", "9", "--quiet"]) == 0
    interrupted_after(4, monkeypatch, command(data, out, "--force"))
    assert main(command(data, out, "--force", "--resume")) == 0
    assert "going on after epoch 4" in capsys.readouterr().err
    assert same_folders(out, whole)


def test_with_nothing_to_resume_it_begins(
    data: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    assert main(command(data, other, "--resume")) == 0
    assert "nothing is kept there to go on from; starting from the beginning" in capsys.readouterr().err
    assert same_folders(other, whole)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (["--seed", "2"], "seed was 1 and is 2 now"),
        (["--batch", "31"], "batch was 30 and is 31 now"),
        (["--patience", "49"], "patience was 50 and is 49 now"),
        (["--split", "plant"], "split was rows and is plant now"),
    ],
)
def test_a_checkpoint_of_other_settings_is_refused(
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: list[str],
    said: str,
) -> None:
    out = tmp_path / "sim"
    interrupted_after(3, monkeypatch, command(data, out))
    before = checkpoint_path(out).read_bytes()
    capsys.readouterr()
    assert main([*command(data, out, "--resume"), *change]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert "give --force in place of --resume to begin anew" in err
    assert err.count("\n") == 1
    assert checkpoint_path(out).read_bytes() == before
    assert not out.exists()


def test_a_checkpoint_of_other_data_is_refused(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sim"
    interrupted_after(3, monkeypatch, command(data, out))
    other = write_data(tmp_path / "data", 7)
    capsys.readouterr()
    assert main(command(other, out, "--resume")) == 2
    assert "is of other work, data was " in capsys.readouterr().err


# The file


ARRAYS = {"theta": np.arange(5, dtype=np.float32), "random": np.array([1, 2**63], dtype=np.uint64)}
WORK = {"seed": 1, "data": "ab" * 32, "split": "rows", "shape": (3, 4), "settings": {"rate": 0.1, "grow": {"cm": 2}}}


def test_what_is_kept_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "c"
    state = {"loss": [0.1 + 0.2, 1e-300, float("inf")], "epoch": 3, "stopping": {"best": 1 / 3}}
    with Checkpoint(path, WORK) as checkpoint:
        assert checkpoint.load() is None
        checkpoint.offer(ARRAYS, state)
    saved = Checkpoint(path, WORK).load()
    assert saved is not None
    assert saved.state == state
    for name, array in ARRAYS.items():
        assert saved.arrays[name].tobytes() == array.tobytes()
        assert saved.arrays[name].dtype == array.dtype
        saved.arrays[name][0] = 7  # the training goes on in them
    assert [p.name for p in tmp_path.iterdir()] == ["c"]


def test_it_is_written_now_and_then_and_when_it_ends(tmp_path: Path) -> None:
    path, now_s = tmp_path / "c", [100.0]
    theta = np.zeros(3)

    def on_disk() -> float | None:
        saved = Checkpoint(path, WORK).load()
        return None if saved is None else float(saved.arrays["theta"][0])

    def interrupt() -> None:
        with Checkpoint(path, WORK, every_s=2.0, clock=lambda: now_s[0]) as checkpoint:
            for second, expected in ((1, None), (2, 2.0), (3, 2.0), (4, 4.0), (5, 4.0)):
                now_s[0] = 100.0 + second
                theta[0] = second
                checkpoint.offer({"theta": theta}, {})
                assert on_disk() == expected
            theta[0] = 99.0  # in the middle of an epoch
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert on_disk() == 5.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: b"", "is damaged, or no checkpoint of this version of flora"),
        (lambda data: b"x" * 200, "is damaged, or no checkpoint of this version of flora"),
        (
            lambda data: safetensors.numpy.save(ARRAYS, {"format": "flora-checkpoint-1", "work": "{}", "state": "{}"}),
            "is damaged, or no checkpoint of this version of flora",
        ),
        (lambda data: data[:40], "is damaged; "),
        (lambda data: data[:-3], "is damaged; "),
        (lambda data: data[:-4] + np.float32("nan").tobytes(), "is damaged; "),
        (lambda data: data.replace(b'"round": 1', b'"round": 9'), "is damaged; "),
        (lambda data: data.replace(b'{"round": 1}', b"{}"), "is damaged; "),
        (lambda data: data.replace(b'{"round": 1}', b"[" * 100_000), "is damaged; "),
    ],
)
def test_a_file_that_is_none_is_told(tmp_path: Path, change: Callable[[bytes], bytes], said: str) -> None:
    path = tmp_path / "c"
    with Checkpoint(path, WORK) as checkpoint:
        checkpoint.offer(ARRAYS, {"round": 1})
    damaged = change(path.read_bytes())
    assert damaged != path.read_bytes()
    path.write_bytes(damaged)
    with pytest.raises(BadInput, match=said) as told:
        Checkpoint(path, WORK).load()
    assert "--force in place of --resume" in str(told.value)
    assert str(path) in str(told.value)
    assert path.read_bytes() == damaged


def test_a_folder_in_the_place_of_the_checkpoint_is_told_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "c"
    path.mkdir()
    for resume, said in (
        (True, "c: not a regular file; remove it, or"),
        (False, "c: cannot be removed (.*); remove it"),
    ):
        with pytest.raises(BadInput, match=said):
            Checkpoint(path, WORK).begin(resume=resume)
    assert path.is_dir()


def test_what_differs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "c"
    with Checkpoint(path, WORK) as checkpoint:
        checkpoint.offer(ARRAYS, {})
    for work, said in (
        ({**WORK, "seed": 2}, "seed was 1 and is 2 now"),
        ({**WORK, "data": "cd" * 32}, "data was abababababab… and is cdcdcdcdcdcd… now"),
        ({**WORK, "batch": 30}, "batch was None and is 30 now"),
        ({k: v for k, v in WORK.items() if k != "split"}, "split was rows and is None now"),
        ({**WORK, "settings": {"rate": 0.2, "grow": {"cm": 2}}}, "work, settings.rate was 0.1 and is 0.2 now; "),
        ({**WORK, "settings": {"rate": 0.1, "grow": {"cm": 3}}}, "work, settings.grow.cm was 2 and is 3 now; "),
        ({**WORK, "shape": (3, 5)}, r"work, shape\[1\] was 4 and is 5 now; "),
        ({**WORK, "data": "ab" * 31 + "cd"}, "data was …ababab… and is …ababcd… now"),
        (
            {**WORK, "seed": 2, "split": "plant", "shape": (), "settings": {}},
            "seed was .*, settings.grow.cm was .* and ",
        ),
    ):
        with pytest.raises(BadInput, match=said):
            Checkpoint(path, work).load()
    assert Checkpoint(path, json.loads(json.dumps(WORK))).load() is not None
