"""Make the perceptron that tells how far off ends are: ways in plants that the network has not learnt from, training.

.venv/bin/python tests/guide/ends.py --out out/ends

An hour on two cores. Go on where it was stopped by calling it again.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional

from flora_common import files
from flora_common.arrays import BoolArray, Float32Array, FloatArray
from flora_common.vision.path import along_way, guide
from flora_common.vision.path.apex_error import LIMITS_CM, WEIGHTS, Perceptron, in_spreads
from flora_common.vision.path.cheapest_ways import IndexArray
from flora_common.vision.path.evidence import Evidence
from guide.__main__ import KINDS
from guide.canvas import PX_PER_CM
from guide.examples import Example

NOT_LEARNT: Final = 200_000
"""So much farther than the network's own are the seeds of these plants."""
FILES: Final = {
    "modelled": 640,
    "misleading": 100,
    "wild": 60,
    "scape": 60,
    "budding": 120,
    "drawing": 960,
    "twin": 40,
}
"""Of each kind, as many plants in each as the network learns from."""
LARGER: Final = 0.35
"""Logarithm by which plants are larger or smaller at most."""
BRIGHTER, PALER, GRAIN = 0.3, 0.25, 3.0
"""Standard deviations of the logarithms of evidence and colours, and of noise in these, code units."""
HIDDEN: Final = 64
EPOCHS, BATCH, RATE, DECAY = 20, 128, 2e-3, 3e-3
SEEN_LEFT_OUT, HIDDEN_LEFT_OUT = 0.5, 0.5
"""Shares of what is left out of a step."""
LEAST_SPREAD: Final = 1e-3
FOLDS: Final = 5
UNSURE_COUNTS: Final = 0.3
"""An end that is believed in no case counts by so much."""
SEED: Final = 3
STEPS_OF_WEIGHTS: Final = 2.0**12


def ways_in(kind: str, seed: int, folder: Path) -> Path:
    """The likeliest ends in the examples of a seed, in a file; as they are, where they are there."""
    cv2.setNumThreads(1)
    path = folder / f"{kind}-{seed}.npz"
    if not path.exists():
        rng = np.random.default_rng([seed, 11])
        found = [end for example in KINDS[kind][0](seed) for end in ends_in(example, rng)]
        views, off, sure, elsewhere = zip(*found, strict=True)
        with files.atomic_writer(path) as file:
            np.savez(file, views=np.array(views, np.float32), off=off, sure=sure, elsewhere=elsewhere)
    return path


def ends_in(example: Example, rng: np.random.Generator) -> Iterator[tuple[FloatArray, float, float, float]]:
    """What is seen from the likeliest end in a plant of another size, in another light; how far off it is, cm; how
    likely it is, and an apex elsewhere."""
    evidence, px_per_cm = in_another_light(example, rng)
    anchor = example.line[0].astype(np.float64)
    maps = guide.Maps(evidence, px_per_cm, anchor, guide.SEEN_CM)
    way = along_way.chosen(guide.ways(maps, anchor, px_per_cm), None, px_per_cm)
    if along_way.is_usable(way):
        off = float(np.hypot(*(way.tip_px - example.line[-1]))) / px_per_cm
        seen = maps.views(way.line_px, way.along, way.sure, way.elsewhere)
        yield seen, off, way.sure, way.elsewhere


def in_another_light(example: Example, rng: np.random.Generator) -> tuple[Evidence, float]:
    """A plant of another size in another light, and px per cm."""
    px_per_cm = PX_PER_CM * float(np.exp(rng.uniform(-LARGER, LARGER)))
    plant = example.plant * np.float32(np.exp(rng.normal(0.0, BRIGHTER)))
    colour = example.code.reshape(-1, 3).mean(axis=0)
    code = (example.code - colour) * np.exp(rng.normal(0.0, PALER)) + colour
    code += rng.normal(0.0, GRAIN * rng.uniform(), code.shape)
    shown = np.clip(code, 0.0, 255.0).astype(np.uint8)
    return Evidence((0, 0), np.asarray(plant, np.float32), shown, 1.0), px_per_cm


