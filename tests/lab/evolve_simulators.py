"""Simulators for tests of evolution: no real plants, but quick to make, and they answer the lamps."""

from __future__ import annotations

from typing import Final

import numpy as np

from flora_common.runs import LampsSection
from flora_lab.simulator.drives import DriveNoise
from flora_lab.simulator.growing import DataRange
from flora_lab.simulator.individual import Prior
from flora_lab.simulator.lstm_cell import Dense, LstmCell
from flora_lab.simulator.neural_law import TRAITS, NeuralLaw, weight_shapes
from flora_lab.simulator.paper import Box, PaperNetwork, PaperSimulator
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.sequence import SequenceSimulator
from flora_lab.simulator.store import Extension
from flora_lab.simulator.tropism_traits import prior_mean, prior_spread

SHOWN: Final = DataRange(30.0, 10.0)


def mechanistic() -> RodSimulator:
    """The typical plant."""
    return RodSimulator(LampsSection(), Prior(prior_mean(), prior_spread()), DriveNoise(), SHOWN)


def extended() -> RodSimulator:
    """The typical plant with what was found to act on it, all terms of the law among it."""
    found = {
        "circumnutation": {"period_h": 1.9, "amplitude_cm": 0.7},
        "phototropic_latency": {"delay_h": 0.37},
        "adaptation": {"time_constant_h": 1.3, "floor": 0.6},
        "lamp_asymmetry": {"right_to_left": 0.8},
        "lamp_ageing": {"loss": 0.3},
        "diurnal_growth": {"amplitude": 0.4, "peak_h": 5.0},
        "temperature_growth": {"per_degree": 0.05},
        "growth_rate": {"factor": 1.1},
        "gravitropism": {"factor": 0.9},
        "sag": {"amplitude": 0.5},
        "draught": {"drive_per_cm_h": 0.01},
    }
    forms = {"diurnal_growth": 1}
    return mechanistic().extended([Extension(name, values, forms.get(name, 0)) for name, values in found.items()])


def learned() -> SequenceSimulator:
    """Random weights, and a circumnutation that grows with another power of the length than the second."""
    rng = np.random.default_rng(3)
    weights = {name: 0.4 * rng.normal(size=shape) for name, shape in weight_shapes(2, 8).items()}
    prior = Prior(np.full(len(TRAITS), 0.3), np.eye(len(TRAITS)))
    return SequenceSimulator(NeuralLaw(weights, 5.0), prior, DriveNoise(nutation_exponent=1.7), SHOWN)


def paper(*, stateful: bool = False, seed: int = 1, step_s: float = 300.0) -> PaperSimulator:
    """Random weights round a stem that leans to either lamp."""
    rng = np.random.default_rng(seed)
    cell = LstmCell(0.6 * rng.normal(size=(200, 19)), 0.25 * rng.normal(size=(200, 50)), 0.5 * rng.normal(size=200))
    height = np.repeat(np.linspace(0.02, 0.2, 9), 2) * np.tile([0.0, 1.0], 9)
    network = PaperNetwork(cell, Dense.of(0.03 * rng.normal(size=(18, 50)), height))
    box = Box(np.full(18, -0.2, dtype=np.float32), np.full(18, 0.4, dtype=np.float32))
    return PaperSimulator(network, box, unit_cm=65.0, step_s=step_s, stateful=stateful)
