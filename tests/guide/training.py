"""Training of the network in torch: floating point, with normalised batches."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset

from flora_common import files
from flora_common.vision.path.convolutions import CHANNELS, DECODER, DILATIONS, ENCODER
from guide.examples import Example
from guide.samples import sample

WIDTHS: Final = 16, 32, 64, 128
"""Channels of each level."""
BATCH, BATCH_ON_CARD = 16, 32
RATE, WARM_UP, POWER, DECAY, LEAST_RATE = 2e-3, 200, 0.9, 1e-4, 1e-3
"""Of the steps' size: greatest, steps until then, how it falls to the last one, of weights; least, as a share."""
STEM_COUNTS: Final = 4.0
"""Places of a stem count by so much more than others."""
APEX_SHARE: Final = 0.1
SAVED_EVERY: Final = 1000
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
    likely, there = torch.sigmoid(apex), (near > 0.97).float()
    found = there * (1 - likely) ** 2 * functional.logsigmoid(apex)
    missed = (1 - there) * (1 - near) ** 4 * likely**2 * functional.logsigmoid(-apex)
    focal = -(found + missed).sum() / there.sum().clamp(min=1)
    return (by_place * (1 + STEM_COUNTS * wanted[:, 0])).mean() + APEX_SHARE * focal


class Batches(Dataset[tuple[Tensor, Tensor]]):
    """What each step learns from, drawn anew of a seed of its own: who stops and goes on draws as who does not."""

    def __init__(self, kinds: Sequence[Sequence[Example]], shares: Sequence[float], steps: range, size: int) -> None:
        self.kinds, self.shares, self.steps, self.size = kinds, np.array(shares) / np.sum(shares), steps, size

    def __len__(self) -> int:
        return len(self.steps)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        """What is seen, shape (size, 4, side, side), and wanted, shape (size, 2, side / 2, side / 2)."""
        rng = np.random.default_rng([SEED, self.steps[index]])
        drawn = rng.choice(len(self.kinds), size=self.size, p=self.shares)
        batch = [sample(self.kinds[k][rng.integers(len(self.kinds[k]))], rng) for k in drawn]
        seen, wanted = (torch.from_numpy(np.stack(part)) for part in zip(*batch, strict=True))
        return seen, wanted


def train(
    kinds: Sequence[Sequence[Example]],
    shares: Sequence[float],
    steps: int,
    checkpoint: Path,
    jobs: int,
    told: Callable[[int, float], None],
) -> Trained:
    """Train for so many steps, or what is left of them; on a graphics card where torch finds one.

    Args:
        kinds, shares: examples of each kind, and how many of a batch are of it.
        steps: in all.
        checkpoint: what is done is kept here every :data:`SAVED_EVERY` steps, and gone on with.
        jobs: processes that draw, where a graphics card learns.
        told: step and mean loss of the last hundred.
    """
    has_card = torch.cuda.is_available()
    device = torch.device("cuda" if has_card else "cpu")
    torch.manual_seed(SEED)
    net = Trained().to(device, memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=DECAY, fused=True)
    done = 0
    if checkpoint.exists():
        kept = torch.load(checkpoint, weights_only=True, map_location=device)
        net.load_state_dict(kept["net"])
        optimiser.load_state_dict(kept["optimiser"])
        done = int(kept["steps"])
    # beside a card the processors draw, forked to share the examples, some 13 GB; else they have enough to do
    batches = DataLoader(
        Batches(kinds, shares, range(done, steps), BATCH_ON_CARD if has_card else BATCH),
        batch_size=None,
        num_workers=jobs if has_card else 0,
        multiprocessing_context="fork" if has_card else None,
        pin_memory=has_card,
    )
    total = torch.zeros((), device=device)
    for step, (seen, wanted) in enumerate(batches, done):
        size = min(1.0, step / WARM_UP) * (1.0 - step / steps) ** POWER + LEAST_RATE
        for group in optimiser.param_groups:
            group["lr"] = RATE * size
        inputs = seen.to(device, non_blocking=True).contiguous(memory_format=torch.channels_last)
        with torch.autocast(device.type, torch.bfloat16):  # a third less time where a processor has it
            said = net(inputs)
        value = loss(said, wanted.to(device, non_blocking=True))
        optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimiser.step()
        total += value.detach()
        if (step + 1) % 100 == 0:
            told(step + 1, total.item() / 100)
            total.zero_()
        if (step + 1) % SAVED_EVERY == 0 or step + 1 == steps:
            _keep(checkpoint, net, optimiser, step + 1)
    return net.cpu().eval()


def averaged(net: Trained, checkpoint: Path, share: float, batches: Iterable[tuple[Tensor, Tensor]]) -> Trained:
    """The mean of a network's weights and those it had earlier, which is right more often than either (Izmailov et al.
    2018), its normalisation measured anew.

    Args:
        net: as it is now.
        checkpoint: as it was.
        share: of ``net`` in the mean.
        batches: what is seen in them tells the normalisation.
    """
    before, now = torch.load(checkpoint, weights_only=True)["net"], net.state_dict()
    net.load_state_dict(
        {k: share * v + (1.0 - share) * before[k] if v.is_floating_point() else v for k, v in now.items()}
    )
    for part in net.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.reset_running_stats()
            part.momentum = None  # the mean of all
    net.train()
    with torch.no_grad():
        for seen, _ in batches:
            net(seen)
    return net.eval()


def _keep(path: Path, net: Trained, optimiser: torch.optim.Optimizer, steps: int) -> None:
    buffer = io.BytesIO()
    torch.save({"net": net.state_dict(), "optimiser": optimiser.state_dict(), "steps": steps}, buffer)
    files.write_bytes(path, buffer.getvalue())
