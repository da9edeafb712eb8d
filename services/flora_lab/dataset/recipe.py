"""The steps from tracks to training set, their names, and every number that they take.

Source of all of it: Wahby et al. 2018, section "LSTM trained as Stem stiffening and motion model", paragraph
"Preparation of stem data for regression". Equations are numbered by their order in the text: (1) is that of L and H.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal

import msgspec

from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean

PAPER_VECTORS: Final = 101_162
"""What the paper ends up with. It gives no count for the steps before."""

TRACKS: Final = "tracks"
SPARSE: Final = "sparse-areas"
NOISE: Final = "noise-eq8-16"
GENERIC: Final = "generic-eq17"
MIRROR: Final = "mirror"
PAIRS: Final = "pairs"
DUPLICATES: Final = "duplicates"
JUMPS: Final = "jumps"


@dataclass(frozen=True, slots=True)
class Step:
    """A step: its name, where the paper has it, and what it does in one clause."""

    name: str
    source: str
    does: str


STEPS: Final = (
    Step(SPARSE, "first sentence", "removes stems whose tip is where too few tips are"),
    Step(NOISE, "eqs. 8 to 16", "adds sequences of noisy copies"),
    Step(GENERIC, "eq. 17", "adds 64 translations of the smoothest movements"),
    Step(MIRROR, "after eq. 17", "adds everything with left and right exchanged"),
    Step(PAIRS, "after eq. 17", "puts each stem and its light beside the next stem; cannot be left out"),
    Step(DUPLICATES, "after eq. 17, rule 1", "removes pairs of two equal stems"),
    Step(JUMPS, "after eq. 17, rule 2", "removes pairs that change by more than 20 times the mean"),
)
STEP_NAMES: Final = tuple(step.name for step in STEPS)

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Length = Annotated[float, msgspec.Meta(ge=0.001, le=1e6)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]

NoiseMean = Literal["offset", "zero", "printed"]
"""How the mean of eq. 12 is read; see :mod:`flora_lab.dataset.noise`."""


class SparseSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[recipe.sparse]``: the rule in the place of the paper's removal by hand."""

    cell_cm: Length = 2.0
    min_runs: Count = 2
    min_tips: Count = 10


class NoiseSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[recipe.noise]``: theta_3, omega, and how often."""

    sequences: Annotated[int, msgspec.Meta(ge=1, le=100)] = 3
    theta_3: Count = 100
    omega: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.1
    mean: NoiseMean = "offset"


class GenericSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[recipe.generic]``: lambda, and the rule in the place of the paper's selection by hand."""

    exponents: Annotated[tuple[Annotated[int, msgspec.Meta(ge=-12, le=0)], ...], msgspec.Meta(min_length=1)] = (
        -3,
        -4,
        -5,
        -6,
    )
    share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.04
    window_h: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 2.0


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that decides what comes out of given tracks.

    Attributes:
        without: names of the steps that are left out.
        seed: of all noise.
        unit_cm: the paper's normalised unit in cm; inputs and outputs are in it.
        interval_s: time from one stem to the next.
        skip_other_lights: leave out what happened in the dark or under both lamps, instead of refusing the track.
        duplicate_cm: stems count as equal if no coordinate differs by more.
        jump_times: how many times the mean change is a jump.
    """

    without: tuple[str, ...] = ()
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)] = 1
    unit_cm: Length = 65.0
    interval_s: Positive = 300.0
    skip_other_lights: bool = False
    duplicate_cm: NotNegative = 0.0
    jump_times: Positive = 20.0
    sparse: SparseSettings = SparseSettings()
    noise: NoiseSettings = NoiseSettings()
    generic: GenericSettings = GenericSettings()

    def does(self, step: str) -> bool:
        """Whether a step is done."""
        return step not in self.without


def steps_named(texts: Sequence[str]) -> tuple[str, ...]:
    """The steps meant by these names, in the order in which they are done; the beginning of a name will do.

    Raises:
        BadInput: a name that is no step's, or that of :data:`PAIRS`.
    """
    found: set[str] = set()
    for text in texts:
        fitting = [name for name in STEP_NAMES if name == text or (text and name.startswith(text))]
        if not fitting:
            raise BadInput(f"--without: no step `{text[:40]}`{did_you_mean(text, STEP_NAMES)}")
        if fitting[0] == PAIRS:
            raise BadInput(f"--without {PAIRS}: a training set is made of pairs")
        found.add(fitting[0])
    return tuple(name for name in STEP_NAMES if name in found)
