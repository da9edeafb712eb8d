"""Training of the sequence recipe: free runs from measured stems, compared with what the plants did.

Every member learns from all plants but its own few; how well it foresees those over a day, with nothing known of them,
decides which of its epochs is kept. One-step errors are never looked at.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from flora_lab.train.checkpoint import Checkpoint
from flora_lab.train.recipes import Progress, generator
from flora_lab.train.sequence_net import LawNet, distances_cm, free_run
from flora_lab.train.stopping import EarlyStopping
from flora_lab.train.windows import Tracks, draw_windows

Array = npt.NDArray[Any]

TELL_EVERY: Final = 6
FIRST_SHARE: Final = 0.15
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
        near_cm, per_h_cm: errors count as squares up to this size, which grows with the horizon, and as such beyond it:
            chance swings a plant about, and must not pull the law about.
        mirror: learn from mirror images too.
    """

    members: int = 4
    hidden: int = 32
    steps: int = 72
    windows: int = 36
    rate: float = 8e-3
    epochs: int = 36
    patience: int = 10
    near_cm: float = 0.05
    per_h_cm: float = 0.05
    length_share: float = 0.4
    length_weight: float = 1.0
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


def _robust(squares: Tensor) -> Tensor:
    """Of squared errors in units of what is near: half the square when small, the error itself when large."""
    return torch.sqrt(1.0 + squares) - 1.0


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


def held_out(plants: int, members: int, seed: int) -> npt.NDArray[np.bool_]:
    """Which plants each member never learns from, shape (members, plants).

    With fewer than three plants none can be spared.
    """
    mask = np.zeros((members, plants), dtype=np.bool_)
    if plants < 3:
        return mask
    order = generator(seed, _FOLDS).permutation(plants)
    for m in range(members):
        mask[m, order[m::members] if m < plants else order[[m % plants]]] = True
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
        self._held = torch.tensor(self.held, device=self.device)
        rest = [p for name, p in self.net.named_parameters() if name != "traits"]
        self.optimiser = torch.optim.Adam(
            [{"params": rest, "lr": settings.rate}, {"params": [self.net.traits], "lr": TRAITS_RATE * settings.rate}]
        )
        self.updates = max(4, math.ceil(tracks.vectors / (settings.windows * settings.steps)))
        self.stopping = EarlyStopping(settings.patience)
        self.curve = Curve([], [], [])

    def run(self, checkpoint: Checkpoint, progress: Progress, *, resume: bool) -> Curve:
        """Train to the early stop; the net then holds each member's best weights."""
        saved = checkpoint.load() if resume else None
        if saved is not None:
            self._restore(saved.arrays, saved.state)
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
        total = 0.0
        for update in range(self.updates):
            share = (self.stopping.epoch + update / self.updates) / self.settings.epochs
            rate = self.settings.rate * min(1.0, share / WARM_SHARE + 0.05) * 0.5 * (1.0 + math.cos(math.pi * share))
            for group, times in zip(self.optimiser.param_groups, (1.0, TRAITS_RATE), strict=True):
                group["lr"] = rate * times
            run, row = draw_windows(
                self.tracks, self.settings.steps, self.settings.windows, self.random, first_share=FIRST_SHARE
            )
            loss = self._losses(run, row, self.settings.steps, self.net.centred_traits()[self._plant(run)])
            learned = ~self._held[:, self._plant(run)]
            per_member = (loss * learned).sum(1) / learned.sum(1).clamp(min=1)
            doubt = TRAITS_DOUBT * (self.net.traits**2).sum()
            self.optimiser.zero_grad()
            (per_member.sum() + doubt).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self.net.parameters(), LARGEST_GRADIENT * self.settings.members)
            self.optimiser.step()
            total += float(per_member.detach().mean())
        return total / self.updates

    def _judge(self) -> Array:
        """Loss of each member on plants that it never learned from, with nothing known of them; shape (members,)."""
        runs: list[int] = []
        rows: list[int] = []
        for track in range(len(self.tracks)):
            last = max(1, int(self.tracks.rows[track]) - JUDGE_STEPS)
            able = np.nonzero(self.tracks.can_start[track, :last])[0]
            chosen = np.unique(able[np.linspace(0, len(able) - 1, JUDGE_STARTS).round().astype(int)])
            runs += [track] * len(chosen)
            rows += chosen.tolist()
        run = np.array(runs)
        steps = min(JUDGE_STEPS, self.tracks.line_cm.shape[1] - 1)
        with torch.no_grad():
            unknown = torch.zeros(len(run), self.net.traits.shape[1], device=self.device)
            loss = self._losses(run, np.array(rows), steps, unknown)
            asked = self._held[:, self._plant(run)]
            asked = asked | ~asked.any(1, keepdim=True)  # no plant could be spared: judged by what it learned from
            return np.asarray(((loss * asked).sum(1) / asked.sum(1)).cpu().numpy(), dtype=np.float64)

    def _plant(self, run: Array) -> Tensor:
        return torch.tensor(self.tracks.plant[run], device=self.device)

    def _losses(self, run: Array, row: Array, steps: int, traits: Tensor) -> Tensor:
        """Mean loss of each window, shape (members, windows)."""
        every = min(TELL_EVERY, steps)
        at = np.arange(steps)
        last = self.tracks.light.shape[1] - 1
        light = self.tracks.light[run[None], np.minimum(row[None] + at[:, None], last)]
        told = row[:, None] + every * (1 + np.arange(steps // every))
        inside = told < self.tracks.rows[run][:, None]
        line = self.tracks.line_cm[run[:, None], np.minimum(told, last + 1)]
        known = torch.tensor(inside & np.isfinite(line[:, :, 0, 0]), device=self.device)
        lines = torch.tensor(np.nan_to_num(line), device=self.device)
        grown = torch.tensor(
            np.nan_to_num(self.tracks.length[run[:, None], np.minimum(told, last + 1)].sum(-1)), device=self.device
        )
        members = self.settings.members
        length = torch.tensor(self.tracks.length[run, row], device=self.device).expand(members, -1, -1)
        angle = torch.tensor(self.tracks.angle[run, row], device=self.device).expand(members, -1, -1)
        stems = free_run(self.net, length, angle, torch.tensor(light, device=self.device), traits, every)
        total = torch.zeros(members, len(run), device=self.device)
        for k, (lengths, angles) in enumerate(stems):
            near_cm = self.settings.near_cm + self.settings.per_h_cm * (k + 1) * every / 12.0
            away = distances_cm(lengths, angles, lines[:, k])
            shape = _robust(away / near_cm**2).mean(-1)
            size = _robust(((lengths.sum(-1) - grown[:, k]) / (self.settings.length_share * near_cm)) ** 2)
            total = total + (shape + self.settings.length_weight * size) * known[:, k]
        return total / known.sum(1).clamp(min=1)

    def _keep_best(self, validate: Array) -> None:
        better = validate < self.best_loss
        self.best_loss[better] = validate[better]
        self.best_epoch[better] = self.stopping.epoch
        which = torch.tensor(better, device=self.device)
        for name, value in self.net.state_dict().items():
            if name == "traits":
                self.best[name] = value.detach().clone()  # shared by all members
            else:
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
            "train": self.curve.train,
            "validate": self.curve.validate,
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
