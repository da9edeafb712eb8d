"""Training of the sequence recipe: free runs from measured stems, compared with what the plants did.

Every member learns from all plants but its own few; how well it foresees those over a day, with nothing known of them,
decides which of its epochs is kept. One-step errors are never looked at.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from flora_common.arrays import Array, BoolArray
from flora_lab.stopped_work import nothing_kept
from flora_lab.train.checkpoint import Checkpoint
from flora_lab.train.recipes import Progress, generator
from flora_lab.train.sequence_losses import CompiledLosses, Losses, TorchLosses
from flora_lab.train.sequence_net import LawNet
from flora_lab.train.stopping import EarlyStopping
from flora_lab.train.windows import Scale, Starts, Tracks, Windows, windows_at

FIRST_SHARE: Final = 0.15
FEWEST_FOLDS: Final = 4
"""No member does without more than about a quarter of the plants."""
JUDGE_STEPS: Final = 288
"""Validation looks a day ahead."""
JUDGE_STARTS: Final = 4
TRAITS_RATE: Final = 4.0
"""Traits of plants may change faster than weights."""
TRAITS_DOUBT: Final = 0.002
LARGEST_GRADIENT: Final = 1.0
WARM_SHARE: Final = 0.1
_WINDOWS, _FOLDS, _WEIGHTS = 1, 2, 3


@dataclass(frozen=True, slots=True)
class SequenceSettings:
    """What decides a training.

    Attributes:
        members: networks, each trained without some of the plants.
        hidden: cells of each.
        steps: length of a window.
        windows: per step of the optimiser.
        rate: of learning, at its highest; it rises for the first tenth and falls to nothing as a cosine.
        epochs: at most; in one epoch as many steps are run as the tracks hold.
        patience: epochs without a better validation.
        scale: how errors are weighed.
        mirror: learn from mirror images too.
    """

    members: int = 4
    hidden: int = 32
    steps: int = 144
    windows: int = 24
    rate: float = 8e-3
    epochs: int = 80
    patience: int = 20
    scale: Scale = field(default_factory=Scale)
    mirror: bool = True


@dataclass(frozen=True, slots=True)
class Curve:
    """Losses of the epochs.

    Attributes:
        train, validate: means over members, one value per epoch.
        best_epoch: of each member, counted from 1.
    """

    train: list[float]
    validate: list[float]
    best_epoch: list[int]


def device() -> torch.device:
    """An accelerator if there is one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Small products are faster, and sums always in one order, in a single thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def held_out(plants: int, members: int, seed: int) -> BoolArray:
    """Which plants each member never learns from, shape (members, plants).

    With fewer than three plants none can be spared.
    """
    mask = np.zeros((members, plants), dtype=np.bool_)
    if plants < 3:
        return mask
    order = generator(seed, _FOLDS).permutation(plants)
    folds = max(members, FEWEST_FOLDS)
    for m in range(members):
        mask[m, order[m::folds] if m < plants else order[[m % plants]]] = True
    return mask


