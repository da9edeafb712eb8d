"""Seconds per epoch of training: both recipes beside Keras' `fit` on the same 101,162 vectors, batch 30.

    make bench-training                                      some two minutes
    make bench-training BENCH='--repeats 9 --json out/training.json'

The vectors are the paper's training set of nine virtual runs, its first ones repeated or its last ones left out until
there are as many as in the paper. All ways take turns, so that a machine that slows down slows all. Before that, Keras
and the compiled loop train one epoch from the same weights in the same order, and must come to the same loss.

The sequence recipe has no single vectors: its time is that of as many plant-steps, each one step of one plant through
one network, forward and back, in windows that run free. One network of 50 cells is the paper's size; the recipe's own
members are timed beside it. Keras runs in an environment of its own (.venv-bench-keras; `make bench-training` makes it)
and is left out where that is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from types import TracebackType
from typing import Any, Self

import numba
import numpy as np
import torch
from machine import processor
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from flora_common.arrays import Float32Array
from flora_lab.dataset.build import build
from flora_lab.dataset.recipe import PAPER_VECTORS, Recipe
from flora_lab.run_tracks import RunTrack, load_runs
from flora_lab.simulator.measured import in_steps
from flora_lab.simulator.paper import CELLS, PaperNetwork
from flora_lab.train import fused_step, torch_reference
from flora_lab.train.paper import BATCH, initial_network
from flora_lab.train.sequence_fit import SequenceSettings, SequenceTraining
from flora_lab.train.windows import Tracks, tracks_of

ROOT = Path(__file__).resolve().parent.parent.parent
KERAS_PYTHON = ROOT / ".venv-bench-keras" / "bin" / "python"
KERAS_FIT = ROOT / "tests" / "bench" / "training" / "keras_fit.py"
LARGE_UPDATES = 2
"""Updates that the plant-steps are run in where windows are as many as possible: the best case."""
SAME_LOSS = 0.01
"""Relative difference of the first epoch's loss that is still the same training: sums are in another order."""
KERAS_ONE, KERAS_ALL = "Keras fit, 1 thread", "Keras fit, its default"
PAPER, SEQUENCE = "flora, paper recipe", "flora, sequence recipe, 1 x 50"
GOALS = {PAPER: 20.0, SEQUENCE: 15.0}


@dataclass(frozen=True, slots=True)
class Way:
    """One way to train: ``epoch`` runs 101,162 vectors or plant-steps and returns its seconds."""

    name: str
    epoch: Callable[[], float]


class KerasProcess:
    """Keras in its own environment, warm, waiting for a line to run an epoch.

    Raises:
        RuntimeError: it ended; with what it said last.
    """

    def __init__(self, data: Path, threads: int) -> None:
        self._log = data.with_name(f"keras-{threads}.log")  # TensorFlow says much that is of no use
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [KERAS_PYTHON, KERAS_FIT, data, f"--threads={threads}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**os.environ, "CUDA_VISIBLE_DEVICES": ""},
            )
        self.first = self._heard()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=60.0)

    def epoch(self) -> float:
        self._process.stdin.write("epoch\n")
        self._process.stdin.flush()
        return float(self._heard()["seconds"])

    def _heard(self) -> dict[str, Any]:
        line = self._process.stdout.readline()
        if not line:
            status = self._process.wait()
            said = self._log.read_text(errors="replace").strip()
            raise RuntimeError(f"{KERAS_FIT.name} ended with status {status}: {said[-2000:]}")
        return dict(json.loads(line))


