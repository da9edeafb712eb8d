"""What runs tell of sizes in which all is linear: a Gaussian likelihood in its information form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flora_common.arrays import Array


@dataclass(frozen=True, slots=True)
class InformationForm:
    """How much more probable runs are with some sizes than with none: ``pull @ s - s @ information @ s / 2`` nats.

    Attributes:
        information: the information matrix, shape (k, k).
        pull: the information vector, shape (k,).
    """

    information: Array
    pull: Array

    def of(self, part: slice) -> InformationForm:
        """The same where all other sizes are none."""
        return InformationForm(self.information[part, part], self.pull[part])

    def along(self, direction: Array) -> InformationForm:
        """Of one size, of which the others are these multiples, shape (k,)."""
        information, pull = direction @ self.information @ direction, direction @ self.pull
        return InformationForm(np.reshape(information, (1, 1)), np.reshape(pull, 1))

    def nats(self, covariance: Array, mean: Array | None = None) -> float:
        """For sizes of which that was known before, against none.

        Args:
            covariance: shape (k, k); may be singular.
            mean: shape (k,); none where it is left out.
        """
        one = np.eye(len(self.pull))
        at = np.zeros(len(self.pull)) if mean is None else mean
        rest = self.pull - self.information @ at
        whole = one + covariance @ self.information
        gained = 0.5 * rest @ np.linalg.solve(whole, covariance @ rest) - 0.5 * np.linalg.slogdet(whole)[1]
        return float(self.pull @ at - 0.5 * at @ self.information @ at + gained)

    def size(self, sd: float) -> Array:
        """The most probable sizes, each of that standard deviation before, shape (k,)."""
        return np.asarray(np.linalg.solve(self.information + np.eye(len(self.pull)) / sd**2, self.pull))

    def scattered(self, sd: float) -> InformationForm:
        """What is told of the mean of sizes that scatter about it by so much, but for a constant."""
        whole = np.eye(len(self.pull)) + sd**2 * self.information
        return InformationForm(np.linalg.solve(whole, self.information), np.linalg.solve(whole, self.pull))


def together(told: Sequence[InformationForm]) -> InformationForm:
    """What all tell of the same sizes."""
    return InformationForm(
        np.sum([one.information for one in told], axis=0), np.sum([one.pull for one in told], axis=0)
    )
