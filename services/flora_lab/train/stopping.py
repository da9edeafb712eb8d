"""When to stop training, and which epoch was the best."""

from __future__ import annotations

import math
from typing import TypedDict


class StoppingState(TypedDict):
    """What :class:`EarlyStopping` remembers, as plain values."""

    best: float
    best_epoch: int
    epoch: int


class EarlyStopping:
    """Stop when the validation loss has not gone below its least value for ``patience`` epochs (Wahby et al. 2018).

    Args:
        patience: epochs, at least 1.

    Attributes:
        best: the least loss so far; infinite before the first epoch.
        best_epoch: when it was, counted from 1; 0 before the first.
        epoch: the last one that was told.
    """

    def __init__(self, patience: int) -> None:
        self.patience = patience
        self.best = math.inf
        self.best_epoch = 0
        self.epoch = 0

    def update(self, loss: float) -> bool:
        """Tell the loss of the next epoch; whether it is the least so far, so that its weights are worth keeping."""
        self.epoch += 1
        if not loss < self.best:
            return False
        self.best, self.best_epoch = loss, self.epoch
        return True

    @property
    def patience_left(self) -> int:
        """Epochs that may yet pass without a new best."""
        return self.patience - (self.epoch - self.best_epoch)

    @property
    def is_over(self) -> bool:
        """Whether to stop."""
        return self.patience_left <= 0

    def state(self) -> StoppingState:
        """For a checkpoint. Before the first epoch there is nothing to keep."""
        return {"best": self.best, "best_epoch": self.best_epoch, "epoch": self.epoch}

    def restore(self, state: StoppingState) -> None:
        """Go on where :meth:`state` was taken."""
        self.best, self.best_epoch, self.epoch = state["best"], state["best_epoch"], state["epoch"]
