"""Training of the network in torch: floating point, with normalised batches."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from flora_common import files
from flora_common.vision.path.convolutions import CHANNELS, DECODER, DILATIONS, ENCODER
from guide.examples import Example
from guide.samples import sample

WIDTHS: Final = 16, 32, 64, 128
"""Channels of each level."""
BATCH: Final = 16
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
        with torch.autocast("cpu", enabled=False):
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


def train(
    kinds: Sequence[Sequence[Example]],
    shares: Sequence[float],
    steps: int,
    checkpoint: Path,
    told: Callable[[int, float], None],
) -> Trained:
    """Train for so many steps, or what is left of them.

    Args:
        kinds, shares: examples of each kind, and how many of a batch are of it.
        steps: in all.
        checkpoint: what is done is kept here every :data:`SAVED_EVERY` steps, and gone on with.
        told: step and mean loss of the last hundred.
    """
    torch.manual_seed(SEED)
    net = Trained().to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=DECAY)
    done = 0
    if checkpoint.exists():
        kept = torch.load(checkpoint, weights_only=True)
        net.load_state_dict(kept["net"])
        optimiser.load_state_dict(kept["optimiser"])
        done = int(kept["steps"])
    total = 0.0
    for step in range(done, steps):
        # each step draws anew, so that those who stop and go on draw as those who do not
        rng = np.random.default_rng([SEED, step])
        drawn = rng.choice(len(kinds), size=BATCH, p=np.array(shares) / np.sum(shares))
        batch = [sample(kinds[k][rng.integers(len(kinds[k]))], rng) for k in drawn]
        seen, wanted = (torch.from_numpy(np.stack(part)) for part in zip(*batch, strict=True))
        size = min(1.0, step / WARM_UP) * (1.0 - step / steps) ** POWER + LEAST_RATE
        for group in optimiser.param_groups:
            group["lr"] = RATE * size
        with torch.autocast("cpu", torch.bfloat16):  # a third less time where a processor has it
            said = net(seen.contiguous(memory_format=torch.channels_last))
        value = loss(said, wanted)
        optimiser.zero_grad()
        value.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 2.0)
        optimiser.step()
        total += value.item()
        if (step + 1) % 100 == 0:
            told(step + 1, total / 100)
            total = 0.0
        if (step + 1) % SAVED_EVERY == 0 or step + 1 == steps:
            _keep(checkpoint, net, optimiser, step + 1)
    return net.eval()


def _keep(path: Path, net: Trained, optimiser: torch.optim.Optimizer, steps: int) -> None:
    buffer = io.BytesIO()
    torch.save({"net": net.state_dict(), "optimiser": optimiser.state_dict(), "steps": steps}, buffer)
    files.write_bytes(path, buffer.getvalue())
