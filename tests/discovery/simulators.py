"""Hide what is wrong in simulators themselves: ``python -m tests.discovery.simulators --worlds 16 --seed 1 --jobs 2``.

Of each drawn world a simulator is learned that remembers (the mechanistic one), and two by the paper's recipe, which
forget: one from all rows, one from every so-manyeth as if that were the next. Their clocks are wrong by drawn factors,
or right; the plants that they are held against are others of the world, healthy or with a drawn effect of the
catalogue. What is told of clock and memory is counted.

A simulator that remembers cannot be told to forget, so nothing is counted there; how often one that forgets is told to
where its plants forget, too, is tried in ``tests/lab/test_diagnose_forgotten.py``.

Worlds that the results file has are not judged again. Six minutes of one core a world.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import multiprocessing
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flora_common import files
from flora_common.cli import run_cli
from flora_common.errors import BadInput
from flora_common.tracks import Track
from flora_lab.diagnose.diagnosis import NamedCause
from flora_lab.diagnose.explain import Explainer
from flora_lab.diagnose.inputs import Runs, read_reference, read_runs
from flora_lab.diagnose.learned_base import learned_base
from flora_lab.diagnose.learned_simulator import MEMORY, TIME_SCALE, faults_of, still_wrong
from flora_lab.diagnose.verdict import left_of, named
from flora_lab.diagnose.work import extensions_of
from flora_lab.rollout.at_time_scale import AtTimeScale
from flora_lab.run_tracks import RunTrack
from flora_lab.simulator.interface import Simulator
from flora_lab.simulator.load import simulator_of
from flora_lab.simulator.store import read_stored, write_simulator
from flora_lab.threads import on_one_core, one_blas_thread
from flora_lab.train import paper
from flora_lab.train.checkpoint import checkpoint_path
from flora_lab.train.progress import shown
from flora_lab.train.recipes import TrainOptions

from .worlds.case import draw_case
from .worlds.effects import CATALOGUE
from .worlds.writing import write_case

OTHER_EVERY = 4
"""One world in so many has other physics."""
SLOWEST, FASTEST = 0.3, 12.0
"""Of the clocks that are drawn, times the right one."""
CLOSEST = 1.3
"""A clock that is wrong is so by at least this."""
THINNED = (3, 13)
"""The next row is one of so many after it."""
CONFIDENCES = (0.9, 0.99, 0.999, math.inf)
"""Ends of the rows that clocks are counted in."""
REMEMBERS, FORGETS = "remembers", "forgets"
HEALTHY, AFFECTED = "healthy", "affected"


@dataclass(frozen=True)
class Judged:
    """One simulator held against three plants.

    Attributes:
        world, form: of the plants.
        simulator: whether it ``remembers`` or ``forgets``.
        plants: ``healthy`` or ``affected``.
        effect: which effect these have; empty where healthy.
        factor: how many times too fast its clock is, by the draw; None where nobody knows.
        told: ``effect``, ``parameters``, ``interval`` and ``confidence`` of each fault that was told.
    """

    world: int
    form: int
    simulator: str
    plants: str
    effect: str
    factor: float | None
    told: list[dict[str, Any]]

    @property
    def words(self) -> str:
        """What was hidden, and in what plants: two columns of a table."""
        if self.simulator == FORGETS:
            how = "as learned" if self.factor is None else f"{THINNED[0]} to {THINNED[1] - 1} times too fast"
        else:
            how = "in time" if self.factor == 1.0 else f"{SLOWEST:g} to {FASTEST:g} times too fast"
        return f"{self.simulator}, {how} | {self.plants}"

    def fault(self, name: str) -> Mapping[str, Any] | None:
        """What was told of it."""
        return next((one for one in self.told if one["effect"] == name), None)


class World:
    """A world's reference, on the disk for as long as it is needed, and what is learned of it."""

    def __init__(self, seed: int, form: int, folder: Path) -> None:
        self.seed, self.form, self.folder = seed, form, folder
        self._number = 0
        first = self._written("none", None)
        self.reference = read_reference(first / "reference", read_runs(sorted((first / "measured").iterdir())))
        self.rod, self.known, _ = learned_base(self.reference, "the reference")

    def plants(self, effect: str | None) -> Runs:
        """Three others each time."""
        case = self._written("none" if effect is None else "single", effect)
        return read_runs(sorted((case / "measured").iterdir()))

    def forgetful(self, every: int) -> Simulator[Any]:
        """By the paper's recipe, of the reference's rows, each with the one that comes so many after it."""
        tracks = [thinned(track, every) for track in self.reference.tracks]
        path = self.folder / f"every{every}.simulator"
        with shown(silent=True, quiet=True, tensorboard=None) as progress:
            made = paper.train(tracks, TrainOptions(self.seed, checkpoint_path(path)), progress)
        write_simulator(
            path,
            kind=made.kind,
            step_s=made.step_s,
            weights=made.weights,
            scales=made.scales,
            provenance=made.provenance,
        )
        return simulator_of(read_stored(path))

    def _written(self, kind: Any, effect: str | None) -> Path:
        path = self.folder / str(self._number)
        write_case(draw_case(self.seed, self.form, kind, effect=effect, number=self._number, held_out=1), path)
        self._number += 1
        return path


