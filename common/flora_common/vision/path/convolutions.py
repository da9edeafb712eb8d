"""A small convolutional network in whole numbers, which gives the same bits on every machine.

A U-Net (Ronneberger, Fischer, Brox 2015): pictures are halved four times, and brought back to half of their size beside
what each level had seen. Weights and activations are whole numbers (Jacob et al. 2018), kept as float32: a
sum of their products stays below 2**24, where float32 is exact, so that no order of additions, no register width and no
place in memory changes it, and products of matrices are as fast as the machine's best library makes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Float32Array

MOST: Final = 255.0
"""Of an activation; the least is 0."""
EXACT: Final = 2.0**24
MOST_TAPS: Final = 4_000_000
"""Numbers that are laid out for a product of matrices at a time: 16 MB."""
CHANNELS: Final = 4
"""Of what goes in."""
TIMES_HALVED: Final = 4
MULTIPLE: Final = 2**TIMES_HALVED
"""Sides of what goes in are multiples of this."""
ENCODER: Final = (("e0", "e0b"), ("e1", "e1b"), ("e2", "e2b"), ("e3", "e3b", "e3c", "e3d", "e3e"))
"""Layers of each level; the first halves."""
DILATIONS: Final = {"e3b": 2, "e3c": 4, "e3d": 2}
DECODER: Final = (("d2", "d2b"), ("d1", "d1b"), ("d0", "d0b"))
HEAD: Final = "head"
LAYERS: Final = tuple(name for level in (*ENCODER, *DECODER) for name in level)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A convolution and what makes whole numbers of its sums.

    Attributes:
        weight: shape (out, in, side, side), whole numbers.
        factor, shift: shape (out,): an activation is ``round(factor * sum + shift)``, cut to 0..255.
    """

    weight: Float32Array
    factor: Float32Array
    shift: Float32Array

    def __post_init__(self) -> None:
        """Check what a file may have wrong.

        Raises:
            ValueError: shapes that do not fit, numbers that are none, or weights whose sums are not exact.
        """
        out, side = self.weight.shape[0], self.weight.shape[-1]
        if self.weight.ndim != 4 or self.weight.shape[2] != side or {self.factor.shape, self.shift.shape} != {(out,)}:
            raise ValueError("a layer's arrays do not fit together")
        if not all(np.isfinite(v).all() for v in (self.weight, self.factor, self.shift)):
            raise ValueError("a layer has numbers that are none")
        whole = np.rint(self.weight)
        if (whole != self.weight).any() or np.abs(whole).reshape(out, -1).sum(axis=1).max() * MOST >= EXACT:
            raise ValueError("a layer's weights are no whole numbers whose sums are exact")


class Network:
    """The network: evidence and colours in, two maps out.

    Args:
        layers: of :data:`LAYERS` and :data:`HEAD`.

    Raises:
        ValueError: a layer is missing, or does not fit those before it.
    """

    def __init__(self, layers: Mapping[str, Layer]) -> None:
        missing = [name for name in (*LAYERS, HEAD) if name not in layers]
        if missing:
            raise ValueError(f"layer {missing[0]} is missing")
        self._layers = layers

    def __call__(self, picture: Float32Array) -> Float32Array:
        """The maps of a picture.

        Args:
            picture: shape (channels, height, width), whole numbers in 0..255, sides multiples of :data:`MULTIPLE`.

        Returns:
            Shape (2, height / 2, width / 2), logits: of a stem's middle, of the apex.
        """
        levels, x = [], picture
        for first, *others in ENCODER:
            x = self._activated(first, x, stride=2)
            for name in others:
                x = self._activated(name, x, dilation=DILATIONS.get(name, 1))
            levels.append(x)
        levels.pop()
        for names in DECODER:
            x = np.concatenate([levels.pop(), x.repeat(2, axis=1).repeat(2, axis=2)])
            for name in names:
                x = self._activated(name, x)
        head = self._layers[HEAD]
        sums = convolved(head.weight, x)
        return sums * head.factor[:, None, None] + head.shift[:, None, None]

    def _activated(self, name: str, x: Float32Array, *, stride: int = 1, dilation: int = 1) -> Float32Array:
        layer = self._layers[name]
        x = convolved(layer.weight, x, stride=stride, dilation=dilation)
        x *= layer.factor[:, None, None]
        x += layer.shift[:, None, None]
        return np.rint(np.clip(x, 0.0, MOST, out=x), out=x)


def convolved(weight: Float32Array, x: Float32Array, *, stride: int = 1, dilation: int = 1) -> Float32Array:
    """A convolution with zeros round the picture, exact for whole numbers whose sums stay below :data:`EXACT`.

    Args:
        weight: shape (out, in, side, side).
        x: shape (in, height, width), both multiples of the stride.
        stride, dilation: of the convolution.

    Returns:
        Shape (out, height / stride, width / stride).
    """
    (out, channels, side, _), (_, height, width) = weight.shape, x.shape
    height, width = height // stride, width // stride
    rows = np.ascontiguousarray(weight.transpose(0, 2, 3, 1)).reshape(out, -1)
    if side == 1:
        return (rows @ x.reshape(channels, -1)).reshape(out, height, width)
    around = dilation * (side // 2)
    padded = np.zeros((channels, x.shape[1] + 2 * around, x.shape[2] + 2 * around), np.float32)
    padded[:, around:-around, around:-around] = x  # in a third of the time that np.pad takes
    sums = np.empty((out, height, width), np.float32)
    band = max(1, MOST_TAPS // (side * side * channels * width))
    for top in range(0, height, band):
        count = min(band, height - top)
        taps = np.empty((side, side, channels, count, width), np.float32)
        for row in range(side):
            for column in range(side):
                down, right = top * stride + row * dilation, column * dilation
                lines = slice(down, down + count * stride, stride)
                taps[row, column] = padded[:, lines, right : right + width * stride : stride]
        sums[:, top : top + count] = (rows @ taps.reshape(rows.shape[1], -1)).reshape(out, count, width)
    return sums
