"""``--recipe paper``: the training procedure of Wahby et al. 2018.

An LSTM of 50 cells learns single steps: batches of 30 in random order, Adam with rate 0.001, mean absolute error, at
most 200 epochs, stopped when the validation loss has not got better for ten. Weights start as Keras starts them, which
the paper used; those of the best epoch are kept, of which the paper says nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from flora_common.arrays import Float32Array
from flora_common.errors import BadInput
from flora_lab.dataset.build import build
from flora_lab.dataset.pairs import Pairs
from flora_lab.dataset.recipe import Recipe
from flora_lab.dataset.store import RunEntry, read_dataset
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.lstm_cell import Dense, LstmCell
from flora_lab.simulator.paper import CELLS, COORDINATES, INPUTS, Box, PaperNetwork, PaperSimulator
from flora_lab.simulator.store import Provenance, TrackEntry, software
from flora_lab.stopped_work import nothing_kept
from flora_lab.train import fused_step
from flora_lab.train.checkpoint import Checkpoint
from flora_lab.train.curve import curve_png
from flora_lab.train.fused_step import Training
from flora_lab.train.recipes import Progress, Trained, TrainOptions, generator
from flora_lab.train.split import Split, split
from flora_lab.train.stopping import EarlyStopping

NAME: Final = "paper"
EPOCHS: Final = 200
PATIENCE: Final = 10
BATCH: Final = 30
PAPER_MAE: Final = {"train": 1.55e-3, "validate": 1.55e-3, "test": 1.44e-3}
PAPER_EPOCHS: Final = 27
MM_PER_CM: Final = 10.0

# What random numbers are for.
_WEIGHTS, _SPLIT, _SHUFFLE = 1, 2, 3


@dataclass(frozen=True, slots=True)
class Material:
    """A training set, from a folder or made just now.

    Attributes:
        pairs: the vectors.
        runs: where they are from; ``pairs.run`` counts them.
        recipe: how they were made.
        where: names it in messages.
        dataset_sha256: of its folder's data, or empty.
    """

    pairs: Pairs
    runs: Sequence[RunEntry | RunTrack]
    recipe: Recipe
    where: str
    dataset_sha256: str = ""


def train(runs: list[RunTrack], options: TrainOptions, progress: Progress) -> Trained:
    """Learn from runs, by the training set that ``flora-lab dataset`` makes of them without further options.

    Raises:
        BadInput: runs that no training set can be made of; see :func:`train_on`.
    """
    recipe = Recipe()
    try:
        pairs = build(runs, recipe, on_step=progress.stage).pairs
    except BadInput as problem:
        hint = " (an option of `flora-lab dataset`; train on what that makes)" if "--" in str(problem) else ""
        raise BadInput(f"{problem}{hint}") from problem
    where = f"{runs[0].file}{' and the others' if len(runs) > 1 else ''}"
    return train_on(Material(pairs, runs, recipe, where), options, progress)


def train_on_data(path: Path, options: TrainOptions, progress: Progress) -> Trained:
    """Learn from the training set in a folder.

    Raises:
        BadInput: see :func:`flora_lab.dataset.store.read_dataset` and :func:`train_on`.
    """
    data = read_dataset(path)
    material = Material(data.pairs, data.info.run, data.info.recipe, str(path), data.info.data_sha256)
    return train_on(material, options, progress)


def train_on(material: Material, options: TrainOptions, progress: Progress) -> Trained:
    """Learn from a training set.

    Raises:
        BadInput: too few vectors or plants for the split, or a checkpoint of other work.
    """
    pairs, unit_cm = material.pairs, material.recipe.unit_cm
    settings: dict[str, Any] = {
        "epochs": EPOCHS if options.epochs is None else options.epochs,
        "patience": PATIENCE if options.patience is None else options.patience,
        "batch": BATCH if options.batch is None else options.batch,
        "split": options.split or "rows",
        "cells": CELLS,
        "learning_rate": fused_step.LEARNING_RATE,
        "beta_1": fused_step.BETA_1,
        "beta_2": fused_step.BETA_2,
        "epsilon": fused_step.EPSILON,
    }
    plants = np.array([run.plant for run in material.runs])[pairs.run]
    parts = split(plants, settings["split"], generator(options.seed, _SPLIT), material.where)
    work = {
        # `epochs` is no part of it: a training may go on for longer than was first meant.
        **{name: value for name, value in settings.items() if name != "epochs"},
        "recipe": NAME,
        "seed": options.seed,
        "data": _fingerprint(pairs, plants),
        "software": f"{software()}, numpy {np.__version__}",
    }
    start = initial_network(generator(options.seed, _WEIGHTS))
    with Checkpoint(options.checkpoint, work) as checkpoint:
        fitted = _fit(pairs, parts, start, settings, options, checkpoint, progress)
    progress.stage("errors")
    errors = _errors(fitted.best, pairs, parts, unit_cm)
    simulator = PaperSimulator(
        fused_step.unpack(fitted.best, start),
        Box.around(pairs.inputs[parts.train]),
        unit_cm=unit_cm,
        step_s=material.recipe.interval_s,
    )
    results = {
        **errors,
        "epochs": fitted.stopping.epoch,
        "best_epoch": fitted.stopping.best_epoch,
        "vectors_train": len(parts.train),
        "vectors_validate": len(parts.validate),
        "vectors_test": len(parts.test),
        "loss_train": fitted.losses[0],
        "loss_validate": fitted.losses[1],
    }
    provenance = Provenance(
        recipe=NAME,
        seed=options.seed,
        software=software(),
        dataset_sha256=material.dataset_sha256,
        split=parts.how,
        settings={**settings, "dataset": msgspec.to_builtins(material.recipe)},
        results=results,
        track=[TrackEntry(run.name, run.plant, run.sha256, parts.part_of[run.plant]) for run in _used(material)],
    )
    nothing = ("nothing moves (validation)", errors["nothing_moves_validate"])
    return Trained(
        kind=PaperSimulator.kind,
        step_s=simulator.step_s,
        weights=simulator.weights(),
        scales=simulator.scales(),
        provenance=provenance,
        figures={"training.png": curve_png(*fitted.losses, [fitted.stopping.best_epoch], level=nothing)},
        table=_table(results, unit_cm, parts),
    )


def initial_network(rng: np.random.Generator) -> PaperNetwork:
    """Weights as Keras draws them: uniform after Glorot, orthogonal recurrent ones, biases 0, but 1 of forget gates."""
    cell_limit, dense_limit = np.sqrt(6.0 / (INPUTS + 4 * CELLS)), np.sqrt(6.0 / (CELLS + COORDINATES))
    orthogonal, triangle = np.linalg.qr(rng.standard_normal((4 * CELLS, CELLS)))
    bias = np.zeros(4 * CELLS)
    bias[CELLS : 2 * CELLS] = 1.0
    cell = LstmCell(
        rng.uniform(-cell_limit, cell_limit, (4 * CELLS, INPUTS)), orthogonal * np.sign(np.diag(triangle)), bias
    )
    dense = Dense.of(rng.uniform(-dense_limit, dense_limit, (COORDINATES, CELLS)), np.zeros(COORDINATES))
    return PaperNetwork(cell, dense)


@dataclass(frozen=True, slots=True)
class _Fitted:
    """``theta`` of the best epoch, when it was, and both losses of each epoch."""

    best: Float32Array
    stopping: EarlyStopping
    losses: tuple[list[float], list[float]]


def _fit(
    pairs: Pairs,
    parts: Split,
    start: PaperNetwork,
    settings: Mapping[str, Any],
    options: TrainOptions,
    checkpoint: Checkpoint,
    progress: Progress,
) -> _Fitted:
    training, stopping = Training.of(start), EarlyStopping(settings["patience"])
    best, steps = training.theta.copy(), 0
    losses: tuple[list[float], list[float]] = ([], [])
    saved = checkpoint.begin(resume=options.resume)
    if saved is not None:
        training = Training(*(saved.arrays[name] for name in ("theta", "first", "second")))
        best, steps = saved.arrays["best"], saved.state["steps"]
        stopping.restore(saved.state["stopping"])
        losses = (saved.state["loss_train"], saved.state["loss_validate"])
        progress.note(f"going on after epoch {stopping.epoch}, from {checkpoint.path}")
    elif options.resume:
        progress.note(nothing_kept(checkpoint.path))
    progress.begin(settings["epochs"], stopping.epoch)
    while stopping.epoch < settings["epochs"] and not stopping.is_over:
        epoch = stopping.epoch + 1
        # Seed and epoch are all the state that the random numbers have: a resumed epoch shuffles as it would have.
        order = generator(options.seed, _SHUFFLE, epoch).permutation(parts.train)
        loss, steps = fused_step.train_epoch(training, steps, pairs.inputs, pairs.outputs, order, settings["batch"])
        validation = fused_step.mean_absolute_error(training.theta, pairs.inputs, pairs.outputs, parts.validate)
        if stopping.update(validation):
            best = training.theta.copy()
        losses[0].append(loss)
        losses[1].append(validation)
        checkpoint.offer(
            {"theta": training.theta, "first": training.first, "second": training.second, "best": best},
            {
                "steps": steps,
                "stopping": stopping.state(),
                "loss_train": list(losses[0]),
                "loss_validate": list(losses[1]),
            },
        )
        progress.epoch(epoch, {"train": loss, "validate": validation}, stopping.patience_left)
    return _Fitted(best, stopping, losses)


def _errors(theta: Float32Array, pairs: Pairs, parts: Split, unit_cm: float) -> dict[str, float]:
    """Mean absolute error of each part in units and mm, beside that of the stem staying as it is."""
    found: dict[str, float] = {}
    for part, rows in parts.parts().items():
        moved = pairs.outputs[rows].astype(np.float64) - pairs.inputs[rows, :COORDINATES]
        for name, value in (
            (f"mae_{part}", fused_step.mean_absolute_error(theta, pairs.inputs, pairs.outputs, rows)),
            (f"nothing_moves_{part}", float(np.abs(moved).mean())),
        ):
            found[name], found[f"{name}_mm"] = value, value * unit_cm * MM_PER_CM
    return found


def _table(results: Mapping[str, Any], unit_cm: float, parts: Split) -> list[str]:
    lines = [
        f"mean absolute error per coordinate and step; 1 unit = {unit_cm:g} cm",
        f"{'':<10}{'vectors':>9}{'ours':>12}{'paper':>12}{'nothing moves':>15}{'ours in mm':>12}",
    ]
    for part, paper in PAPER_MAE.items():
        ours, still = results[f"mae_{part}"], results[f"nothing_moves_{part}"]
        lines.append(
            f"{part:<10}{results[f'vectors_{part}']:>9}{ours:>12.3e}{paper:>12.2e}{still:>15.3e}"
            f"{results[f'mae_{part}_mm']:>12.3f}"
        )
    kept = f"stopped after epoch {results['epochs']}, kept epoch {results['best_epoch']}"
    return [*lines, f"{kept} (paper: stopped at {PAPER_EPOCHS})", parts.how]


def _used(material: Material) -> list[RunEntry | RunTrack]:
    """Runs of which at least one vector is there."""
    present = set(np.unique(material.pairs.run).tolist())
    return [run for number, run in enumerate(material.runs) if number in present]


def _fingerprint(pairs: Pairs, plants: Any) -> str:
    digest = hashlib.sha256()
    for array in (pairs.inputs, pairs.outputs):
        digest.update(array.tobytes())
    digest.update("\n".join(plants.tolist()).encode())
    return digest.hexdigest()
