"""Make the network: examples, training, whole numbers. Go on where it was stopped by calling it again.

.venv/bin/python tests/guide --out out/guide
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

import cv2
import numpy as np
import torch

from flora_common import files
from guide.examples import Example, drawing_examples, read_examples, twin_examples, write_examples
from guide.misleading import misleading_example
from guide.modelled import modelled_example
from guide.samples import sample
from guide.scapes import Scape
from guide.training import BATCH_ON_CARD, Batches, averaged, train
from guide.whole import arrays_of, in_whole_numbers
from guide.wild import wild_example

TO_SCALE: Final = 128
"""Samples that tell how large activations become."""
TO_NORMALISE: Final = 30
"""Batches that tell the normalisation of a mean of two networks."""
WILD_PER_FILE: Final = 50


def several(made: Callable[[int], Example | None], seed: int) -> list[Example]:
    """Some plants, each of a seed of its own; without those of which the finder sees nothing."""
    found = (made(seed + k) for k in range(WILD_PER_FILE))
    return [example for example in found if example is not None]


KINDS: Final[dict[str, tuple[Callable[[int], list[Example]], int, int, float]]] = {
    "drawing": (drawing_examples, 810_000, 1, 0.22),
    "twin": (twin_examples, 500_000, 1, 0.09),
    "wild": (partial(several, wild_example), 1_000_000, WILD_PER_FILE, 0.29),
    "bare": (partial(several, partial(wild_example, is_bare=True)), 1_500_000, WILD_PER_FILE, 0.03),
    "misleading": (partial(several, misleading_example), 2_500_000, WILD_PER_FILE, 0.12),
    "modelled": (partial(several, modelled_example), 3_000_000, WILD_PER_FILE, 0.32),
    "scape": (partial(several, partial(modelled_example, habit=Scape)), 4_000_000, WILD_PER_FILE, 0.08),
}
"""How each is made, its first seed, how far seeds are apart, and its share of all samples."""


def make(kind: str, seed: int, folder: Path) -> Path:
    """The examples of a seed, in a file; as they are, where they are there."""
    cv2.setNumThreads(1)
    path = folder / f"{kind}-{seed}.npz"
    if not path.exists():
        write_examples(path, KINDS[kind][0](seed))
    return path


def main() -> None:
    """Make what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/guide"))
    parser.add_argument(
        "--drawings", dest="drawing", type=int, default=400, help="drawn individuals, eight pictures each (400)"
    )
    parser.add_argument("--twins", dest="twin", type=int, default=60, help="individuals of the virtual box (60)")
    parser.add_argument("--wild", type=int, default=240, help=f"times {WILD_PER_FILE} wild plants (240)")
    parser.add_argument("--bare", type=int, default=20, help=f"times {WILD_PER_FILE} stems without leaves (20)")
    parser.add_argument(
        "--misleading", type=int, default=130, help=f"times {WILD_PER_FILE} that are easily mistaken (130)"
    )
    parser.add_argument("--modelled", type=int, default=300, help=f"times {WILD_PER_FILE} in three dimensions (300)")
    parser.add_argument(
        "--scapes", dest="scape", type=int, default=160, help=f"times {WILD_PER_FILE} flowering stalks (160)"
    )
    parser.add_argument("--steps", type=int, default=86_000, help="of training (86000)")
    parser.add_argument("--mean-with", type=Path, help="a checkpoint from before the last steps, to take the mean with")
    parser.add_argument("--mean-share", type=float, default=0.85, help="of the last steps' network in the mean (0.85)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    options = parser.parse_args()
    folder = options.out / "examples"
    folder.mkdir(parents=True, exist_ok=True)
    counts = {kind: getattr(options, kind) for kind in KINDS}
    examples: list[list[Example]] = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for kind, count in counts.items():
            _, first, apart, _ = KINDS[kind]
            seeds = range(first, first + count * apart, apart)
            examples.append([])
            for done, path in enumerate(pool.map(make, repeat(kind), seeds, repeat(folder)), 1):
                examples[-1].extend(read_examples(path))
                print(f"\r{kind}: {done} of {count}", end="", flush=True)
            print(f", {len(examples[-1])} pictures")
    cv2.setNumThreads(1)
    torch.set_num_threads(options.jobs)
    shares = [share for *_, share in KINDS.values()]

    def told(step: int, value: float) -> None:
        print(f"\rstep {step} of {options.steps}, loss {value:.4f}", end="", flush=True)

    net = train(examples, shares, options.steps, options.out / "checkpoint.pt", options.jobs, told)
    if options.mean_with is not None:
        some = Batches(examples, shares, range(options.steps, options.steps + TO_NORMALISE), BATCH_ON_CARD)
        net = averaged(net, options.mean_with, options.mean_share, (some[k] for k in range(TO_NORMALISE)))
    rng = np.random.default_rng(5)
    kinds = rng.choice(len(examples), TO_SCALE)
    seen = [sample(examples[k][rng.integers(len(examples[k]))], rng)[0] for k in kinds]
    layers = in_whole_numbers(net, torch.from_numpy(np.stack(seen)))
    with files.atomic_writer(options.out / "guide.npz") as file:
        np.savez_compressed(file, **arrays_of(layers))
    print(f"\nwrote {options.out / 'guide.npz'}")


if __name__ == "__main__":
    main()
