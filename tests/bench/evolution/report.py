"""Figures of evolution's cost, and the tables that tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

POPULATION = 150
GOALS = {"fused": 450.0, "steps_per_s": 20e6, "generation_ms": 25.0, "neat_ms": 10.0, "generations": 800.0}


@dataclass(frozen=True, slots=True)
class Speed:
    """Of one simulator and its evolved population; nanoseconds per step of an episode.

    Attributes:
        nodes, links: of a network, means.
        steps: of an episode, mean.
        plants_share: steps of plants per step of episodes, where plants are shared.
        checked, rounded: episodes that were compared, and those that rounding made others.
    """

    simulator: str
    generations: int
    nodes: float
    links: float
    steps: float
    plants_share: float
    checked: int
    rounded: int
    plain_ns: float
    fused_ns: float
    shared_ns: float
    fused_two_ns: float
    shared_two_ns: float


@dataclass(frozen=True, slots=True)
class GenerationCost:
    """CPU milliseconds per generation, medians over its second half; the plain way's from its time per step."""

    simulator: str
    evaluation_ms: float
    packing_ms: float
    neat_ms: float
    rest_ms: float
    whole_ms: float
    plain_ms: float


@dataclass(frozen=True, slots=True)
class Scaling:
    """What a generation's evaluation costs with more of something."""

    what: str
    number: int
    cpu_ms: float
    wall_ms: float
    episode_steps: int
    plant_steps: int


def show(
    console: Console,
    speeds: Sequence[Speed],
    costs: Sequence[GenerationCost],
    scalings: Sequence[Scaling],
    memory: dict[str, dict[str, float]],
    machine: dict[str, Any],
) -> None:
    console.print(
        tabled(
            f"{POPULATION} genomes, 4 scenarios, evolved on `left`: ns per step of an episode (times the plain way)",
            (
                "simulator",
                "generations",
                "nodes, links",
                "steps",
                "plants",
                "plain",
                "fused",
                "shared",
                "fused, 2 threads",
                "shared, 2",
            ),
            [
                (
                    s.simulator,
                    str(s.generations),
                    f"{s.nodes:.1f}, {s.links:.1f}",
                    f"{s.steps:.0f}",
                    f"{100 * s.plants_share:.1f} %",
                    f"{s.plain_ns:.0f}",
                    *(
                        f"{ns:.0f} ({s.plain_ns / ns:.0f})"
                        for ns in (s.fused_ns, s.shared_ns, s.fused_two_ns, s.shared_two_ns)
                    ),
                )
                for s in speeds
            ],
        )
    )
    for s in speeds:
        console.print(f"{s.simulator}: {s.checked - s.rounded} of {s.checked} episodes the same both ways")
    console.print(
        tabled(
            "A whole generation, CPU ms, one thread",
            ("simulator", "evaluation", "packing", "NEAT", "rest", "whole", "the plain way", "times"),
            [
                (
                    c.simulator,
                    *(f"{ms:.1f}" for ms in (c.evaluation_ms, c.packing_ms, c.neat_ms, c.rest_ms, c.whole_ms)),
                    f"{c.plain_ms:.0f}",
                    f"{c.plain_ms / c.whole_ms:.0f}",
                )
                for c in costs
            ],
        )
    )
    console.print(
        tabled(
            "Evaluation in the paper's simulator, with more of something",
            ("", "", "CPU ms", "ms", "steps of episodes", "of plants", "million steps of episodes per s"),
            [
                (
                    s.what,
                    str(s.number),
                    f"{s.cpu_ms:.1f}",
                    f"{s.wall_ms:.1f}",
                    str(s.episode_steps),
                    str(s.plant_steps),
                    f"{1e-3 * s.episode_steps / s.wall_ms:.1f}",
                )
                for s in scalings
            ],
        )
    )
    for name, of_population in memory.items():
        told = ", ".join(f"{mib:.0f} MiB with {population} genomes" for population, mib in of_population.items())
        console.print(f"{name}: the evaluation's most memory: {told}")
    paper, cost = speeds[0], costs[0]
    for goal, reached, is_met in (
        ("fused, times the plain way", paper.plain_ns / paper.fused_ns, GOALS["fused"]),
        ("shared, million steps per s", 1e3 / paper.shared_ns, 1e-6 * GOALS["steps_per_s"]),
        ("whole generations, times the plain way", cost.plain_ms / cost.whole_ms, GOALS["generations"]),
    ):
        console.print(f"goal: {goal}: {is_met:.0f}; {reached:.0f}: {'met' if reached >= is_met else 'missed'}")
    for goal, reached, most in (
        ("a whole generation, CPU ms", cost.whole_ms, GOALS["generation_ms"]),
        ("NEAT's part of it", cost.neat_ms, GOALS["neat_ms"]),
    ):
        console.print(f"goal: {goal}: {most:.0f}; {reached:.1f}: {'met' if reached <= most else 'missed'}")
    console.print(f"{machine}")


def tabled(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title)
    for name in columns:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    return table