@dataclass(frozen=True, slots=True, eq=False)
class Ends:
    """Ends of ways.

    Attributes:
        views: shape (n, 2, seen), see :func:`flora_common.vision.path.apex_error.views_of`.
        off_cm: shape (n,), how far off each is.
        sure, elsewhere: shape (n,), how likely an apex is there, and anywhere else.
        kind: shape (n,), a place in :data:`KINDS`.
        fold: shape (n,), the same for all of a file.
    """

    views: Float32Array
    off_cm: FloatArray
    sure: FloatArray
    elsewhere: FloatArray
    kind: IndexArray
    fold: IndexArray

    @classmethod
    def read(cls, paths: Sequence[Path]) -> Ends:
        """Those in some files."""
        parts: dict[str, list[np.ndarray]] = {name: [] for name in ("views", "off", "sure", "elsewhere")}
        kind, fold = [], []
        for number, path in enumerate(paths):
            with np.load(path, allow_pickle=False) as arrays:
                for name, some in parts.items():
                    some.append(arrays[name])
            count = len(parts["off"][-1])
            kind.append(np.full(count, list(KINDS).index(path.name.split("-")[0])))
            fold.append(np.full(count, number % FOLDS))
        return cls(*(np.concatenate(some) for some in (*parts.values(), kind, fold)))

    @property
    def believed(self) -> BoolArray:
        """Which of them would be believed by how likely they are."""
        return np.asarray(along_way.stands_out(self.sure, self.elsewhere, along_way.FIRST_SHARE_OF_TWO))

    @property
    def weight(self) -> FloatArray:
        """By how much each counts."""
        return np.where(self.believed, 1.0, UNSURE_COUNTS)


def trained(ends: Ends, some: BoolArray) -> Perceptron:
    """A perceptron that has seen some of the ends from either side."""
    torch.manual_seed(SEED)
    views = ends.views[some]
    middle, spread = (v.astype(np.float64) for v in (views.mean(axis=(0, 1)), views.std(axis=(0, 1)) + LEAST_SPREAD))
    seen = torch.from_numpy(in_spreads(views, middle, spread).astype(np.float32)).flatten(0, 1)
    off = (ends.off_cm[some, None] > np.array(LIMITS_CM)).astype(np.float32)
    wanted = torch.from_numpy(off).repeat_interleave(2, dim=0)
    counts = torch.from_numpy(ends.weight[some].astype(np.float32)).repeat_interleave(2)
    net = nn.Sequential(
        nn.Dropout(SEEN_LEFT_OUT),
        nn.Linear(seen.shape[1], HIDDEN),
        nn.ReLU(),
        nn.Dropout(HIDDEN_LEFT_OUT),
        nn.Linear(HIDDEN, len(LIMITS_CM)),
    )
    optimiser = torch.optim.AdamW(net.parameters(), lr=RATE, weight_decay=DECAY)
    for epoch in range(EPOCHS):
        for k, batch in enumerate(torch.randperm(len(seen)).split(BATCH)):
            done = (epoch + k * BATCH / len(seen)) / EPOCHS
            for group in optimiser.param_groups:
                group["lr"] = RATE * 0.5 * (1.0 + math.cos(math.pi * done))
            said = net(seen[batch])
            by_end = functional.binary_cross_entropy_with_logits(said, wanted[batch], reduction="none").mean(dim=1)
            optimiser.zero_grad()
            (by_end * counts[batch]).mean().backward()
            optimiser.step()
    layers = [layer for layer in net if isinstance(layer, nn.Linear)]
    both = (torch.cat([layer.weight.T, layer.bias[None]]).detach().double().numpy() for layer in layers)
    return Perceptron(middle, spread, *(np.rint(v * STEPS_OF_WEIGHTS) / STEPS_OF_WEIGHTS for v in both))


