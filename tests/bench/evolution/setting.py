"""The simulators that the bench of evolution takes, and how much memory an evaluation in them needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from bench.bench_simulators import TRAINING_SEED, grown, told
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.load import load
from flora_lab.simulator.lstm_cell import LstmCell
from flora_lab.simulator.paper import CELLS, PaperNetwork, PaperSimulator

_MEMORY = """
import re, sys
from pathlib import Path
from flora_lab.evolve.evaluate import evaluate
from flora_lab.evolve.genome_arrays import pack
from flora_lab.evolve.neat_engine import NeatEngine
from flora_lab.evolve.neat_settings import load_settings
from flora_lab.evolve.task import LEFT
from flora_lab.simulator.load import load


def told(name):
    return int(re.search(rf"{name}:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])


simulator = load(Path(sys.argv[1]))
genomes = pack(NeatEngine(load_settings(population=int(sys.argv[2])), 7).genomes, 26)
evaluate(pack(NeatEngine(load_settings(population=2), 7).genomes, 26), simulator, LEFT)
Path("/proc/self/clear_refs").write_text("5")
before = told("VmRSS")
evaluate(genomes, simulator, LEFT)
print((told("VmHWM") - before) / 1024)
"""


def simulators(folder: Path) -> dict[str, Simulator[Any]]:
    """Trained ones, unless they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    nine = grown(folder / "nine", TRAINING_SEED)
    found: dict[str, Simulator[Any]] = {}
    for name in ("paper", "mechanistic", "sequence"):
        path = folder / f"{name}.simulator"
        if not path.exists():
            told(["--recipe", name, *map(str, sorted(nine.iterdir())), "-o", str(path)])
        found[name] = load(path)
    return {"paper": found["paper"], "paper, stateful": with_state(found["paper"])} | found


def with_state(simulator: Any) -> PaperSimulator:
    """The same courses, computed with the LSTM's state: weights that no training touched are such that it is forgotten.

    As they are, they throw the plant over within some steps, and there would be nothing to measure.
    """
    cell = simulator.network.cell
    bias = cell.b.copy()
    bias[CELLS : 2 * CELLS] = -40.0
    forgetful = PaperNetwork(LstmCell(cell.w_ih, 0.0 * cell.w_hh, bias), simulator.network.dense)
    return PaperSimulator(forgetful, simulator.box, unit_cm=simulator.unit_cm, step_s=simulator.step_s, stateful=True)


def memory_of(folder: Path, name: str, population: int) -> float:
    """Most memory that evaluating so many genomes takes beyond what the process had before, MiB."""
    arguments = [str(folder / f"{name}.simulator"), str(population)]
    done = subprocess.run([sys.executable, "-c", _MEMORY, *arguments], capture_output=True, text=True, check=True)
    return float(done.stdout)