def thinned(track: RunTrack, every: int) -> RunTrack:
    """Every so-manyeth row of a track, as if they were taken as often as all were."""
    whole = track.track
    rows = np.arange(0, len(whole.time_s), every)
    return replace(
        track,
        track=Track(
            whole.time_s[0] + (whole.time_s[rows] - whole.time_s[0]) / every,
            tuple(whole.light[row] for row in rows.tolist()),
            whole.points_cm[rows],
            {},
        ),
    )


def judged_in(seed: int, form: int, folder: Path) -> Iterator[Judged]:
    """All that is judged in a world."""
    rng = np.random.default_rng([seed, form, 8])
    world = World(seed, form, folder)

    def one(simulator: Simulator[Any], name: str, runs: Runs, factor: float | None, effect: str = "") -> Judged:
        faults = faults_of(simulator, runs.measured)
        if effect:
            faults = left_beside_effects(faults, world, runs)
        return Judged(seed, form, name, AFFECTED if effect else HEALTHY, effect, factor, [told(f) for f in faults])

    for factor in (1.0, 1.0, clock(rng), clock(rng)):
        yield one(AtTimeScale(world.rod, 1.0 / factor), REMEMBERS, world.plants(None), factor)
    for _ in range(2):
        effect = str(rng.choice(list(CATALOGUE)))
        yield one(world.rod, REMEMBERS, world.plants(effect), 1.0, effect)
    every = int(rng.integers(*THINNED))
    yield one(world.forgetful(1), FORGETS, world.plants(None), None)
    yield one(world.forgetful(every), FORGETS, world.plants(None), float(every))


def clock(rng: np.random.Generator) -> float:
    """How many times too fast one is that is clearly wrong, even in its logarithm on either side."""
    if rng.random() < 0.3:
        return float(np.exp(rng.uniform(math.log(SLOWEST), -math.log(CLOSEST))))
    return float(np.exp(rng.uniform(math.log(CLOSEST), math.log(FASTEST))))


def left_beside_effects(faults: Sequence[NamedCause], world: World, runs: Runs) -> list[NamedCause]:
    """The faults that a diagnosis tells beside the effects that it finds in the plants."""
    with one_blas_thread():
        explanation = Explainer(runs.scenes(world.rod.usual_temperature_c, world.rod.terms), world.known).explain()
    causes = named(explanation, left_of(explanation, world.known))
    extensions = extensions_of(causes)
    return still_wrong(faults, world.rod.extended(extensions), runs.measured) if extensions else list(faults)


def told(fault: NamedCause) -> dict[str, Any]:
    """What of a fault is counted."""
    return {
        "effect": fault.effect,
        "parameters": fault.parameters,
        "interval": {name: list(ends) for name, ends in fault.interval.items()},
        "confidence": fault.confidence,
    }


