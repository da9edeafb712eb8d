"""Stem finders against known truth: the published method, this project's, scikit-image and PlantCV, on the same frames.

    make bench-vision                                   small scale, some three minutes
    make bench-vision BENCH='--full --json out/stems.json'   the real thing, about an hour
    .venv/bin/python tests/bench/bench_vision.py --methods path,paper --times-as-wide 2
    .venv/bin/python tests/bench/bench_vision.py --methods path --pictures out/worst --twins 3 --drawings 3

Photographs are of the virtual grow box and of drawn plants, made anew from seeds. docs/results/stem-finding.md defines
each figure. The other tools run in an environment of their own (.venv-bench; `make bench-vision` makes it) and are left
out where it is missing.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import queue
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS))

from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: E402

from bench.vision.methods import METHODS  # noqa: E402
from bench.vision.report import show, write_json, write_pictures  # noqa: E402
from bench.vision.work import FAMILIES, OTHER_TOOLS, RunResult, Scale, Timing, judge_run, time_methods  # noqa: E402
from truth_run import FULL_PX  # noqa: E402

FIRST_SEED = 90_001
"""Individuals from here on are for judging and nothing else; who tunes a method takes others (--first-seed)."""
OTHER_PYTHON = TESTS.parent / ".venv-bench" / "bin" / "python"

_steps: Any = None


def main() -> int:
    options = parsed()
    console, aside = Console(width=None if sys.stdout.isatty() else 120), Console(stderr=True)
    known = (*METHODS, *OTHER_TOOLS)
    methods = options.methods.split(",") if options.methods else list(known)
    unknown = [name for name in methods if name not in known]
    if unknown:
        aside.print(f"bench_vision: no method {unknown[0]}; there are {', '.join(known)}")
        return 2
    other_python = OTHER_PYTHON if OTHER_PYTHON.exists() else None
    if other_python is None and any(name in OTHER_TOOLS for name in methods):
        aside.print("bench_vision: no .venv-bench, skimage and plantcv are left out; `make bench-vision` makes it")
    full = options.full
    scale = Scale(
        hours=options.hours,
        every_s=options.every_s or (300.0 if full else 900.0),
        every=12,
        stretch=49 if full else 13,
        other_python=other_python if any(name in OTHER_TOOLS for name in methods) else None,
        pictures=options.pictures is not None,
        size_px=(FULL_PX[0] * options.times_as_wide, FULL_PX[1] * options.times_as_wide),
    )
    counts = {"twin": options.twins, "drawings": options.drawings}
    jobs = [
        (family, options.first_seed + i)
        for family in FAMILIES
        for i in range((8 if full else 2) if counts[family] is None else counts[family])
    ]
    results = judged(jobs, methods, scale, options.processes, aside)
    timings: dict[str, dict[str, Timing]] = {}
    if not options.no_time:
        for result in results:
            if result.stretch:
                seed = options.first_seed
                timings[result.family] = time_methods(result.family, seed, result.stretch, methods, scale)
    show(results, timings, console)
    if options.json:
        told = {**asdict(scale), "other_python": None, "seeds": jobs, "judged_frames_per_run": len(scale.judged())}
        write_json(options.json, results, timings, told)
    if options.pictures:
        count = write_pictures(options.pictures, results)
        console.print(f"{count} pictures in {options.pictures}: true stems cyan, found ones red")
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="8 individuals of each family, a frame every 5 minutes")
    parser.add_argument("--methods", default="", help=f"of {','.join((*METHODS, *OTHER_TOOLS))}; all if not given")
    parser.add_argument("--twins", type=int, help="individuals of the virtual grow box (2; 8 with --full)")
    parser.add_argument("--drawings", type=int, help="drawn individuals (2; 8 with --full)")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help=f"of the individuals ({FIRST_SEED})")
    parser.add_argument("--hours", type=float, default=72.0, help="length of each run (72)")
    parser.add_argument("--every-s", type=float, help="between two photographs (900; 300 with --full)")
    parser.add_argument("--times-as-wide", type=int, default=1, help="2 for photographs of the sensor's 3280 px (1)")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="runs at a time")
    parser.add_argument("--no-time", action="store_true", help="do not measure time per frame")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write the worst frames of each method there")
    return parser.parse_args()


def judged(
    jobs: Sequence[tuple[str, int]], methods: Sequence[str], scale: Scale, processes: int, aside: Console
) -> list[RunResult]:
    """All runs through all methods, several at a time."""
    context = multiprocessing.get_context("spawn")
    steps = context.Queue()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with (
        Progress(*columns, console=aside, disable=not aside.is_terminal) as progress,
        ProcessPoolExecutor(processes, mp_context=context, initializer=_keep_queue, initargs=(steps,)) as pool,
    ):
        bar = progress.add_task("frames", total=len(jobs) * scale.steps())
        first = dict(reversed(jobs))  # time is measured on the first of each family
        futures = [pool.submit(_judge, family, seed, methods, scale, first[family] == seed) for family, seed in jobs]
        waiting: set[Future[RunResult]] = set(futures)
        while waiting:
            try:
                steps.get(timeout=0.5)
                progress.advance(bar)
            except queue.Empty:
                pass
            for done in [future for future in waiting if future.done()]:
                waiting.discard(done)
                done.result()  # its failure is ours, at once
                if not aside.is_terminal:
                    aside.print(f"{len(futures) - len(waiting)} of {len(futures)} runs", highlight=False)
        return [future.result() for future in futures]


def _keep_queue(steps: Any) -> None:
    global _steps
    _steps = steps


def _judge(family: str, seed: int, methods: Sequence[str], scale: Scale, keep_stretch: bool) -> RunResult:
    return judge_run(family, seed, methods, scale, lambda: _steps.put(1), keep_stretch=keep_stretch)


if __name__ == "__main__":
    sys.exit(main())
