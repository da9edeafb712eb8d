"""Is a first picture better looked at four times than once? Ends in plants that neither network nor perceptron saw.

    .venv/bin/python tests/bench/bench_looks.py

A quarter of an hour on one core. An end is believed here by how likely it is and what surrounds it alone, as no tracker
does by that alone; *confidently off* is one that is believed and farther off than 1 cm and three standard deviations.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

import cv2
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.vision.path import along_way, guide
from flora_common.vision.path.apex_error import LIMITS_CM, error_cm
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.guide import Way
from flora_common.vision.path.rivals import OFF_CHANCE, OFF_LIMIT
from flora_common.vision.path.second_look import closely
from guide.__main__ import KINDS
from guide.ends import FILES, NOT_LEARNT, in_another_light

SOME: Final = {"modelled": 40, "misleading": 10, "wild": 10, "scape": 8, "budding": 12, "drawing": 50, "twin": 4}
"""Files of each kind."""
OF_A_FILE: Final = 10
FARTHEST_CM: Final = 5.0
CONFIDENT_CM: Final = 1.0

Look = Callable[[Evidence, FloatArray, float], tuple[Way, ...]]
LOOKS: Final[dict[str, Look]] = {"one look": guide.everywhere, "four looks": closely}


@dataclass(frozen=True)
class End:
    """How far off the likeliest end is, whether it is believed, what is stated of it, and how long it took."""

    off_cm: float
    is_believed: bool
    stated_cm: float
    took_s: float


def ends(kind: str, seed: int) -> Iterator[list[End]]:
    """Of each example of a seed, by each of the looks."""
    rng = np.random.default_rng([seed, 11])
    for example, _ in zip(KINDS[kind][0](seed), range(OF_A_FILE), strict=False):
        evidence, px_per_cm = in_another_light(example, rng)
        anchor = example.line[0].astype(np.float64)
        found = []
        for look in LOOKS.values():
            begun = time.perf_counter()
            way = along_way.chosen(look(evidence, anchor, px_per_cm), None, px_per_cm)
            took_s = time.perf_counter() - begun
            off = np.ones(len(LIMITS_CM)) if way.off is None else way.off
            stands_out = along_way.stands_out(way.sure, way.elsewhere, along_way.FIRST_SHARE_OF_TWO)
            off_cm = float(np.hypot(*(way.tip_px - example.line[-1]))) / px_per_cm
            found.append(End(off_cm, bool(stands_out and off[OFF_LIMIT] <= OFF_CHANCE), error_cm(off), took_s))
        yield found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from-file", type=int, default=300, help="number of the first file of each kind (300)")
    parser.add_argument("--share", type=float, default=1.0, help="of the files (1)")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    found: list[list[End]] = []
    for kind, count in SOME.items():
        for number in range(max(1, round(options.share * count))):
            at = FILES[kind] + options.from_file + number
            found += ends(kind, KINDS[kind][1] + NOT_LEARNT + at * KINDS[kind][2])
        print(f"{kind}: {len(found)} pictures so far", file=sys.stderr, flush=True)
    print(f"{len(found)} pictures")
    for name, some in zip(LOOKS, zip(*found, strict=True), strict=True):
        believed = [end for end in some if end.is_believed]
        off_cm = np.array([end.off_cm for end in believed])
        confident = sum(end.off_cm > max(CONFIDENT_CM, 3.0 * end.stated_cm) for end in believed)
        mean_cm = np.mean([min(end.off_cm, FARTHEST_CM) for end in some])
        print(
            f"{name}: {mean_cm:.3f} cm off in the mean, {len(believed)} believed, of these "
            + ", ".join(f"{int((off_cm > limit).sum())} more than {limit} cm off" for limit in LIMITS_CM[:2])
            + f", {confident} confidently off; {1e3 * np.median([end.took_s for end in some]):.0f} ms"
        )


if __name__ == "__main__":
    main()
