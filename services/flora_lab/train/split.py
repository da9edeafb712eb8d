"""Which rows of a training set are trained on, which decide when to stop, and which judge the result.

The paper shuffles its vectors and splits them 70/20/10. But most of them are noisy or translated copies of others, and
neighbours in time are nearly alike: hardly a row of its test set has no near twin in its training set. Split by plant,
all rows of a plant are in one part, and the test tells what may be hoped for with a plant that was never seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from flora_common.arrays import IntArray
from flora_common.counted import counted
from flora_common.errors import BadInput

PARTS: Final = ("train", "validate", "test")
SHARES: Final = (0.7, 0.2, 0.1)
"""The paper's."""

SplitName = Literal["rows", "plant"]


@dataclass(frozen=True, slots=True)
class Split:
    """Row numbers of the three parts.

    Attributes:
        train, validate, test: each row in one of them.
        how: in a sentence.
        part_of: plant to its part; ``all`` where its rows are in all of them.
    """

    train: IntArray
    validate: IntArray
    test: IntArray
    how: str
    part_of: Mapping[str, str]

    def parts(self) -> dict[str, IntArray]:
        """Name of each part to its rows."""
        return dict(zip(PARTS, (self.train, self.validate, self.test), strict=True))


def split(plants: npt.NDArray[np.str_], by: SplitName, rng: np.random.Generator, where: str) -> Split:
    """Split rows as ``by`` says.

    Args:
        plants: the plant of each row, shape (n,).
        by: ``rows`` shuffles rows, ``plant`` holds whole plants out.
        rng: decides who comes where.
        where: names the data in messages.

    Raises:
        BadInput: too few rows or plants.
    """
    return _by_rows(plants, rng, where) if by == "rows" else _by_plant(plants, rng, where)


def _by_rows(plants: npt.NDArray[np.str_], rng: np.random.Generator, where: str) -> Split:
    count = len(plants)
    if count < 10:
        raise BadInput(f"{where}: {counted(count, 'vector')}; at least 10 are needed to split them 70/20/10")
    order = rng.permutation(count)
    first = round(SHARES[0] * count)
    second = first + round(SHARES[1] * count)
    part_of = {str(plant): "all" for plant in np.unique(plants)}
    how = "rows shuffled and split 70/20/10 as in the paper; copies of a stem are in all parts"
    return Split(order[:first], order[first:second], order[second:], how, part_of)


def _by_plant(plants: npt.NDArray[np.str_], rng: np.random.Generator, where: str) -> Split:
    names = np.unique(plants)
    count = len(names)
    if count < 3:
        raise BadInput(f"{where}: {counted(count, 'plant')}; a split by plant needs at least 3")
    shuffled = names[rng.permutation(count)]
    test = max(1, round(SHARES[2] * count))
    validate = max(1, round(SHARES[1] * count))
    part_of = {
        str(name): "test" if place < test else "validate" if place < test + validate else "train"
        for place, name in enumerate(shuffled)
    }
    part = np.array([PARTS.index(part_of[str(name)]) for name in names])[np.searchsorted(names, plants)]
    rows = [np.nonzero(part == number)[0] for number in range(len(PARTS))]
    how = f"whole plants held out: {count - validate - test} to train, {validate} to validate, {test} to test"
    return Split(rows[0], rows[1], rows[2], how, part_of)