@on_one_core()
def judge_world(seed: int, form: int) -> list[Judged]:
    """In a process of its own, which leaves Ctrl-C to that which waits for it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with tempfile.TemporaryDirectory(prefix="simulators-") as scratch:
        return list(judged_in(seed, form, Path(scratch)))


def read_results(path: Path) -> list[Judged]:
    """Of whole worlds; a torn last line is left out.

    Raises:
        BadInput: the file is there and is not a results file.
    """
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
    try:
        return [Judged(**one) for line in lines for one in json.loads(line)]
    except (ValueError, TypeError) as problem:
        raise BadInput(f"{path}: is no results file; name another one with --results") from problem


def judge_all(options: argparse.Namespace) -> list[Judged]:
    """Judge the worlds that the results file does not have yet."""
    done = [one for one in read_results(options.results) if options.seed <= one.world < options.seed + options.worlds]
    known = {one.world for one in done}
    options.results.parent.mkdir(parents=True, exist_ok=True)
    left = [seed for seed in range(options.seed, options.seed + options.worlds) if seed not in known]
    pool = ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn"))
    try:
        work = [pool.submit(judge_world, seed, int(seed % OTHER_EVERY == 0)) for seed in left]
        for number, ready in enumerate(as_completed(work), start=1):
            done += ready.result()
            files.append_line(options.results, json.dumps([asdict(one) for one in ready.result()]))
            print(f"{number}/{len(left)} worlds", file=sys.stderr, flush=True)
    except BaseException:
        for process in list(getattr(pool, "_processes", {}).values()):
            process.terminate()  # a world takes minutes
        raise
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return done


def memory_table(judged: Sequence[Judged]) -> str:
    """What was told of clocks and memories, in Markdown."""
    lines = [
        "| simulator | plants | judged | its clock told wrong | a memory told to be missing |",
        "| --- | --- | --- | --- | --- |",
    ]
    by_words: dict[str, list[Judged]] = {}
    for one in judged:
        by_words.setdefault(one.words, []).append(one)
    for words, some in sorted(by_words.items()):
        clocks, memories = (sum(one.fault(name) is not None for one in some) for name in (TIME_SCALE, MEMORY))
        told = memories if some[0].simulator == FORGETS else "-"
        lines.append(f"| {words} | {len(some)} | {clocks} | {told} |")
    return "\n".join(lines)


def clocks_table(judged: Sequence[Judged]) -> str:
    """Whether clocks that are told to be wrong are, and how well their factors are told, in Markdown."""
    lines = [
        "| confidence | clocks told | wrong, and to that side | factor off, median | 90 % | interval holds it |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    told = [
        (one, one.factor, fault)
        for one in judged
        if (fault := one.fault(TIME_SCALE)) is not None and one.factor is not None
    ]
    for low, high in itertools.pairwise(CONFIDENCES):
        some = [(one, true, fault) for one, true, fault in told if low <= fault["confidence"] < high]
        right = [(one, true, f) for one, true, f in some if is_same_side(true, f["parameters"]["factor"])]
        # how fast a thinned one is nobody knows better than by how much it was thinned
        exact = [(true, f) for one, true, f in right if one.simulator == REMEMBERS]
        off = [abs(math.log(f["parameters"]["factor"] / true)) for true, f in exact]
        held = sum(f["interval"]["factor"][0] <= true <= f["interval"]["factor"][1] for true, f in exact)
        words = [f"{100 * math.expm1(float(np.quantile(off, share))):.0f} %" if off else "-" for share in (0.5, 0.9)]
        lines.append(
            f"| {low:g} to {min(high, 1.0):g} | {len(some)} | {len(right)} | {words[0]} | {words[1]} | "
            f"{held} of {len(exact)} |"
        )
    wrong = [one for one in judged if one.simulator == REMEMBERS and one.factor not in (None, 1.0)]
    found = sum(
        fault is not None and is_same_side(one.factor or 1.0, fault["parameters"]["factor"])
        for one in wrong
        for fault in [one.fault(TIME_SCALE)]
    )
    return "\n".join(
        [*lines, "", f"Of {len(wrong)} clocks of simulators that remember and are wrong, {found} were told."]
    )


def is_same_side(true: float, told_factor: float) -> bool:
    """Whether a clock is wrong, and to the side that it is told to be."""
    return math.log(true) * math.log(told_factor) > 0.0


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="simulators", description="Hide what is wrong in simulators themselves.")
    parser.add_argument("--worlds", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="worlds at a time, one core each")
    parser.add_argument("--results", type=Path, default=Path("out/discovery/simulators.jsonl"))
    return parser.parse_args(arguments)


def main() -> int:
    options = parsed()

    def work() -> None:
        if min(options.worlds, options.jobs) < 1:
            raise BadInput("--worlds and --jobs must be at least 1")
        judged = judge_all(options)
        print(f"{memory_table(judged)}\n\n{clocks_table(judged)}")

    return run_cli("simulators", work)


if __name__ == "__main__":
    sys.exit(main())