def told_apart(ends: Ends) -> FloatArray:
    """The chances of each end, shape (n, limits), by a perceptron that has seen nothing of its file."""
    chance = np.zeros((len(ends.off_cm), len(LIMITS_CM)))
    for fold in range(FOLDS):
        net = trained(ends, ends.fold != fold)
        for k in np.flatnonzero(ends.fold == fold):
            chance[k] = net.chances(ends.views[k].astype(np.float64))
        print(f"\rcross-validation: {fold + 1} of {FOLDS} folds", end="", flush=True)
    print()
    return chance


def report(ends: Ends, chance: FloatArray) -> None:
    """Print how well ends that are off are told from others, among those that are believed by how likely they are:
    the share of them that is doubted when so many in a hundred of the others are."""
    print(f"{'kind':30}{'ends':>7}{'beyond':>10}{'are':>7}" + "".join(f"{f'of {n}':>7}" for n in (20, 10, 5, 2)))
    unlikely = np.repeat(-ends.sure[:, None], len(LIMITS_CM), axis=1)
    rival = np.repeat((ends.elsewhere / ends.sure)[:, None], len(LIMITS_CM), axis=1)
    rows = [(name, ends.kind == kind, chance) for kind, name in enumerate(KINDS)]
    every = np.ones(len(ends.sure), np.bool_)
    rows += [("all", every, chance), ("by how likely", every, unlikely), ("by how likely another", every, rival)]
    for name, some, by_limit in rows:
        mine = ends.believed & some
        for limit, by in zip(LIMITS_CM, by_limit.T, strict=True):
            off = ends.off_cm[mine] > limit
            if off.any():
                least = [np.quantile(by[mine][~off], 1.0 - share) for share in (0.2, 0.1, 0.05, 0.02)]
                found = "".join(f"{np.mean(by[mine][off] > one):7.2f}" for one in least)
                print(f"{name:30}{np.count_nonzero(mine):7}{limit:7.1f} cm{np.count_nonzero(off):7}{found}")
    for limit, by in zip(LIMITS_CM, chance.T, strict=True):
        said, off = by[ends.believed], ends.off_cm[ends.believed] > limit
        edges = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
        bins = [(said >= low) & (said < high) for low, high in pairwise(edges)]
        words = (f"{said[b].mean():.3f}:{off[b].mean():.3f} ({np.count_nonzero(b)})" for b in bins if b.any())
        print(f"beyond {limit:.1f} cm, said and so: " + "  ".join(words))


def report_and_write(ends: Ends, out: Path) -> None:
    """Cross-validate, then learn from all and write it."""
    report(ends, told_apart(ends))
    net = trained(ends, np.ones(len(ends.off_cm), np.bool_))
    with files.atomic_writer(out / WEIGHTS) as file:
        arrays = {one.name: getattr(net, one.name) for one in fields(net)}
        np.savez_compressed(file, **{name: v.astype(np.float32) for name, v in arrays.items()})
    print(f"wrote {out / WEIGHTS}")


def main() -> None:
    """Make what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/ends"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    for kind, count in FILES.items():
        parser.add_argument(f"--{kind}", type=int, default=count, help=f"files of plants ({count})")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    # kinds come evenly, so that each fold has as much of all
    wanted = sorted(
        ((k + 0.5) / getattr(options, kind), kind, KINDS[kind][1] + NOT_LEARNT + k * KINDS[kind][2])
        for kind in FILES
        for k in range(getattr(options, kind))
    )
    with ProcessPoolExecutor(options.jobs) as processes:
        made = [processes.submit(ways_in, kind, seed, options.out) for _, kind, seed in wanted]
        for done, one in enumerate(as_completed(made), 1):
            one.result()
            print(f"\rends: {done} of {len(made)} files", end="", flush=True)
    torch.set_num_threads(options.jobs)
    report_and_write(Ends.read([one.result() for one in made]), options.out)


if __name__ == "__main__":
    main()
