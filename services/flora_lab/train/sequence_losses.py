"""Losses of free runs and their gradients: compiled where a processor works, by torch on an accelerator."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
import torch
from torch import Tensor

from flora_common.arrays import Array
from flora_lab.simulator.neural_law import ANGLE_SCALE, GROWTH_CM_PER_H, STEP_H, TRAIT_SHARE
from flora_lab.train import fused_law, sequence_net
from flora_lab.train.sequence_net import TRAITS, LawNet
from flora_lab.train.windows import Windows

_NAMES: Final = ("w_ih", "w_hh", "b", "w_out", "b_out", "log_zone")


class Losses(Protocol):
    """Losses of one network."""

    def learn(self, windows: Windows, traits: Tensor, weight: Array) -> float:
        """Add the gradient of the weighted sum of all losses to the network's.

        Args:
            windows: where from, and what the plants did.
            traits: of the plants, shape (members, windows, 3); of the network.
            weight: shape (members, windows); windows of weight 0 are not run.

        Returns:
            The weighted sum.
        """

    def tell(self, windows: Windows, weight: Array) -> Array:
        """Losses with nothing known of the plants, shape (members, windows); 0 or any number where the weight is 0."""


class TorchLosses:
    """The readable form, differentiated by torch."""

    def __init__(self, net: LawNet) -> None:
        self._net = net

    def learn(self, windows: Windows, traits: Tensor, weight: Array) -> float:
        """See :class:`Losses`."""
        net = self._net
        total = (sequence_net.losses(net, windows, traits) * torch.as_tensor(weight, device=net.b.device)).sum()
        total.backward()  # type: ignore[no-untyped-call]
        return float(total.detach())

    def tell(self, windows: Windows, weight: Array) -> Array:
        """See :class:`Losses`."""
        net = self._net
        with torch.no_grad():
            unknown = torch.zeros(*weight.shape, TRAITS, device=net.b.device, dtype=net.b.dtype)
            return np.asarray(sequence_net.losses(net, windows, unknown).cpu().numpy())


class CompiledLosses:
    """The compiled form."""

    def __init__(self, net: LawNet) -> None:
        self._net = net

    def learn(self, windows: Windows, traits: Tensor, weight: Array) -> float:
        """See :class:`Losses`."""
        net = self._net
        factors = factors_of(traits)
        loss, gradient = fused_law.losses_and_gradient(self._weights(), factors.detach().numpy(), windows, weight)
        for name in _NAMES:
            found = torch.from_numpy(getattr(gradient, name))
            parameter = getattr(net, name)
            parameter.grad = found if parameter.grad is None else parameter.grad + found
        factors.backward(torch.from_numpy(gradient.factors))  # type: ignore[no-untyped-call]
        return float((loss * weight).sum())

    def tell(self, windows: Windows, weight: Array) -> Array:
        """See :class:`Losses`."""
        unknown = torch.zeros(*weight.shape, TRAITS)
        return fused_law.losses(self._weights(), factors_of(unknown).numpy(), windows, weight)

    def _weights(self) -> fused_law.Weights:
        return fused_law.Weights(*(getattr(self._net, name).detach().numpy() for name in _NAMES))


def factors_of(traits: Tensor) -> Tensor:
    """Growth in a step (cm), scale of the angles that are told, scale of the rates of bending; shape (..., 3)."""
    vigour, speed, lean = torch.exp(TRAIT_SHARE * traits).chunk(TRAITS, dim=-1)
    return torch.cat([vigour * (GROWTH_CM_PER_H * STEP_H), ANGLE_SCALE / lean, speed * lean], dim=-1)
