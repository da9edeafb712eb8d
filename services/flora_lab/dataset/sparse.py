"""Removal of areas that are too sparsely populated (the paragraph's first sentence)."""

from __future__ import annotations

import numpy as np

from flora_common.arrays import BoolArray
from flora_lab.dataset.recipe import SparseSettings
from flora_lab.dataset.stems import Stems


def in_dense_areas(stems: Stems, settings: SparseSettings) -> BoolArray:
    """Which stems have their tip in an area that enough plants came to.

    The paper removes by hand what lies "in xy-areas that are too sparsely populated", mostly "where only one plant of
    nine may have reached by coincidence". Here an area is a square of a grid, and it is dense if tips of at least
    ``min_runs`` runs, and at least ``min_tips`` tips, lie in it. Where there are fewer runs than ``min_runs``, all of
    them are asked for.

    Args:
        stems: what was measured.
        settings: side of the squares in cm, and the two numbers.

    Returns:
        Shape (n,).
    """
    if not len(stems):
        return np.zeros(0, dtype=np.bool_)
    cells = np.floor(stems.tips_cm / settings.cell_cm).astype(np.int64)
    _, cell, tips = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)  # its shape differs by version of numpy
    visits = np.unique(np.stack([cell, stems.run], axis=1), axis=0)
    runs = np.bincount(visits[:, 0], minlength=len(tips))
    wanted_runs = min(settings.min_runs, len(np.unique(stems.run)))
    dense = (runs >= wanted_runs) & (tips >= settings.min_tips)
    return np.asarray(dense[cell], dtype=np.bool_)