class SequenceTraining:
    """A training that can be left after any epoch and gone on with, to the bit.

    Args:
        tracks: of the runs.
        settings: how.
        seed: of everything that is drawn.
    """

    def __init__(self, tracks: Tracks, settings: SequenceSettings, seed: int) -> None:
        self.tracks = tracks
        self.settings = settings
        self.device = device()
        weights = torch.Generator().manual_seed(int(generator(seed, _WEIGHTS).integers(2**62)))
        self.net = LawNet(settings.members, settings.hidden, tracks.plants, weights).to(self.device)
        self.best = {name: value.detach().clone() for name, value in self.net.state_dict().items()}
        self.best_loss = np.full(settings.members, np.inf)
        self.best_epoch = np.zeros(settings.members, dtype=np.int64)
        self.random = generator(seed, _WINDOWS)
        self.held = held_out(tracks.plants, settings.members, seed)
        self._losses: Losses = CompiledLosses(self.net) if self.device.type == "cpu" else TorchLosses(self.net)
        self._learned = torch.tensor(~self.held, dtype=torch.float32, device=self.device)
        self._starts = Starts(tracks, settings.steps)
        self._judged: tuple[Windows, Array] | None = None
        rest = [p for name, p in self.net.named_parameters() if name != "traits"]
        self.optimiser = torch.optim.Adam(
            [{"params": rest, "lr": settings.rate}, {"params": [self.net.traits], "lr": TRAITS_RATE * settings.rate}],
            fused=True,
        )
        self.updates = max(4, math.ceil(tracks.vectors / (settings.windows * settings.steps)))
        self.stopping = EarlyStopping(settings.patience)
        self.curve = Curve([], [], [])

    def run(self, checkpoint: Checkpoint, progress: Progress, *, resume: bool) -> Curve:
        """Train to the early stop; the net then holds each member's best weights."""
        saved = checkpoint.begin(resume=resume)
        if saved is not None:
            self._restore(saved.arrays, saved.state)
        elif resume:
            progress.note(nothing_kept(checkpoint.path))
        progress.begin(self.settings.epochs, self.stopping.epoch)
        with one_thread(), checkpoint:
            while self.stopping.epoch < self.settings.epochs and not self.stopping.is_over:
                train = self._epoch()
                validate = self._judge()
                self.curve.train.append(train)
                self.curve.validate.append(float(validate.mean()))
                self.stopping.update(self.curve.validate[-1])
                self._keep_best(validate)
                losses = {"train": train, "validate": self.curve.validate[-1]}
                progress.epoch(self.stopping.epoch, losses, self.stopping.patience_left)
                checkpoint.offer(*self._state())
        self.net.load_state_dict(self.best)
        return Curve(self.curve.train, self.curve.validate, self.best_epoch.tolist())

    def _epoch(self) -> float:
        settings, total = self.settings, 0.0
        for update in range(self.updates):
            share = (self.stopping.epoch + update / self.updates) / settings.epochs
            rate = settings.rate * min(1.0, share / WARM_SHARE + 0.05) * 0.5 * (1.0 + math.cos(math.pi * share))
            for group, times in zip(self.optimiser.param_groups, (1.0, TRAITS_RATE), strict=True):
                group["lr"] = rate * times
            run, row = self._starts.draw(settings.windows, self.random, first_share=FIRST_SHARE)
            plant = self.tracks.plant[run]
            learned = ~self.held[:, plant]
            weight = (learned / np.maximum(learned.sum(1, keepdims=True), 1)).astype(np.float32)
            self.optimiser.zero_grad()
            traits = self.net.centred_traits(self._learned)[:, torch.as_tensor(plant, device=self.device)]
            (TRAITS_DOUBT * (self.net.traits**2).sum()).backward()  # type: ignore[no-untyped-call]
            windows = windows_at(self.tracks, run, row, settings.steps, settings.scale)
            total += self._losses.learn(windows, traits, weight)
            self._clip()
            self.optimiser.step()
        return total / (self.updates * settings.members)

    def _clip(self) -> None:
        """Each member's gradient by itself: what one cannot learn from must not slow another down."""
        gradients = [p.grad for p in self.net.parameters() if p.grad is not None]
        squares = torch.stack([(g**2).flatten(1).sum(1) if g.dim() > 1 else g**2 for g in gradients]).sum(0)
        factor = (LARGEST_GRADIENT / (squares.sqrt() + 1e-6)).clamp(max=1.0)
        for gradient in gradients:
            gradient.mul_(factor.reshape(-1, *[1] * (gradient.dim() - 1)))

    def _judge(self) -> Array:
        """Loss of each member on plants that it never learned from, with nothing known of them; shape (members,)."""
        if self._judged is None:
            run, row = Starts(self.tracks, JUDGE_STEPS).spread(JUDGE_STARTS)
            steps = min(JUDGE_STEPS, self.tracks.light.shape[1])
            self._judged = windows_at(self.tracks, run, row, steps, self.settings.scale), self.tracks.plant[run]
        windows, plant = self._judged
        asked = self.held[:, plant]
        asked = asked | ~asked.any(1, keepdims=True)  # no plant could be spared: judged by what it learned from
        weight = (asked / asked.sum(1, keepdims=True)).astype(np.float32)
        return np.asarray((self._losses.tell(windows, weight) * weight).sum(1), dtype=np.float64)

    def _keep_best(self, validate: Array) -> None:
        better = validate < self.best_loss
        self.best_loss[better] = validate[better]
        self.best_epoch[better] = self.stopping.epoch
        which = torch.tensor(better, device=self.device)
        for name, value in self.net.state_dict().items():
            shape = (-1, *[1] * (value.dim() - 1))
            self.best[name] = torch.where(which.reshape(shape), value, self.best[name])

    def _state(self) -> tuple[dict[str, Array], dict[str, Any]]:
        arrays = {f"net.{name}": value.cpu().numpy() for name, value in self.net.state_dict().items()}
        arrays |= {f"best.{name}": value.cpu().numpy() for name, value in self.best.items()}
        arrays |= {"best_loss": self.best_loss, "best_epoch": self.best_epoch}
        for index, entry in self.optimiser.state_dict()["state"].items():
            arrays |= {f"adam.{index}.{name}": np.asarray(value.cpu().numpy()) for name, value in entry.items()}
        state = {
            "random": self.random.bit_generator.state,
            "stopping": self.stopping.state(),
            "train": list(self.curve.train),
            "validate": list(self.curve.validate),
        }
        return arrays, state

    def _restore(self, arrays: Any, state: Any) -> None:
        def under(prefix: str) -> dict[str, Tensor]:
            found = {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
            return {name: torch.tensor(value, device=self.device) for name, value in found.items()}

        self.net.load_state_dict(under("net."))
        self.best = under("best.")
        self.best_loss, self.best_epoch = arrays["best_loss"].copy(), arrays["best_epoch"].copy()
        entries: dict[int, dict[str, Tensor]] = {}
        for name, value in under("adam.").items():
            index, key = name.split(".")
            entries.setdefault(int(index), {})[key] = value
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": entries, "param_groups": groups})
        self.random.bit_generator.state = state["random"]
        self.stopping.restore(state["stopping"])
        self.curve = Curve(list(state["train"]), list(state["validate"]), [])
