"""Learned simulators with a mechanistic part beside them in the compiled loop: those of the plain simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from evolve_courses import courses
from evolve_genomes import INPUTS, genome_config, random_genomes
from evolve_reference import controller_of, run_episodes, same
from evolve_simulators import extended, learned, paper
from neat.nn import FeedForwardNetwork
from test_simulator_remembering import mended

from flora_common.errors import BadInput
from flora_lab.evolve import plants_corrected
from flora_lab.evolve.controllers import FromFile
from flora_lab.evolve.evaluate import TYPICAL, evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.individuals import Individuals
from flora_lab.evolve.task import LEFT, MIDDLE
from flora_lab.simulator import corrected
from flora_lab.simulator.corrected import CorrectedSimulator, LearnedSimulator

ROUNDING_CM = 1e-3
"""Of float32 in the paper's network, over eight hours."""


@pytest.mark.parametrize(
    ("make", "off_cm"),
    [
        (learned, 1e-9),
        pytest.param(paper, ROUNDING_CM, marks=pytest.mark.slow),
        pytest.param(mended, ROUNDING_CM, marks=pytest.mark.slow),
    ],
)
def test_a_course_is_that_of_the_simulator(make: Callable[[], LearnedSimulator], off_cm: float) -> None:
    simulator, is_right = CorrectedSimulator(make(), extended()), np.random.default_rng(1).random((100, 9)) < 0.5
    found = courses(simulator, is_right)
    state = simulator.start(np.repeat(LEFT.start_stem_cm[None], is_right.shape[1], axis=0))
    for k, now in enumerate(is_right):
        state, stems = simulator.step(state, np.stack([~now, now], axis=-1).astype(np.float64), 300.0)
        assert np.abs(found[k] - stems).max() < off_cm
    assert np.abs(found - courses(simulator.learned, is_right)).max() > 0.3  # what is added matters
    assert np.ptp(found[-1], axis=0).max() > 0.1  # and so do lamps


@pytest.mark.parametrize("individuals", [TYPICAL, Individuals(2, seed=5)])
def test_episodes_are_those_of_the_plain_reference(individuals: Individuals) -> None:
    short, config, simulator = replace(MIDDLE, hours=8.0), genome_config(), CorrectedSimulator(learned(), extended())
    genomes = random_genomes(6, 5, config, steering=True)
    controllers = [FromFile(controller_of(FeedForwardNetwork.create(one, config), short)) for one in genomes]
    wanted = run_episodes(controllers, simulator, short, individuals.seeds())
    for options in ({}, {"share": False}, {"threads": 2}):
        assert same(evaluate(pack(genomes, INPUTS), simulator, short, individuals, **options).outcomes, wanted)


def test_one_whose_learned_part_knows_no_individuals_has_none() -> None:
    genomes = pack(random_genomes(2, 1, genome_config()), INPUTS)
    with pytest.raises(BadInput, match="kind `corrected` has no individuals; leave --individuals out"):
        evaluate(genomes, CorrectedSimulator(paper(), extended()), MIDDLE, Individuals(2, seed=5))


def test_stems_that_are_not_even_are_told_as_measured_ones_are() -> None:
    """Sums of stems, folded ones among them, below the ground, and of no height: as the plain simulator tells them."""
    rng, folded = np.random.default_rng(4), 0
    for number in range(300):
        stem = np.cumsum(np.column_stack([rng.normal(0.0, 1.0, 10), rng.normal(0.8, 0.2 * (number % 8), 10)]), axis=0)
        stem -= stem[0]
        told = stem.copy()
        plants_corrected._told(told, np.empty((10, 2)))
        folded += bool((np.diff(stem[:, 1]) <= 0.0).any())
        assert told == pytest.approx(corrected._stem(stem), abs=1e-9)
    assert folded > 50
