"""Plants that evolution steps, as one hash: ``python tests/lab/plants_bits.py`` prints the lanes and the hash.

For tests that compare processors, register widths and lanes with one another.
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from evolve_courses import courses
from evolve_simulators import learned, mechanistic, paper

from flora_lab.simulator.fast_product import LANES


def main() -> int:
    told = hashlib.sha256()
    is_right = np.random.default_rng(1).random((30, 70)) < 0.5
    for simulator in (paper(), paper(stateful=True), learned(), mechanistic()):
        stems_cm = courses(simulator, is_right)
        assert np.ptp(stems_cm[-1], axis=0).max() > 0.01, "lamps make no difference"
        told.update(stems_cm.tobytes())
    print(LANES, told.hexdigest())
    return 0


if __name__ == "__main__":
    sys.exit(main())
