"""An engine as data: all that its future depends on, in JSON, and the engine from it.

An engine that was saved goes on as one that was not, and one that was read goes on as the one that was saved, to the
last bit: numbers are written so that they are read back exactly, and everything keeps its order, because the order of
genes and genomes decides which random number goes where. Saving draws nothing and counts nothing.
"""

from __future__ import annotations

import importlib.metadata
import math
import random
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
from neat.species import Species

from flora_common import files
from flora_common.errors import BadInput
from flora_lab.evolve.neat_engine import Counter, NeatEngine
from flora_lab.evolve.neat_fast import FAST
from flora_lab.evolve.neat_settings import NeatSettings, NeatTypes
from flora_lab.evolve.sealed import opened, sealed

FORMAT: Final = "flora-neat-1"
_RANDOM_WORDS: Final = 625

Count = Annotated[int, msgspec.Meta(ge=0)]
Word = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


class NodeState(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A node gene."""

    key: Count
    bias: float
    response: float
    activation: str
    aggregation: str
    time_constant: float


class LinkState(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A connection gene."""

    source: int
    target: Count
    innovation: Count
    weight: float
    enabled: bool


class GenomeState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A genome; its genes in the order of its dictionaries."""

    key: Count
    fitness: float | None
    nodes: list[NodeState]
    links: list[LinkState]


class SpeciesState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A species; its members and representative by their keys."""

    key: Count
    created: Count
    last_improved: Count
    representative: Count
    members: list[Count]
    fitness: float | None
    adjusted_fitness: float | None
    fitness_history: list[float]


class RandomState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """As of ``random.getstate()``."""

    version: int
    words: Annotated[list[Word], msgspec.Meta(min_length=_RANDOM_WORDS, max_length=_RANDOM_WORDS)]
    gauss_next: float | None


class EngineState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An engine between two generations.

    Attributes:
        neat_python: version of the library; another one evolves differently.
        settings: :attr:`flora_lab.evolve.neat_settings.NeatSettings.text`.
        seed: that the engine began with.
        generation: number of the population, which waits for its fitness.
        next_genome, next_node, next_species: the numbers that the next ones get.
        innovations: how many innovation numbers are given out.
        random: the state of the engine's randomness.
        population, species: in their order.
        best: the fittest genome so far.
        level, level_since: see :class:`flora_lab.evolve.neat_engine.NeatEngine`; none before the first fitness.
    """

    neat_python: str
    settings: str
    seed: int
    generation: Count
    next_genome: Count
    next_node: Count
    next_species: Count
    innovations: Count
    random: RandomState
    population: list[GenomeState]
    species: list[SpeciesState]
    best: GenomeState | None
    level: float | None = None
    level_since: Count = 0


def state_of(engine: NeatEngine) -> EngineState:
    """What an engine's future depends on. The engine is left as it is."""
    version, words, gauss_next = engine.randomness.state
    return EngineState(
        neat_python=importlib.metadata.version("neat-python"),
        settings=engine.settings.text,
        seed=engine.seed,
        generation=engine.generation_number,
        next_genome=engine.reproduction.genome_indexer.following,
        next_node=engine.config.genome_config.node_indexer.following,
        next_species=engine.species.indexer.following,
        innovations=engine.reproduction.innovation_tracker.global_counter,
        random=RandomState(version, list(words), gauss_next),
        population=[_genome_state(genome) for genome in engine.population.values()],
        species=[
            SpeciesState(
                key=species.key,
                created=species.created,
                last_improved=species.last_improved,
                representative=species.representative.key,
                members=list(species.members),
                fitness=species.fitness,
                adjusted_fitness=species.adjusted_fitness,
                fitness_history=list(species.fitness_history),
            )
            for species in engine.species.species.values()
        ],
        best=None if engine.best is None else _genome_state(engine.best),
        level=engine.level if math.isfinite(engine.level) else None,
        level_since=engine.level_since,
    )


def engine_from(state: EngineState, settings: NeatSettings, types: NeatTypes = FAST) -> NeatEngine:
    """The engine that goes on where the saved one was.

    Args:
        state: of :func:`state_of`, made with any types.
        settings: those of the saved engine.
        types: neat-python's classes, or those that do the same faster.

    Raises:
        BadInput: the state was made with other settings or another neat-python, or its parts do not fit together.
    """
    version = importlib.metadata.version("neat-python")
    if state.neat_python != version:
        raise BadInput(f"was saved with neat-python {state.neat_python[:20]}; {version} would evolve differently")
    if state.settings != settings.text:
        raise BadInput(f"was saved with other settings of NEAT: {_difference(state.settings, settings.text)}")
    engine = NeatEngine(settings, state.seed, types, is_empty=True)
    words = state.random
    engine.randomness.state = (words.version, tuple(words.words), words.gauss_next)
    try:
        random.Random().setstate(engine.randomness.state)
    except ValueError as problem:
        raise BadInput(f"holds a state of randomness that Python does not know ({problem})") from problem
    engine.generation_number = state.generation
    engine.reproduction.genome_indexer = Counter(state.next_genome)
    engine.config.genome_config.node_indexer = Counter(state.next_node)
    engine.species.indexer = Counter(state.next_species)
    engine.reproduction.innovation_tracker.global_counter = state.innovations
    engine.population = {genome.key: _genome(genome, engine.config) for genome in state.population}
    engine.level, engine.level_since = -math.inf if state.level is None else state.level, state.level_since
    if state.best is not None:
        engine.best = _genome(state.best, engine.config)
    try:
        for part in state.species:
            engine.species.species[part.key] = _species(part, engine.population)
            engine.species.genome_to_species.update(dict.fromkeys(part.members, part.key))
    except KeyError as problem:
        raise BadInput(f"names genome {problem} in a species, but holds no such genome") from problem
    return engine


def encode(engine: NeatEngine) -> bytes:
    """An engine's state as a file's content; the same state gives the same bytes."""
    return sealed(state_of(engine), FORMAT)


def decode(data: bytes) -> EngineState:
    """The state in a file's content.

    Raises:
        BadInput: not such a file, or damaged.
    """
    return opened(data, FORMAT, EngineState, "saved evolution")


def save(path: Path, engine: NeatEngine) -> None:
    """Write an engine's state, whole or not at all; what was there is replaced.

    Raises:
        DiskFull: no room; the old file stands.
    """
    files.write_bytes(path, encode(engine))


def load(path: Path, settings: NeatSettings, types: NeatTypes = FAST) -> NeatEngine:
    """The engine that :func:`save` wrote.

    Raises:
        BadInput: the file cannot be read, is damaged, or is of other settings; one line that names it.
    """
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise BadInput(f"{path}: cannot be read ({problem.strerror})") from problem
    try:
        return engine_from(decode(data), settings, types)
    except BadInput as problem:
        raise BadInput(f"{path}: {problem}") from problem


def _genome_state(genome: Any) -> GenomeState:
    return GenomeState(
        genome.key,
        genome.fitness,
        [
            NodeState(key, gene.bias, gene.response, gene.activation, gene.aggregation, gene.time_constant)
            for key, gene in genome.nodes.items()
        ],
        [
            LinkState(source, target, gene.innovation, gene.weight, gene.enabled)
            for (source, target), gene in genome.connections.items()
        ],
    )


def _genome(state: GenomeState, config: Any) -> Any:
    genome = config.genome_type(state.key)
    genome.fitness = state.fitness
    for part in state.nodes:
        node = genome.nodes[part.key] = config.genome_config.node_gene_type(part.key)
        node.bias, node.response, node.time_constant = part.bias, part.response, part.time_constant
        node.activation, node.aggregation = part.activation, part.aggregation
    for link in state.links:
        key = (link.source, link.target)
        gene = genome.connections[key] = config.genome_config.connection_gene_type(key, innovation=link.innovation)
        gene.weight, gene.enabled = link.weight, link.enabled
    return genome


def _species(state: SpeciesState, population: dict[int, Any]) -> Any:
    species = Species(state.key, state.created)
    species.last_improved = state.last_improved
    species.update(population[state.representative], {key: population[key] for key in state.members})
    species.fitness, species.adjusted_fitness = state.fitness, state.adjusted_fitness
    species.fitness_history = list(state.fitness_history)
    return species


def _difference(then: str, now: str) -> str:
    for old, new in zip(then.split("\n"), now.split("\n"), strict=False):
        if old != new:
            return f"`{old[:60]}` then, `{new[:60]}` now"
    return "some are missing"