def main() -> int:
    options = parsed()
    console, aside = Console(width=None if sys.stdout.isatty() else 120), Console(stderr=True)
    torch.set_num_threads(1)
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        runs = nine_runs(Path(folder))
        inputs, outputs = vectors(runs)
        start = initial_network(np.random.default_rng(1))
        tracks = tracks_of([in_steps(run) for run in runs], mirror=SequenceSettings().mirror)
        ways = [paper_way(start, inputs, outputs), reference_way(start, inputs, outputs), *sequence_ways(tracks)]
        if not KERAS_PYTHON.exists():
            aside.print("bench_training: no .venv-bench-keras, Keras is left out; `make bench-training` makes it")
            times, versions = timed(ways, options.repeats, aside), {}
        else:
            data = Path(folder) / "data.npz"
            write_keras(data, start, inputs, outputs)
            with KerasProcess(data, 1) as one, KerasProcess(data, 0) as default:
                check_same(one.first["loss"], first_loss(start, inputs, outputs), console)
                ways = [Way(KERAS_ONE, one.epoch), Way(KERAS_ALL, default.epoch), *ways]
                times, versions = timed(ways, options.repeats, aside), one.first["versions"]
    versions |= {"numba": numba.__version__, "numpy": np.__version__, "torch": torch.__version__}
    versions["python"] = platform.python_version()
    machine = {"processor": processor(), "processors": os.cpu_count(), "load": [load_before, os.getloadavg()[0]]}
    show(times, versions, machine, console)
    if options.json:
        told = {"vectors": PAPER_VECTORS, "batch": BATCH, "versions": versions, "machine": machine, "seconds": times}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(told | {"medians": medians(times)}, indent=1) + "\n")
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="epochs of each way (5)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all times there")
    return parser.parse_args()


def nine_runs(folder: Path) -> list[RunTrack]:
    """The paper's nine experiments with virtual plants."""
    command = Path(sys.executable).with_name("flora-twin")
    subprocess.run([command, "runs", "--output", folder / "nine"], check=True, stdout=subprocess.DEVNULL)
    return load_runs(sorted((folder / "nine").iterdir()))


def vectors(runs: Sequence[RunTrack]) -> tuple[Float32Array, Float32Array]:
    """Exactly as many as the paper's, in random order, shapes (101162, 19) and (101162, 18)."""
    pairs = build(runs, Recipe()).pairs
    rows = np.random.default_rng(1).permutation(np.arange(PAPER_VECTORS) % len(pairs))
    return pairs.inputs[rows], pairs.outputs[rows]


def paper_way(start: PaperNetwork, inputs: Float32Array, outputs: Float32Array) -> Way:
    """The compiled loop of ``--recipe paper``, each epoch in another order."""
    training, steps, random = fused_step.Training.of(start), 0, np.random.default_rng(1)

    def epoch() -> float:
        nonlocal steps
        began_s = time.perf_counter()
        order = random.permutation(len(inputs))
        _, steps = fused_step.train_epoch(training, steps, inputs, outputs, order, BATCH)
        return time.perf_counter() - began_s

    return Way(PAPER, epoch)


def reference_way(start: PaperNetwork, inputs: Float32Array, outputs: Float32Array) -> Way:
    """The same in plain torch."""
    network, random = torch_reference.ReferenceNetwork.of(start), np.random.default_rng(1)
    optimiser = torch_reference.adam(network)

    def epoch() -> float:
        began_s = time.perf_counter()
        torch_reference.train_epoch(network, optimiser, inputs, outputs, random.permutation(len(inputs)), BATCH)
        return time.perf_counter() - began_s

    return Way("plain torch, paper recipe", epoch)


