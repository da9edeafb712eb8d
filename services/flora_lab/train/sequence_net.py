"""The learned law in torch, run free: the readable form, and what an accelerator runs.

The same arithmetic as :mod:`flora_lab.simulator.neural_law`, for all members and windows at once, with two savings that
change nothing that matters: a window keeps its segments (none is split), and what depends on their lengths alone is
computed anew every half hour.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from flora_common.arrays import Array
from flora_lab.simulator.neural_law import (
    ANGLE_SCALE,
    FADE_CM,
    GROWTH_CM_PER_H,
    GROWTH_OFFSET,
    INPUTS,
    LENGTH_MIDDLE_CM,
    LENGTH_SCALE_CM,
    NODES_CM,
    OUTPUTS,
    RATE_PER_CM_H,
    STEP_H,
    TRAIT_SHARE,
)
from flora_lab.simulator.rod import ZONE_EDGE_CM
from flora_lab.train.windows import PLACES, REFRESH, Windows

TRAITS: Final = 3
"""Growth, speed and lean: in training, a plant's early and late growth are one trait."""
ZONE_CM: Final = 6.0
"""Where the growth zone's length starts from."""
_NO_TISSUE_CM: Final = 1e-3


class LawNet(nn.Module):
    """Weights of all members, and the traits of the plants that they are learned from.

    Args:
        members: how many.
        hidden: cells of each.
        plants: how many.
        generator: of the first weights.
    """

    def __init__(self, members: int, hidden: int, plants: int, generator: torch.Generator) -> None:
        super().__init__()
        size = 1.0 / math.sqrt(hidden)

        def drawn(*shape: int, scale: float = size) -> nn.Parameter:
            return nn.Parameter((2.0 * torch.rand(*shape, generator=generator) - 1.0) * scale)

        self.w_ih = drawn(members, INPUTS, 4 * hidden)
        self.w_hh = drawn(members, hidden, 4 * hidden)
        b = torch.zeros(members, 4 * hidden)
        b[:, hidden : 2 * hidden] = 1.0  # remember by default
        self.b = nn.Parameter(b)
        self.w_out = drawn(members, hidden, OUTPUTS, scale=0.3 * size)
        self.b_out = nn.Parameter(torch.zeros(members, OUTPUTS))
        self.log_zone = nn.Parameter(torch.full((members,), math.log(ZONE_CM)))
        self.traits = nn.Parameter(torch.zeros(members, plants, TRAITS))

    @property
    def members(self) -> int:
        return int(self.w_ih.shape[0])

    def centred_traits(self, learned: Tensor) -> Tensor:
        """Traits about their mean over the plants that each member learns from: the typical plant has zeros.

        Args:
            learned: which they are, shape (members, plants), 0 or 1.

        Returns:
            Shape (members, plants, 3).
        """
        share = (learned / learned.sum(1, keepdim=True)).unsqueeze(-1)
        return self.traits - (self.traits * share).sum(1, keepdim=True)

    def law_weights(self) -> dict[str, Array]:
        """For :class:`flora_lab.simulator.neural_law.NeuralLaw`."""
        names = ("w_ih", "w_hh", "b", "w_out", "b_out")
        return {name: getattr(self, name).detach().cpu().numpy().copy() for name in names}


def _hats(distance: Tensor) -> Tensor:
    """Weights of the nodes at distances from the tip: piecewise linear; one more axis, of nodes."""
    nodes = torch.tensor(NODES_CM, dtype=distance.dtype, device=distance.device)
    low = torch.cat([nodes[:1] - 1.0, nodes[:-1]])
    high = torch.cat([nodes[1:], nodes[-1:] + FADE_CM])
    d = distance.unsqueeze(-1)
    rising = torch.clamp((d - low) / (nodes - low), 0.0, 1.0)
    rising[..., 0] = 1.0
    return torch.minimum(rising, torch.clamp((high - d) / (high - nodes), 0.0, 1.0))


@dataclass(slots=True)
class _Weights:
    """What depends on the lengths of the segments."""

    look: Tensor
    bend: Tensor
    share: Tensor


def _weights(length: Tensor, log_zone: Tensor) -> _Weights:
    with torch.no_grad():
        joint = length.flip(-1).cumsum(-1).flip(-1)  # distance of each segment's lower end from the tip
        middle = joint - 0.5 * length
        look = _hats(middle) * length.unsqueeze(-1)
        look /= look.sum(-2, keepdim=True) + _NO_TISSUE_CM
        reach = length.clone()
        reach[..., 1:] = 0.5 * (length[..., 1:] + length[..., :-1])
        bend = _hats(joint) * (reach * (STEP_H * RATE_PER_CM_H)).unsqueeze(-1)
        fixed = length.detach()
    soft = fixed * torch.sigmoid((torch.exp(log_zone)[:, None, None] - middle) / ZONE_EDGE_CM)
    return _Weights(look, bend, soft / soft.sum(-1, keepdim=True))


