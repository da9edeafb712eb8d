"""A fitness to evolve by without a plant, and what is looked at when two evolutions are to be the same."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_settings import NeatSettings, load_settings


def toy_fitness(genomes: Sequence[Any]) -> list[float]:
    """More for weights near a pattern and for larger networks, so that structures grow and species come and go."""
    return [
        0.05 * len(genome.nodes)
        - sum((gene.weight - (key[0] * 7 % 5 - 2)) ** 2 for key, gene in sorted(genome.connections.items())) / 30
        for genome in genomes
    ]


def genes_of(genome: Any) -> tuple[Any, ...]:
    """All of a genome, in its order, floats to the bit."""
    return (
        genome.key,
        genome.fitness,
        [
            (key, g.bias.hex(), g.response.hex(), g.activation, g.aggregation, g.time_constant.hex())
            for key, g in genome.nodes.items()
        ],
        [(key, g.innovation, g.weight.hex(), g.enabled) for key, g in genome.connections.items()],
    )


def everything_of(engine: NeatEngine) -> tuple[Any, ...]:
    """Genomes, species and the state of the randomness."""
    return (
        [(key, genes_of(genome)) for key, genome in engine.population.items()],
        [
            (sid, s.created, s.last_improved, s.representative.key, sorted(s.members), list(s.fitness_history))
            for sid, s in sorted(engine.species.species.items())
        ],
        engine.randomness.state,
    )


def settings_with(folder: Path, *, population: int = 60, **changes: object) -> NeatSettings:
    """Settings that differ from ``neat.cfg`` in some places; ``section__key=value``, the section without `Default`."""
    sections: dict[str, list[str]] = {}
    for name, value in changes.items():
        section, _, key = name.partition("__")
        sections.setdefault(section if section in ("NEAT", "Restart") else f"Default{section}", []).append(
            f"{key} = {value}"
        )
    path = folder / "changed.cfg"
    path.write_text("\n".join(f"[{name}]\n" + "\n".join(lines) for name, lines in sections.items()), encoding="utf-8")
    return load_settings(path, population=population)
