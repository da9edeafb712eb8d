"""Examples where the network learns, in the memory of a graphics card or of the machine, and samples of them.

All pixels lie one after the other, so that examples are of any size; crops, colours and what is wanted are made by the
same device that learns, for two score processors would not draw as fast as a card learns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from flora_common.vision.path.convolutions import CHANNELS, MOST
from flora_common.vision.path.guide import CODE_STEP, EVIDENCE_STEP, INPUT_PX_PER_CM
from guide.canvas import PX_PER_CM
from guide.packed import AWAY_STEPS, LINE_POINTS, PLANES, Packed

SIDE: Final = 160
"""Of a crop, px: 13 cm."""
AT_APEX: Final = 0.6
"""Share of crops about the apex; the others are about any place of the stem."""
ASIDE_PX: Final = 55.0
TURN: Final = float(np.deg2rad(15.0))
LARGER: Final = 0.5
"""Logarithm by which crops are larger or smaller at most."""
STEM_PX, APEX_PX = 1.2, 1.3
"""Standard deviation of what is wanted about the stem's middle and the apex, px of the maps."""
MOST_EXAMPLES: Final = 60_000
"""Of a kind."""
BLUR_REACH: Final = 4
"""Half a side of what a blurred pixel is the mean of."""


class Pool:
    """Examples of several kinds, and samples of them.

    Args:
        shares: of each kind, of all samples.
        room_px: pixels for which there is room.
        device: where they are.
    """

    def __init__(self, shares: Sequence[float], room_px: int, device: torch.device) -> None:
        kinds = len(shares)
        self.used_px = 0
        self.counts = [0] * kinds
        self._pixels = torch.empty((room_px, PLANES), dtype=torch.uint8, device=device)
        self._start = torch.zeros((kinds, MOST_EXAMPLES), dtype=torch.int64, device=device)
        self._size = torch.ones((kinds, MOST_EXAMPLES, 2), device=device)
        self._colour = torch.zeros((kinds, MOST_EXAMPLES, 3), device=device)
        self._line = torch.zeros((kinds, MOST_EXAMPLES, LINE_POINTS, 2), device=device)
        self._count = torch.zeros(kinds, device=device)
        self._until = torch.from_numpy(np.cumsum(shares) / np.sum(shares)).float().to(device)
        rows, columns = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
        self._crop = torch.stack([columns, rows], dim=-1).float().to(device)
        self._map = self._crop[: SIDE // 2, : SIDE // 2].clone()
        self._taps = torch.arange(-BLUR_REACH, BLUR_REACH + 1, device=device).float()
        self._grey = torch.full((3, 3), 1.0 / 3.0, device=device)
        self._same = torch.eye(3, device=device)

    @property
    def device(self) -> torch.device:
        """Where examples are."""
        return self._pixels.device

    def add(self, kind: int, some: Packed) -> bool:
        """Take some in, or, where there is no room for them, none: False."""
        start, at, count = self.used_px, self.counts[kind], len(some.size)
        end = start + len(some.pixels)
        if end > len(self._pixels) or at + count > MOST_EXAMPLES:
            return False
        taken = slice(at, at + count)
        starts = start + np.concatenate([[0], np.cumsum(some.size.prod(axis=1, dtype=np.int64))[:-1]])
        self._pixels[start:end] = torch.from_numpy(some.pixels).to(self.device)
        self._start[kind, taken] = torch.from_numpy(starts).to(self.device)
        for mine, its in (self._size, some.size), (self._colour, some.colour), (self._line, some.line):
            mine[kind, taken] = torch.from_numpy(its).to(self.device)
        self.used_px, self.counts[kind] = end, at + count
        self._count[kind] = at + count
        return True

    def sample(self, size: int) -> tuple[Tensor, Tensor]:
        """Crops of examples, turned, stretched and recoloured, and what is wanted of the network; of torch's own random
        numbers, without waiting for the device.

        Returns:
            What is seen, shape (size, CHANNELS, SIDE, SIDE), 0..255, and wanted, shape (size, 2, SIDE / 2, SIDE / 2).
        """
        device = self.device
        kind = (torch.rand(size, 1, device=device) >= self._until).sum(dim=1).clamp(max=len(self._until) - 1)
        which = (torch.rand(size, device=device) * self._count[kind]).long()
        line = self._line[kind, which]
        point = torch.where(
            torch.rand(size, device=device) < AT_APEX,
            LINE_POINTS - 1,
            (torch.rand(size, device=device) * LINE_POINTS).long(),
        )
        middle = line.gather(1, point[:, None, None].expand(-1, 1, 2))[:, 0]
        middle = middle + torch.randn(size, 2, device=device) * ASIDE_PX
        stretch = torch.exp((2.0 * torch.rand(size, device=device) - 1.0) * LARGER)
        scale = INPUT_PX_PER_CM / PX_PER_CM * stretch
        turn = torch.randn(size, device=device) * TURN
        mirror = torch.where(torch.rand(size, device=device) < 0.5, -1.0, 1.0)
        cos, sin = torch.cos(turn), torch.sin(turn)
        # a place of the example comes to ``(place - middle) @ there + (SIDE - 1) / 2`` in the crop, and back
        there = scale[:, None, None] * torch.stack([cos * mirror, -sin, sin * mirror, cos], dim=1).view(size, 2, 2)
        back = torch.stack([cos * mirror, sin * mirror, -sin, cos], dim=1).view(size, 2, 2) / scale[:, None, None]
        centre = 0.5 * (SIDE - 1)
        at = torch.einsum("hwi,bij->bhwj", self._crop - centre, back) + middle[:, None, None]
        planes, over = self._planes(self._start[kind, which], self._size[kind, which], at)
        colour = self._colour[kind, which][:, None, None]
        evidence = (planes[..., :1] / EVIDENCE_STEP).clamp(max=MOST)
        off = ((planes[..., 1:4] - colour) / CODE_STEP).clamp(-0.5 * MOST, 0.5 * MOST)
        seen = self._recoloured(evidence, off).permute(0, 3, 1, 2).clamp(0.0, MOST)
        apex = torch.einsum("bi,bij->bj", line[:, -1] - middle, there) + centre
        away = planes[..., 4] / AWAY_STEPS + over
        away = 0.5 * scale[:, None, None] * functional.avg_pool2d(away[:, None], 2)[:, 0]
        return seen, self.wanted(away, 0.5 * (apex + 0.5) - 0.5)

    def wanted(self, away: Tensor, apex: Tensor) -> Tensor:
        """The maps of stems.

        Args:
            away: how far each place is from the stem, px of the maps, shape (size, SIDE / 2, SIDE / 2).
            apex: shape (size, 2), px of the maps.

        Returns:
            Shape (size, 2, SIDE / 2, SIDE / 2).
        """
        to_apex = ((self._map - apex[:, None, None]) ** 2).sum(dim=-1)
        return torch.stack([torch.exp(-0.5 * (away / STEM_PX) ** 2), torch.exp(-0.5 * to_apex / APEX_PX**2)], dim=1)

    def _planes(self, start: Tensor, size: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
        """Planes of examples at places, linear between pixels, beyond the margin as on it, shape (n, SIDE, SIDE,
        PLANES), and how far places are beyond it, px."""
        most = size[:, None, None] - 1.0
        inside = torch.minimum(at.clamp(min=0.0), most)
        low = torch.minimum(inside.floor(), (most - 1.0).clamp(min=0.0))
        share = inside - low
        column, row = low.long().unbind(dim=-1)
        width = size[:, 0].long()[:, None, None]
        first = start[:, None, None] + row * width + column
        right, down = (size > 1).long().unbind(dim=-1)
        right, down = right[:, None, None], down[:, None, None] * width
        x, y = share[..., :1], share[..., 1:]
        upper = torch.lerp(self._pixels[first].float(), self._pixels[first + right].float(), x)
        lower = torch.lerp(self._pixels[first + down].float(), self._pixels[first + down + right].float(), x)
        return torch.lerp(upper, lower, y), torch.linalg.vector_norm(at - inside, dim=-1)

    def _recoloured(self, evidence: Tensor, off: Tensor) -> Tensor:
        """Other colours, light, sharpness and noise; shape (size, SIDE, SIDE, CHANNELS).

        Args:
            evidence: shape (size, SIDE, SIDE, 1), steps of the network's input.
            off: shape (size, SIDE, SIDE, 3), colours against the plant's, likewise.
        """
        size, device, unit = len(off), off.device, 32.0 / CODE_STEP
        one = (size, 1, 1, 1)
        mixed = self._same + torch.randn(size, 3, 3, device=device) * 0.12
        mixed = torch.where(torch.rand(size, 1, 1, device=device) < 0.25, self._grey, mixed)
        off = torch.einsum("bhwi,bji->bhwj", off, mixed) * torch.exp(torch.randn(one, device=device) * 0.25)
        off = off + torch.randn(size, 1, 1, 3, device=device) * (0.15 * unit)
        evidence = evidence * torch.exp(torch.randn(one, device=device) * 0.3)
        seen = self._blurred(torch.cat([evidence, off], dim=-1))
        strength = torch.rand(one, device=device) * (torch.rand(one, device=device) < 0.5) * (0.15 * unit)
        grain = torch.randn(size, SIDE, SIDE, 3, device=device) * strength
        holes = torch.rand(size, 8, 8, 1, device=device) < 0.1 * (torch.rand(one, device=device) < 0.1)
        kept = (~holes).float().repeat_interleave(SIDE // 8, dim=1).repeat_interleave(SIDE // 8, dim=2)
        return torch.cat([seen[..., :1] * kept, seen[..., 1:] + grain + 0.5 * MOST], dim=-1)

    def _blurred(self, seen: Tensor) -> Tensor:
        """Three in ten of them less sharp; shape (size, SIDE, SIDE, CHANNELS)."""
        size, device = len(seen), seen.device
        sigma = 0.4 + 0.9 * torch.rand(size, 1, device=device)
        sigma = torch.where(torch.rand(size, 1, device=device) < 0.3, sigma, 0.01)
        weight = torch.exp(-0.5 * (self._taps / sigma) ** 2)
        weight = (weight / weight.sum(dim=1, keepdim=True)).repeat_interleave(CHANNELS, dim=0)
        flat = seen.permute(0, 3, 1, 2).reshape(1, size * CHANNELS, SIDE, SIDE)
        flat = functional.pad(flat, (BLUR_REACH,) * 4, mode="replicate")
        for shape in (-1, 1, 1, len(self._taps)), (-1, 1, len(self._taps), 1):
            flat = functional.conv2d(flat, weight.view(shape), groups=size * CHANNELS)
        return flat.view(size, CHANNELS, SIDE, SIDE).permute(0, 2, 3, 1)