def free_run(
    net: LawNet, length: Tensor, angle: Tensor, light: Tensor, traits: Tensor, every: int
) -> list[tuple[Tensor, Tensor]]:
    """Let every member run free from given stems.

    Args:
        net: the members.
        length, angle: stems to start from, shape (members, windows, segments); cm and rad from the vertical.
        light: levels, shape (steps, windows, 2).
        traits: of the plants as each member has them, shape (members, windows, 3).
        every: stems are told after every so many steps.

    Returns:
        Lengths and angles, each of shape (members, windows, segments), one pair for each telling.
    """
    members, windows, _ = length.shape
    hidden = net.w_hh.shape[1]
    h = length.new_zeros(members, windows, hidden)
    c = torch.zeros_like(h)
    vigour, speed, lean = torch.exp(TRAIT_SHARE * traits).chunk(TRAITS, dim=-1)
    grows, sees, bends = vigour * (GROWTH_CM_PER_H * STEP_H), ANGLE_SCALE / lean, speed * lean
    b, b_out = net.b.unsqueeze(1), net.b_out.unsqueeze(1)
    told = []
    for k in range(len(light)):
        if k % REFRESH == 0:
            fixed = _weights(length, net.log_zone)
        look = (angle.unsqueeze(-2) @ fixed.look).squeeze(-2) * sees
        size = (length.sum(-1, keepdim=True) - LENGTH_MIDDLE_CM) / LENGTH_SCALE_CM
        seen = torch.cat([look, size, light[k].expand(members, windows, 2)], dim=-1)
        gates = torch.baddbmm(b, seen, net.w_ih) + torch.bmm(h, net.w_hh)
        i, f, g, o = gates.chunk(4, dim=-1)
        c = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
        h = torch.sigmoid(o) * torch.tanh(c)
        said = torch.baddbmm(b_out, h, net.w_out)
        rates = (said[..., :-1] * bends).unsqueeze(-1)
        angle = angle + (fixed.bend @ rates).squeeze(-1).cumsum(-1)
        length = length + fixed.share * (nn.functional.softplus(said[..., -1:] + GROWTH_OFFSET) * grows)
        if (k + 1) % every == 0:
            told.append((length, angle))
    return told


def distances_cm(length: Tensor, angle: Tensor, line_cm: Tensor) -> Tensor:
    """How far simulated stems lie from measured ones, at each segment's end.

    Args:
        length, angle: shape (members, windows, segments).
        line_cm: measured stems at equal arcs, shape (windows, PLACES, 2).

    Returns:
        Squared distances to the place at the same share of the arc, cm^2, shape (members, windows, segments); NaN where
        nothing was measured. The last is the tip's.
    """
    x, y = (length * torch.sin(angle)).cumsum(-1), (length * torch.cos(angle)).cumsum(-1)
    with torch.no_grad():
        at = length.cumsum(-1) / length.sum(-1, keepdim=True) * (PLACES - 1)
        below = at.long().clamp(max=PLACES - 2)
        share = at - below
    line = line_cm.expand(length.shape[0], *line_cm.shape)
    away = torch.zeros_like(x)
    for axis, value in ((0, x), (1, y)):
        places = line[..., axis]
        target = torch.gather(places, 2, below) * (1.0 - share) + torch.gather(places, 2, below + 1) * share
        away = away + (value - target) ** 2
    return away


def losses(net: LawNet, windows: Windows, traits: Tensor) -> Tensor:
    """Mean loss of each window.

    Args:
        net: the members.
        windows: where from, and what the plants did.
        traits: of the plants as each member has them, shape (members, windows, 3).

    Returns:
        Shape (members, windows).
    """
    kind, place = net.b.dtype, net.b.device

    def tensor(array: Array) -> Tensor:
        return torch.as_tensor(np.nan_to_num(array), device=place).to(kind)

    length = tensor(windows.length).expand(net.members, -1, -1)
    angle = tensor(windows.angle).expand(net.members, -1, -1)
    line, line_length, known = tensor(windows.line_cm), tensor(windows.line_length_cm), tensor(windows.known)
    total = torch.zeros(net.members, traits.shape[1], dtype=kind, device=place)
    for k, (lengths, angles) in enumerate(free_run(net, length, angle, tensor(windows.light), traits, windows.every)):
        shape = _robust(distances_cm(lengths, angles, line[:, k]) / float(windows.near_cm[k]) ** 2).mean(-1)
        size = _robust(((lengths.sum(-1) - line_length[:, k]) / float(windows.near_length_cm[k])) ** 2)
        total = total + (shape + windows.length_weight * size) * known[:, k]
    return total / known.sum(1).clamp(min=1)


def _robust(squares: Tensor) -> Tensor:
    """Of squared errors in units of what is near: half the square when small, the error itself when large."""
    return torch.sqrt(1.0 + squares) - 1.0