def sequence_ways(tracks: Tracks) -> list[Way]:
    """The sequence recipe: one network of the paper's size, with few and with many windows at a time; and as it is."""
    # A single member would be kept from all plants; of one plant none is held out.
    alone = replace(tracks, plant=np.zeros_like(tracks.plant))
    recipe = SequenceSettings()
    one = replace(recipe, members=1, hidden=CELLS)
    many = replace(one, windows=PAPER_VECTORS // (LARGE_UPDATES * recipe.steps))
    return [
        sequence_way(SEQUENCE, alone, one),
        sequence_way(f"  in windows of {many.windows} at a time", alone, many),
        sequence_way(f"  as it is, {recipe.members} x {recipe.hidden}, per member", tracks, recipe),
    ]


def sequence_way(name: str, tracks: Tracks, settings: SequenceSettings) -> Way:
    training = SequenceTraining(tracks, settings, seed=1)
    per_update = settings.members * settings.windows * settings.steps
    training.updates = max(1, round(PAPER_VECTORS / per_update))
    share = PAPER_VECTORS / (training.updates * per_update)

    def epoch() -> float:
        began_s = time.perf_counter()
        loss = training._epoch()
        seconds = time.perf_counter() - began_s
        if not loss > 0.0:
            raise RuntimeError(f"{name}: the loss is {loss:g}: nothing was trained")
        return seconds * share

    return Way(name, epoch)


def write_keras(path: Path, start: PaperNetwork, inputs: Float32Array, outputs: Float32Array) -> None:
    """What keras_fit.py reads."""
    np.savez(
        path,
        inputs=inputs,
        outputs=outputs,
        kernel=start.cell.w_ih.T,
        recurrent=start.cell.w_hh.T,
        bias=start.cell.b,
        dense=start.dense.w.T,
        dense_bias=start.dense.b,
    )


def first_loss(start: PaperNetwork, inputs: Float32Array, outputs: Float32Array) -> float:
    """Mean absolute error of the first epoch in the order of the rows."""
    order = np.arange(len(inputs))
    return fused_step.train_epoch(fused_step.Training.of(start), 0, inputs, outputs, order, BATCH)[0]


def check_same(theirs: float, ours: float, console: Console) -> None:
    """Raises:
    RuntimeError: Keras and the compiled loop do not train the same.
    """
    console.print(f"first epoch from the same weights: mean absolute error {theirs:.4e} in Keras, {ours:.4e} here")
    if abs(theirs - ours) > SAME_LOSS * ours:
        raise RuntimeError("Keras and the compiled loop do not come to the same loss")


def timed(ways: Sequence[Way], repeats: int, aside: Console) -> dict[str, list[float]]:
    """Seconds per epoch of each way, which take turns; after one epoch each to get warm."""
    times: dict[str, list[float]] = {way.name: [] for way in ways}
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=aside, disable=not aside.is_terminal) as progress:
        bar = progress.add_task("epochs", total=len(ways) * (repeats + 1))
        for turn in range(repeats + 1):
            for way in ways:
                seconds = way.epoch()
                if turn > 0:
                    times[way.name].append(seconds)
                progress.advance(bar)
    return times


def medians(times: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Median of each way, and how many times faster than either Keras it is."""
    keras = {name: median(times[name]) for name in (KERAS_ONE, KERAS_ALL) if name in times}
    return {
        name: {"seconds": median(values)} | {f"times {other}": s / median(values) for other, s in keras.items()}
        for name, values in times.items()
    }


def show(times: dict[str, list[float]], versions: dict[str, str], machine: dict[str, Any], console: Console) -> None:
    table = Table(title=f"{PAPER_VECTORS:,} vectors or plant-steps, batch {BATCH}; medians of {_repeats(times)} turns")
    for heading in ("", "s / epoch", "range", "x Keras, 1 thread", "x its default", "goal"):
        table.add_column(heading, justify="left" if not heading else "right", no_wrap=True)
    for name, found in medians(times).items():
        ratios = [
            f"{found[key]:.1f}" if (key := f"times {keras}") in found else "-" for keras in (KERAS_ONE, KERAS_ALL)
        ]
        span = f"{min(times[name]):.3f} to {max(times[name]):.3f}"
        goal = f"{GOALS[name]:.0f}" if name in GOALS else ""
        table.add_row(name, f"{found['seconds']:.3f}", span, *ratios, goal)
    console.print(table)
    console.print(", ".join(f"{name} {version}" for name, version in versions.items()), highlight=False)
    before, after = machine["load"]
    console.print(
        f"{machine['processor']}, {machine['processors']} processors; load {before:.1f} before, {after:.1f} after"
        " (1 of it the bench's own)",
        highlight=False,
    )


def _repeats(times: dict[str, list[float]]) -> int:
    return len(next(iter(times.values())))


if __name__ == "__main__":
    sys.exit(main())
