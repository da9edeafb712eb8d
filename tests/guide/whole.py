"""The trained network in whole numbers (Jacob et al. 2018), without its normalisation."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import nn

from flora_common.vision.path.convolutions import DECODER, ENCODER, EXACT, HEAD, LAYERS, MOST, Layer
from guide.training import Trained

FINEST: Final = 1000.0
"""Greatest weight of a channel, where its sums leave room for it."""
QUANTILE: Final = 0.99995
"""Activations above this are cut."""
LOOKED_AT: Final = 37
"""One activation in so many, and a prime: they lie in rows."""
ROOM: Final = 0.98


def in_whole_numbers(net: Trained, inputs: torch.Tensor, apex: tuple[float, float] = (1.0, 0.0)) -> dict[str, Layer]:
    """The layers of a trained network.

    Args:
        net: trained.
        inputs: shape (n, 4, side, side), which tell how large activations become.
        apex: factor on the logit of the apex, and what is added to it then, so that a likelihood means what it meant
            of the network with which the finder's limits were chosen (Platt 1999).
    """
    steps = _steps(net, inputs)
    beside = {
        names[0]: (levels[-1], before[-1])
        for names, levels, before in zip(DECODER, ENCODER[-2::-1], (ENCODER[-1], *DECODER), strict=False)
    }
    layers, before = {}, ""
    for name in (*LAYERS, HEAD):
        weight, shift = _plain(net, name)
        if name in beside:
            count = _plain(net, beside[name][0])[0].shape[0]
            sizes = [steps[one] for one in beside[name]]
            unit = np.repeat(sizes, [count, weight.shape[1] - count])
        else:
            unit = np.full(weight.shape[1], steps[before] if before else 1.0)
        weight = weight * unit[None, :, None, None]
        flat = np.abs(weight).reshape(len(weight), -1)
        step = np.maximum(flat.max(axis=1) / FINEST, flat.sum(axis=1) * MOST / (ROOM * EXACT)) + 1e-12
        out = 1.0 if name == HEAD else steps[name]
        whole = np.rint(weight / step[:, None, None, None])
        layers[name] = Layer(*(v.astype(np.float32) for v in (whole, step / out, shift / out)))
        before = name
    head, (size, shift) = layers[HEAD], apex
    by_map = np.array([1.0, size], np.float32)
    layers[HEAD] = Layer(head.weight, head.factor * by_map, head.shift * by_map + np.array([0.0, shift], np.float32))
    return layers


def arrays_of(layers: dict[str, Layer]) -> dict[str, np.ndarray]:
    """As they are kept in a file."""
    return {
        f"{name}.{part}": getattr(layer, part).astype(np.int16 if part == "weight" else np.float32)
        for name, layer in layers.items()
        for part in ("weight", "factor", "shift")
    }


def _steps(net: Trained, inputs: torch.Tensor) -> dict[str, float]:
    """What one step of each layer's activations is worth."""
    seen: dict[str, torch.Tensor] = {}

    def look(name: str) -> None:
        def hook(_module: nn.Module, _input: tuple[torch.Tensor, ...], out: torch.Tensor) -> None:
            seen[name] = out.flatten()[::LOOKED_AT]

        hooks.append(net.layers[name].register_forward_hook(hook))

    hooks: list[torch.utils.hooks.RemovableHandle] = []
    for name in LAYERS:
        look(name)
    with torch.no_grad():
        net(inputs)
    for hook in hooks:
        hook.remove()
    return {name: max(1e-6, float(np.quantile(out.numpy(), QUANTILE))) / MOST for name, out in seen.items()}


def _plain(net: Trained, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Weights and shifts of a layer with its normalisation in them, float64."""
    if name == HEAD:
        return net.head.weight.detach().double().numpy(), net.head.bias.detach().double().numpy()
    layer, normal, _ = net.layers[name]
    size = normal.weight / torch.sqrt(normal.running_var + normal.eps)
    weight, shift = layer.weight * size[:, None, None, None], normal.bias - normal.running_mean * size
    return weight.detach().double().numpy(), shift.detach().double().numpy()
