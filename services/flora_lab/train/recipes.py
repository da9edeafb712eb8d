"""The recipes by which simulators are learned, and what they all take and give.

A recipe is a module with a function ``train(runs, options, progress) -> Trained``; one that can also learn from a
training set has ``train_on_data(path, options, progress) -> Trained``. Modules are imported when their recipe is
wanted: learning libraries take longer to load than most subcommands to do their work.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol, cast

import numpy as np

from flora_common.arrays import Array
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.store import Provenance
from flora_lab.train.split import SplitName


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """What can be chosen in any recipe. None leaves it to the recipe.

    Attributes:
        seed: of everything that is drawn.
        checkpoint: the file to keep the training in while it lasts.
        resume: go on from that file, if it is there; else it is dropped.
        epochs: at most so many.
        patience: epochs without a better validation loss after which to stop.
        batch: rows or sequences per step.
        split: how training and test are held apart.
    """

    seed: int
    checkpoint: Path
    resume: bool = False
    epochs: int | None = None
    patience: int | None = None
    batch: int | None = None
    split: SplitName | None = None


@dataclass(frozen=True, slots=True)
class Trained:
    """A simulator that was learned, as :func:`flora_lab.simulator.store.write_simulator` takes it.

    Attributes:
        kind, step_s, weights, scales, provenance: see :mod:`flora_lab.simulator.store`.
        figures: file name to content.
        table: lines for people, about the errors; units stand in them.
    """

    kind: str
    step_s: float
    weights: Mapping[str, Array]
    scales: Mapping[str, Any]
    provenance: Provenance
    figures: Mapping[str, bytes] = field(default_factory=dict)
    table: Sequence[str] = ()

    @property
    def results(self) -> Mapping[str, Any]:
        """Errors at the end of the training: those of the provenance."""
        return self.provenance.results


class Progress(Protocol):
    """Whom a recipe tells how far it is."""

    def note(self, text: str) -> None:
        """One line that a person should know of."""

    def stage(self, name: str) -> None:
        """What is done now, before and after the epochs."""

    def begin(self, epochs: int, done: int = 0) -> None:
        """Epochs start: at most so many, of which some were done before."""

    def epoch(self, number: int, losses: Mapping[str, float], patience_left: int | None = None) -> None:
        """An epoch was done, counted from 1; its losses by name; and how many more may pass without a better one."""


class FromRuns(Protocol):
    """``train`` of a recipe's module."""

    def __call__(self, runs: list[RunTrack], options: TrainOptions, progress: Progress) -> Trained:
        """Learn from measured runs."""


class FromData(Protocol):
    """``train_on_data`` of a recipe's module."""

    def __call__(self, path: Path, options: TrainOptions, progress: Progress) -> Trained:
        """Learn from the training set in a folder."""


@dataclass(frozen=True, slots=True)
class TrainRecipe:
    """An entry of :data:`RECIPES`.

    Attributes:
        module: where its functions are.
        takes_data: whether it also learns from a training set.
        without: names of :class:`TrainOptions` that change nothing in it.
    """

    module: str
    takes_data: bool
    without: tuple[str, ...] = ()

    def from_runs(self) -> FromRuns:
        """Import it."""
        return cast(FromRuns, importlib.import_module(self.module).train)

    def from_data(self) -> FromData:
        """Import it; only where ``takes_data``."""
        return cast(FromData, importlib.import_module(self.module).train_on_data)


RECIPES: Final = {
    "sequence": TrainRecipe("flora_lab.train.sequence", takes_data=False),
    "mechanistic": TrainRecipe("flora_lab.train.mechanistic", takes_data=False, without=("patience", "batch", "split")),
    "paper": TrainRecipe("flora_lab.train.paper", takes_data=True),
}
DEFAULT_RECIPE: Final = "sequence"


def generator(seed: int, purpose: int, *more: int) -> np.random.Generator:
    """Random numbers for one purpose, which no other purpose's use of them changes."""
    return np.random.default_rng([seed, purpose, *more])
