"""Skeletons of binary pictures.

Source: Zhang and Suen 1984, "A fast parallel algorithm for thinning digital patterns", Communications of the ACM 27(3).
OpenCV has it in its contributed modules only; here it works on the list of set pixels, so that its cost is that of
the plant and not of the picture.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, ByteArray

# The eight neighbours, clockwise from the upper left, as bits 0 to 7.
_NORTH, _EAST, _SOUTH, _WEST = 1, 3, 5, 7


def neighbour_offsets(width: int) -> npt.NDArray[np.intp]:
    """Distances in a flat array of this row width to the eight neighbours, clockwise from the upper left."""
    return np.array([-width - 1, -width, -width + 1, 1, width + 1, width, width - 1, -1], dtype=np.intp)


def _deletable(first: bool) -> BoolArray:
    table = np.zeros(256, dtype=np.bool_)
    for pattern in range(256):
        bit = [(pattern >> k) & 1 for k in range(8)]
        rises = sum(bit[k] == 0 and bit[(k + 1) % 8] == 1 for k in range(8))
        n, e, s, w = bit[_NORTH], bit[_EAST], bit[_SOUTH], bit[_WEST]
        open_side = (n * e * s == 0 and e * s * w == 0) if first else (n * e * w == 0 and n * s * w == 0)
        table[pattern] = 2 <= sum(bit) <= 6 and rises == 1 and open_side
    return table


def _corner() -> BoolArray:
    """Patterns whose middle only thickens a line: without it the neighbours hang together as they did.

    The connectivity number of Yokoi et al. 1975 for 8 neighbours is 1 there.
    """
    table = np.zeros(256, dtype=np.bool_)
    for pattern in range(256):
        off = [1 - ((pattern >> k) & 1) for k in range(8)]
        number = sum(off[k] - off[k] * off[(k + 1) % 8] * off[(k + 2) % 8] for k in (_NORTH, _EAST, _SOUTH, _WEST))
        table[pattern] = number == 1 and sum(off) <= 6
    return table


_TABLES: Final = (_deletable(True), _deletable(False))
_CORNER: Final = _corner()
_BITS: Final = np.array([1, 2, 4, 8, 16, 32, 64, 128], dtype=np.uint8)


def thin(mask: ByteArray) -> ByteArray:
    """The skeleton of a mask.

    Args:
        mask: shape (height, width), 0 or 1.

    Returns:
        The same shape, 0 or 1: lines one pixel wide in the middle of what was set, connected as it was, without
        corners: each pixel of a line has two neighbours, and one with more is a branching.
    """
    padded = cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    flat = padded.ravel()
    offsets = neighbour_offsets(padded.shape[1])[:, None]
    left = np.flatnonzero(flat)
    while True:
        deleted = 0
        for table in _TABLES:
            gone = table[_BITS @ flat[left[None, :] + offsets]]
            count = int(np.count_nonzero(gone))
            if count:
                flat[left[gone]] = 0
                left = left[~gone]
                deleted += count
        if not deleted:
            break
    row, column = np.divmod(left, padded.shape[1])
    for part in range(4):  # no two pixels of one part are neighbours, so that each part can go at once
        some = left[(row % 2) * 2 + column % 2 == part]
        flat[some[_CORNER[_BITS @ flat[some[None, :] + offsets]]]] = 0
    return np.ascontiguousarray(padded[1:-1, 1:-1], dtype=np.uint8)
