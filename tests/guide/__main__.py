"""Make the network: examples, training, whole numbers. Go on where it was stopped by calling it again.

.venv/bin/python tests/guide --out out/guide
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

import cv2
import numpy as np
import torch

from flora_common import files
from guide.budding import Budding
from guide.examples import Example, drawing_examples, twin_examples
from guide.misleading import misleading_example
from guide.modelled import modelled_example
from guide.packed import PLANES, Packed, packed
from guide.pool import Pool
from guide.scapes import Scape
from guide.training import averaged, train
from guide.whole import arrays_of, in_whole_numbers
from guide.wild import wild_example

TO_SCALE: Final = 128
"""Samples that tell how large activations become."""
TO_NORMALISE: Final = 60
"""Batches that tell the normalisation of a mean of two networks."""
PER_FILE: Final = 50
"""Plants of which each has a seed of its own."""
OF_MEMORY: Final = 0.65
"""Share that examples take at most, of the card's or of the machine's."""


def several(made: Callable[[int], Example | None], seed: int) -> list[Example]:
    """Some plants, each of a seed of its own; without those of which the finder sees nothing."""
    found = (made(seed + k) for k in range(PER_FILE))
    return [example for example in found if example is not None]


KINDS: Final[dict[str, tuple[Callable[[int], list[Example]], int, int, float]]] = {
    "drawing": (drawing_examples, 810_000, 1, 0.15),
    "twin": (twin_examples, 500_000, 1, 0.07),
    "wild": (partial(several, wild_example), 1_000_000, PER_FILE, 0.20),
    "bare": (partial(several, partial(wild_example, is_bare=True)), 1_500_000, PER_FILE, 0.02),
    "misleading": (partial(several, misleading_example), 2_500_000, PER_FILE, 0.12),
    "modelled": (partial(several, modelled_example), 3_000_000, PER_FILE, 0.27),
    "scape": (partial(several, partial(modelled_example, habit=Scape)), 4_000_000, PER_FILE, 0.07),
    "budding": (partial(several, partial(modelled_example, habit=Budding)), 5_000_000, PER_FILE, 0.10),
}
"""How each is made, its first seed, how far seeds are apart, and its share of all samples."""


def make(kind: str, seed: int, folder: Path) -> Path:
    """The examples of a seed, in a file; as they are, where they are there."""
    cv2.setNumThreads(1)
    path = folder / f"{kind}-{seed}.npz"
    if not path.exists():
        packed(KINDS[kind][0](seed)).write(path)
    return path


def room_px(device: torch.device) -> int:
    """Pixels of examples for which there is room where it is learnt."""
    if device.type == "cuda":
        memory_bytes, _ = torch.cuda.mem_get_info(device)
    else:
        memory_bytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return int(OF_MEMORY * memory_bytes / PLANES)


class Arriving:
    """Examples that processes make, of all kinds at once, and that a pool takes in as they come.

    Args:
        made: the files to be, and the kind of each, a place in :data:`KINDS`.
    """

    def __init__(self, made: dict[Future[Path], int]) -> None:
        self._made, self._waiting, self._is_full = made, set(made), False

    def first(self) -> None:
        """Wait until there is a file of each kind."""
        there = set[int]()
        for one in as_completed(self._made):
            there.add(self._made[one])
            if there == set(self._made.values()):
                return

    def all(self, pool: Pool) -> None:
        """Wait for all, and take them in, in the order in which they were asked for: samples are the same again."""
        for one in self._made:
            self._take(pool, one)
            print(f"\rexamples: {len(self._made) - len(self._waiting)} of {len(self._made)} files", end="", flush=True)
        print(f", {sum(pool.counts)} pictures")

    def now(self, pool: Pool) -> None:
        """Take in those that are there."""
        for one in [future for future in self._waiting if future.done()]:
            self._take(pool, one)

    def _take(self, pool: Pool, one: Future[Path]) -> None:
        self._waiting.discard(one)
        if not pool.add(self._made[one], Packed.read(one.result())) and not self._is_full:
            self._is_full = True
            print("\nno room for all examples: some are left out")


def main() -> None:
    """Make what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/guide"))
    parser.add_argument(
        "--drawings", dest="drawing", type=int, default=400, help="drawn individuals, eight pictures each (400)"
    )
    parser.add_argument("--twins", dest="twin", type=int, default=60, help="individuals of the virtual box (60)")
    parser.add_argument("--wild", type=int, default=200, help=f"times {PER_FILE} wild plants (200)")
    parser.add_argument("--bare", type=int, default=20, help=f"times {PER_FILE} stems without leaves (20)")
    parser.add_argument("--misleading", type=int, default=130, help=f"times {PER_FILE} that are easily mistaken (130)")
    parser.add_argument("--modelled", type=int, default=500, help=f"times {PER_FILE} in three dimensions (500)")
    parser.add_argument(
        "--scapes", dest="scape", type=int, default=160, help=f"times {PER_FILE} flowering stalks (160)"
    )
    parser.add_argument("--budding", type=int, default=200, help=f"times {PER_FILE} with apart youngest leaves (200)")
    parser.add_argument("--steps", type=int, default=86_000, help="of training (86000)")
    parser.add_argument("--minutes", type=float, help="of training, in place of a number of steps")
    parser.add_argument("--mean-with", type=Path, help="a checkpoint from before the last steps, to take the mean with")
    parser.add_argument("--mean-share", type=float, default=0.85, help="of the last steps' network in the mean (0.85)")
    parser.add_argument(
        "--apex", type=float, nargs=2, default=(1.0, 0.0), metavar=("FACTOR", "SHIFT"), help="on its logit (1 0)"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    options = parser.parse_args()
    folder = options.out / "examples"
    folder.mkdir(parents=True, exist_ok=True)
    # kinds come evenly, so that those that are there stand for all
    wanted = sorted(
        ((k + 0.5) / getattr(options, kind), of_kind, kind, first + k * apart)
        for of_kind, (kind, (_, first, apart, _)) in enumerate(KINDS.items())
        for k in range(getattr(options, kind))
    )
    shares = [share if getattr(options, kind) else 0.0 for kind, (*_, share) in KINDS.items()]
    with ProcessPoolExecutor(options.jobs) as processes:  # before torch looks for a card, which is not to be forked
        made = {processes.submit(make, kind, seed, folder): of_kind for _, of_kind, kind, seed in wanted}
        arriving = Arriving(made)
        arriving.first()
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        pool = Pool(shares, room_px(device), device)
        if device.type == "cuda":  # which learns while processors draw
            arriving.now(pool)
        else:
            arriving.all(pool)
        cv2.setNumThreads(1)
        torch.set_num_threads(options.jobs)

        def progress(steps: int, elapsed_s: float) -> float:
            return steps / options.steps if options.minutes is None else elapsed_s / (60.0 * options.minutes)

        def told(step: int, value: float) -> None:
            print(f"\rstep {step}, loss {value:.4f}, {sum(pool.counts)} pictures", end="", flush=True)

        net = train(pool, progress, options.out / "checkpoint.pt", told, lambda: arriving.now(pool))
        processes.shutdown(cancel_futures=True)
    if options.mean_with is not None:
        net = averaged(net, options.mean_with, options.mean_share, pool, TO_NORMALISE)
    torch.manual_seed(5)
    layers = in_whole_numbers(net, pool.sample(TO_SCALE)[0].cpu(), tuple(options.apex))
    with files.atomic_writer(options.out / "guide.npz") as file:
        np.savez_compressed(file, **arrays_of(layers))
    print(f"\nwrote {options.out / 'guide.npz'}")


if __name__ == "__main__":
    main()
