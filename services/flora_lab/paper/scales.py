"""How much of the paper's work is done: all numbers of a scale in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

ScaleName = Literal["smoke", "small", "full"]
OwnRecipe = Literal["sequence", "mechanistic"]

PIXEL_CM: Final = 0.18
"""A pixel of the paper's photographs at 1/8 of their size, where the plant is."""


@dataclass(frozen=True, slots=True)
class Evolving:
    """An evolution's size.

    Attributes:
        runs, generations, population: of NEAT.
        individuals: drawn plants that each controller is tried on; 0 for the typical one, as in the paper.
        neat: name of NEAT's settings; None for those nearest to the paper's.
    """

    runs: int
    generations: int
    population: int
    individuals: int = 0
    neat: str | None = None


@dataclass(frozen=True, slots=True)
class Scale:
    """What is done at a scale.

    Attributes:
        name: of the scale.
        lead: what it is good for, in a sentence.
        open_loop, closed_loop: runs of the dataset experiments.
        run_hours: length of each.
        paper_epochs: of the paper's recipe, at most.
        own_recipe, own_epochs: our recipe; None leaves the epochs to it.
        in_paper, in_own: evolution in the simulator of the paper's recipe, and in that of ours.
        for_reality: evolution in ours, for the controller that meets virtual plants.
        plants: virtual plants that each of the two best controllers meets through the whole rig.
        reality_hours: longest of these experiments.
    """

    name: ScaleName
    lead: str
    open_loop: int
    closed_loop: int
    run_hours: float
    paper_epochs: int
    own_recipe: OwnRecipe
    own_epochs: int | None
    in_paper: Evolving
    in_own: Evolving
    for_reality: Evolving
    plants: int
    reality_hours: float


SMOKE: Final = Scale(
    name="smoke",
    lead="The smallest scale shows that every step works; its numbers say nothing about the paper's.",
    open_loop=2,
    closed_loop=1,
    run_hours=36.0,
    paper_epochs=3,
    own_recipe="mechanistic",
    own_epochs=2,
    in_paper=Evolving(2, 3, 20),
    in_own=Evolving(2, 3, 20),
    for_reality=Evolving(2, 3, 20, individuals=2),
    plants=1,
    reality_hours=3.0,
)
SMALL: Final = Scale(
    name="small",
    lead="Data and simulators are of the paper's size; evolution is too short to have converged everywhere.",
    open_loop=6,
    closed_loop=3,
    run_hours=72.0,
    paper_epochs=200,
    own_recipe="sequence",
    own_epochs=None,
    in_paper=Evolving(6, 150, 150),
    in_own=Evolving(6, 80, 150, neat="sparse"),
    for_reality=Evolving(2, 25, 150, individuals=4, neat="sparse"),
    plants=1,
    reality_hours=72.0,
)
FULL: Final = Scale(
    name="full",
    lead="Everything in the simulator of the paper's recipe is of the paper's size.",
    open_loop=6,
    closed_loop=3,
    run_hours=72.0,
    paper_epochs=200,
    own_recipe="sequence",
    own_epochs=None,
    in_paper=Evolving(20, 1000, 150),
    in_own=Evolving(20, 400, 150, neat="sparse"),
    for_reality=Evolving(4, 60, 150, individuals=12, neat="sparse"),
    plants=3,
    reality_hours=72.0,
)
SCALES: Final[Mapping[str, Scale]] = {scale.name: scale for scale in (SMOKE, SMALL, FULL)}


@dataclass(frozen=True, slots=True)
class Asked:
    """What a person asked for.

    Attributes:
        scale: how much.
        seed: of plants, training and evolution.
        jobs: processes of evolution, and virtual rigs at a time; None for one per core. Changes no result.
    """

    scale: Scale
    seed: int
    jobs: int | None = None
