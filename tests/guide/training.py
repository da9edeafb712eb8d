"""Training of the network in torch: floating point, with normalised batches."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from flora_common import files
from flora_common.vision.path.convolutions import CHANNELS, DECODER, DILATIONS, ENCODER
from guide.pool import Pool

WIDTHS: Final = 16, 32, 64, 160
"""Channels of each level."""
BATCH, BATCH_ON_CARD = 16, 64
RATE, WARM_UP, POWER, DECAY, LEAST_RATE = 2e-3, 200, 0.9, 1e-4, 1e-3
"""Of the steps' size: greatest, steps until then, how it falls to the last one, of weights; least, as a share."""
NEAREST: Final = 0.86
"""What is wanted of the apex' own pixel at least, wherever in that it lies."""
STEM_COUNTS: Final = 4.0
"""Places of a stem count by so much more than others."""
APEX_SHARE: Final = 0.1
SAVED_EVERY, TOLD_EVERY = 1000, 100
RECORDED_AFTER: Final = 5
"""Steps on a card before one is recorded: libraries choose their ways in them."""
SEED: Final = 2


class Trained(nn.Module):
    """The same network as :class:`flora_common.vision.path.convolutions.Network`, by the same names."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleDict()
        before = CHANNELS
        for names, width in zip(ENCODER, WIDTHS, strict=True):
            for k, name in enumerate(names):
                self.layers[name] = convolution(before, width, 2 if k == 0 else 1, DILATIONS.get(name, 1))
                before = width
        for names, width in zip(DECODER, WIDTHS[-2::-1], strict=True):
            for k, name in enumerate(names):
                self.layers[name] = convolution(before + (width if k == 0 else 0), width, 1, 1)
                before = width
        self.head = nn.Conv2d(before, 2, 1)
        nn.init.constant_(self.head.bias, -3.0)

    def forward(self, x: Tensor) -> Tensor:
        """Logits of both maps, shape (batch, 2, height / 2, width / 2), of an input in 0..255."""
        levels = []
        for names in ENCODER:
            for name in names:
                x = self.layers[name](x)
            levels.append(x)
        levels.pop()
        for names in DECODER:
            x = torch.cat([levels.pop(), functional.interpolate(x, scale_factor=2, mode="nearest")], 1)
            for name in names:
                x = self.layers[name](x)
        with torch.autocast(x.device.type, enabled=False):
            return self.head(x.float())


def convolution(before: int, after: int, stride: int, dilation: int) -> nn.Sequential:
    """A convolution, normalised and cut at 0."""
    layer = nn.Conv2d(before, after, 3, stride, dilation, dilation=dilation, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(after), nn.ReLU(inplace=True))


def loss(said: Tensor, wanted: Tensor) -> Tensor:
    """Cross entropy of the stem's map; of the apex's the focal loss of CenterNet (Zhou, Wang, Krähenbühl 2019)."""
    stem, apex, near = said[:, 0], said[:, 1], wanted[:, 1]
    by_place = functional.binary_cross_entropy_with_logits(stem, wanted[:, 0], reduction="none")
    likely, there = torch.sigmoid(apex), ((near == near.amax(dim=(1, 2), keepdim=True)) & (near > NEAREST)).float()
    found = there * (1 - likely) ** 2 * functional.logsigmoid(apex)
    missed = (1 - there) * (1 - near) ** 4 * likely**2 * functional.logsigmoid(-apex)
    focal = -(found + missed).sum() / there.sum().clamp(min=1)
    return (by_place * (1 + STEM_COUNTS * wanted[:, 0])).mean() + APEX_SHARE * focal


class Learner:
    """A network that learns step by step.

    On a graphics card a step is recorded once and played back (a CUDA graph), for a processor takes longer to ask for
    its several hundred small parts than a card to do them.

    Args:
        pool: what it learns from, on the device where it learns.
    """

    def __init__(self, pool: Pool) -> None:
        torch.manual_seed(SEED)
        self.steps, self.elapsed_s = 0, 0.0
        self._pool, device = pool, pool.device
        self._has_card = device.type == "cuda"
        self._batch = BATCH_ON_CARD if self._has_card else BATCH
        self.net = Trained().to(device, memory_format=torch.channels_last)
        self._rate = torch.zeros((), device=device)
        self._optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=self._rate, weight_decay=DECAY, fused=True, capturable=self._has_card
        )
        self._total = torch.zeros((), device=device)
        self._until_recorded = RECORDED_AFTER
        self._recorded: torch.cuda.CUDAGraph | None = None

    def step(self, size: float) -> None:
        """Learn from a batch, drawn of a seed of its own: who stops and goes on draws as who does not.

        Args:
            size: of the step, as a share of the greatest.
        """
        self._rate.fill_(RATE * size)
        torch.manual_seed(SEED + 1 + self.steps)
        if not self._has_card:
            self._learn()
        elif self._until_recorded > 0:
            self._until_recorded -= 1
            torch.cuda.synchronize()
            with torch.cuda.stream(torch.cuda.Stream()):  # as recording asks for
                self._learn()
            torch.cuda.synchronize()
        else:
            if self._recorded is None:
                self._recorded = torch.cuda.CUDAGraph()
                with torch.cuda.graph(self._recorded):
                    self._learn()
            self._recorded.replay()
        self.steps += 1

    def mean_loss(self) -> float:
        """Of the steps since it was asked for last."""
        found = self._total.item()
        self._total.zero_()
        return found

    def keep(self, path: Path) -> None:
        """Write what is learnt, to go on from, whole or not at all."""
        buffer = io.BytesIO()
        kept = {"net": self.net.state_dict(), "optimiser": self._optimiser.state_dict()}
        torch.save({**kept, "steps": self.steps, "elapsed_s": self.elapsed_s}, buffer)
        files.write_bytes(path, buffer.getvalue())

    def go_on(self, path: Path) -> None:
        """Go on from what was kept, before any step."""
        kept = torch.load(path, weights_only=True, map_location=self._pool.device)
        self.net.load_state_dict(kept["net"])
        self._optimiser.load_state_dict(kept["optimiser"])
        self._rate = self._optimiser.param_groups[0]["lr"]
        self.steps, self.elapsed_s = int(kept["steps"]), float(kept["elapsed_s"])

    def _learn(self) -> None:
        seen, wanted = self._pool.sample(self._batch)
        with torch.autocast(seen.device.type, torch.bfloat16, cache_enabled=False):  # a third less time
            said = self.net(seen)
        value = loss(said, wanted)
        self._optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(self.net.parameters(), 2.0)
        self._optimiser.step()
        self._total += value.detach() / TOLD_EVERY


def train(
    pool: Pool,
    progress: Callable[[int, float], float],
    checkpoint: Path,
    told: Callable[[int, float], None],
    more: Callable[[], None] = lambda: None,
) -> Trained:
    """Train, or go on with it.

    Args:
        pool: examples of each kind, at least one.
        progress: share that is done after so many steps and seconds; the last step is where it comes to 1.
        checkpoint: what is done is kept here every :data:`SAVED_EVERY` steps, and gone on with.
        told: step and mean loss of the last :data:`TOLD_EVERY`.
        more: called as often; it may add to the pool.
    """
    learner = Learner(pool)
    if checkpoint.exists():
        learner.go_on(checkpoint)
    began_s = time.monotonic() - learner.elapsed_s
    while (done := progress(learner.steps, learner.elapsed_s)) < 1.0:
        learner.step(min(1.0, learner.steps / WARM_UP) * (1.0 - done) ** POWER + LEAST_RATE)
        if learner.steps % TOLD_EVERY == 0:
            more()
            told(learner.steps, learner.mean_loss())
            learner.elapsed_s = time.monotonic() - began_s
        if learner.steps % SAVED_EVERY == 0:
            learner.keep(checkpoint)
    learner.keep(checkpoint)
    return learner.net.cpu().eval()


def averaged(net: Trained, checkpoint: Path, share: float, pool: Pool, batches: int) -> Trained:
    """The mean of a network's weights and those it had earlier, which is right more often than either (Izmailov et al.
    2018), its normalisation measured anew.

    Args:
        net: as it is now.
        checkpoint: as it was.
        share: of ``net`` in the mean.
        pool: what is seen in its samples tells the normalisation.
        batches: so many of them.
    """
    before, now = torch.load(checkpoint, weights_only=True, map_location="cpu")["net"], net.state_dict()
    net.load_state_dict(
        {k: share * v + (1.0 - share) * before[k] if v.is_floating_point() else v for k, v in now.items()}
    )
    for part in net.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.reset_running_stats()
            part.momentum = None  # the mean of all
    net.train()
    torch.manual_seed(SEED)
    with torch.no_grad():
        for _ in range(batches):
            net(pool.sample(BATCH)[0].cpu())
    return net.eval()
