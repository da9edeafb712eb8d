"""Fitness of a whole generation: genomes as arrays, a simulator, a task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from flora_common.controller_file import LEFT_AT_MOST
from flora_common.errors import BadInput
from flora_common.runs import LampsSection
from flora_lab.evolve import scenario_batch
from flora_lab.evolve.controllers import INPUTS
from flora_lab.evolve.episode import Outcomes
from flora_lab.evolve.genome_arrays import GenomeArrays
from flora_lab.evolve.shared_kernel import NOT_FINITE, run_shared
from flora_lab.evolve.task import Task
from flora_lab.simulator.growing import GrowingSimulator
from flora_lab.simulator.law import standing
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.tropism import TropismLaw

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Evaluated:
    """A generation's episodes.

    Attributes:
        outcomes: shapes (genomes, scenarios, 1).
        steps_run: of plants, those that several episodes share counted once.
    """

    outcomes: Outcomes
    steps_run: int


def evaluate(genomes: GenomeArrays, simulator: GrowingSimulator, task: Task, *, share: bool = True) -> Evaluated:
    """Every genome in every scenario on the typical plant, as :func:`flora_lab.evolve.episode.run_episodes` does it.

    Args:
        genomes: with the 26 inputs of :data:`flora_lab.evolve.controllers.INPUTS` and one output.
        simulator: either law.
        task: scenarios, start and end.
        share: simulate a plant that several episodes have in common once; the results are the same without it.

    Raises:
        BadInput: a simulator of a law that has no compiled form, or that gives a stem that is not finite.
    """
    law = simulator.law
    count, scenarios = len(genomes), len(task.scenarios)
    start = standing(law, task.start_stem_cm[None])
    rows = count * scenarios + 1
    length, angle, segments = (np.repeat(part, rows, axis=0) for part in (start.length, start.angle, start.count))
    none = np.zeros((rows, 0, 2))
    seen, hidden = none, np.zeros((rows, 0, 2, 0))
    constants, lamps, traits = np.zeros(0), LampsSection(), np.zeros(len(TRAITS))
    weights = {name: np.zeros(shape, np.float32) for name, shape in weight_shapes(0, 0).items()}
    zone_cm = 0.0
    if isinstance(law, NeuralLaw):
        hidden, weights, zone_cm, traits = (
            np.repeat(start.memory, rows, axis=0),
            law.weights,
            law.zone_cm,
            simulator.prior.mean,
        )
    elif isinstance(law, TropismLaw):
        seen, constants, lamps = np.repeat(start.memory, rows, axis=0), np.exp(simulator.prior.mean), law.lamps
    else:
        raise BadInput(f"a simulator of kind `{simulator.kind}` has no compiled law; choose another one")
    arrays = scenario_batch.arrays_of(task)
    shape = (count, scenarios)
    out = Outcomes(
        np.full(shape, np.nan),
        np.full(shape, -1, dtype=np.int8),
        np.zeros(shape, dtype=np.int64),
        np.empty((*shape, 2)),
        np.zeros((*shape, task.most_steps), dtype=np.bool_),
    )
    steps_run = run_shared(
        genomes.node_start,
        genomes.bias,
        genomes.response,
        genomes.activation,
        genomes.aggregation,
        genomes.edge_start,
        genomes.source,
        genomes.weight,
        genomes.output,
        np.array([entry.offset for entry in INPUTS], dtype=np.float64),
        np.array([entry.scale for entry in INPUTS], dtype=np.float64),
        np.empty(genomes.slots),
        arrays.edges,
        arrays.targets,
        task.stop_height_cm,
        LEFT_AT_MOST,
        share,
        isinstance(law, NeuralLaw),
        length,
        angle,
        segments,
        seen,
        hidden,
        traits,
        constants,
        np.array([lamps.distance_cm, lamps.height_cm]),
        weights["w_ih"],
        weights["w_hh"],
        weights["b"],
        weights["w_out"],
        weights["b_out"],
        zone_cm,
        out.fitness,
        out.reason,
        out.steps,
        out.tip_cm,
        out.is_right,
    )
    if (out.reason == NOT_FINITE).any():
        raise BadInput(f"the simulator gives a stem that is not finite, task {task.name}; train it again")
    one_plant = (np.expand_dims(part, 2) for part in (out.fitness, out.reason, out.steps, out.tip_cm, out.is_right))
    return Evaluated(Outcomes(*one_plant), int(steps_run))
