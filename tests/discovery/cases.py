"""Judge ``flora-lab diagnose`` on hidden effects: ``python -m tests.discovery.cases --cases 400 --seed 1 --jobs 2``.

Draws the cases, writes each to a temporary folder, runs the command on it, keeps a line of JSON for each case in the
results file and prints the whole table at the end. Cases that the results file has are not run again, so an
interrupted judging goes on where it was.

A quarter of the cases hide nothing, a tenth something outside the catalogue, an eighth two effects, the others one,
each effect of the catalogue in turn; of all of these, a fifth have other physics. ``--kinds single:0,none:0`` judges
only these kinds and forms, the cases shared evenly. ``--first 60`` stops after so many: they are shuffled, and any
beginning of them is a fair sample.

Half of a diagnosis is learning from the reference runs. With ``--per-world 5`` five cases share these: the first that
is run learns, the others start from what it learned, and each has measured plants, lamps, noise and effects of its own.
A world whose base is gone, because the judging was interrupted, learns again. Cases of one world share its luck, too: a
reference that misleads one may mislead them all. The intervals of the tables take all cases for independent, and are a
little too narrow then; false alarms are counted by world as well.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from flora_common import files
from flora_common.cli import run_cli
from flora_common.errors import BadInput

from .judging import Finder, drawn, judge_world
from .plans import MOST_CASES, MOST_SEED, Plan, by_world, parse_effects, parse_kinds, plans
from .scoring import Outcome
from .tables import all_tables, as_markdown, as_text
from .worlds.writing import write_case


def read_results(path: Path) -> dict[str, Mapping[str, Any]]:
    """Lines of a results file by case; a torn last line is left out.

    Raises:
        BadInput: the file is there and is not a results file.
    """
    found: dict[str, Mapping[str, Any]] = {}
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
        except ValueError as problem:
            if number == len(lines):
                break
            raise BadInput(f"{path} line {number}: not JSON; name a results file, or a new one") from problem
        found[entry["key"]] = entry
    return found


def outcomes(entries: Sequence[Mapping[str, Any]]) -> list[Outcome]:
    """What the tables are made from."""
    return [
        # Results from before worlds were shared do not say it: each case learned.
        Outcome(entry["truth"], entry["diagnosis"], entry["seconds"], entry.get("learned", True), entry.get("named_mm"))
        for entry in entries
    ]


def run_all(wanted: Sequence[Plan], options: argparse.Namespace) -> list[Outcome]:
    """Judge all cases that the results file does not have yet; returns the outcomes of all."""
    done = read_results(options.results)
    left = [plan for plan in wanted if plan.key not in done or done[plan.key]["diagnosis"] is None]
    print(f"{len(wanted)} cases, {len(wanted) - len(left)} of them in {options.results}", flush=True)
    options.results.parent.mkdir(parents=True, exist_ok=True)
    finder = Finder(options.program, options.timeout_s, report=options.keep is not None)
    started = time.monotonic()
    telling, stopped = threading.Lock(), threading.Event()
    judged = 0

    def told(plan: Plan, entry: Mapping[str, Any]) -> None:
        nonlocal judged
        with telling:
            judged += 1
            done[plan.key] = entry
            files.append_line(options.results, json.dumps(entry))
            _say(judged, len(left), plan, entry, time.monotonic() - started)

    with tempfile.TemporaryDirectory(prefix="discovery-") as scratch, ThreadPoolExecutor(options.jobs) as pool:
        cases, bases = options.keep or Path(scratch, "cases"), Path(scratch, "bases")

        def work(world: Sequence[Plan]) -> None:
            for plan, entry in zip(world, judge_world(world, cases, bases, finder), strict=True):
                if stopped.is_set():
                    return
                told(plan, entry)
                if options.keep is None:
                    shutil.rmtree(cases / plan.key, ignore_errors=True)

        try:
            for ready in as_completed([pool.submit(work, world) for world in by_world(left)]):
                ready.result()
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return outcomes([done[plan.key] for plan in wanted])


def _say(number: int, total: int, plan: Plan, entry: Mapping[str, Any], seconds: float) -> None:
    outcome = outcomes([entry])[0]
    answer = entry["error"] or ", ".join(f"{c['effect']} {c['confidence']:.2f}" for c in outcome.claimed)
    hidden = " + ".join(outcome.hidden) or "nothing"
    left_min = seconds / number * (total - number) / 60.0
    print(
        f"{number}/{total} {plan.kind} form {plan.form}: {hidden} -> {answer or outcome.verdict} "
        f"({entry['seconds']:.0f} s; {left_min:.0f} min left)",
        flush=True,
    )


def _only_draw(wanted: Sequence[Plan], folder: Path | None) -> None:
    if folder is None:
        raise BadInput("--dry needs --keep DIR: where the cases are to be written")
    for plan in wanted:
        if (folder / plan.key).exists():
            raise BadInput(f"{folder / plan.key}: is there already; name a new folder")
        write_case(drawn(plan), folder / plan.key)
        print(folder / plan.key, flush=True)


def _wanted(options: argparse.Namespace) -> list[Plan]:
    first = options.cases if options.first is None else options.first
    if min(options.cases, options.jobs, options.runs, options.per_world, first) < 1:
        raise BadInput("--cases, --first, --jobs, --runs and --per-world must be at least 1")
    if options.cases > MOST_CASES:
        raise BadInput(f"--cases is {options.cases}; a judging has seeds for {MOST_CASES}")
    if not 0 <= options.seed <= MOST_SEED:
        raise BadInput(f"--seed is {options.seed}; it must lie in [0, {MOST_SEED}]")
    kinds = parse_kinds(options.kinds)
    effects = parse_effects(options.effects, kinds)
    return plans(options.cases, options.seed, options.runs, kinds, effects, options.per_world)[:first]


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="discovery", description="Judge flora-lab diagnose on hidden effects.")
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--first", type=int, help="only so many of them, a fair sample")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--per-world", type=int, default=1, help="so many cases share their reference runs")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time, one thread each; of different worlds")
    parser.add_argument("--runs", type=int, default=3, help="measured runs of each case")
    parser.add_argument("--kinds", default="", help="only these, such as single:0,none:0")
    parser.add_argument("--effects", default="", help="only these effects, with commas")
    parser.add_argument("--results", type=Path, default=Path("out/discovery/results.jsonl"))
    parser.add_argument("--markdown", type=Path, help="write the tables here, too")
    parser.add_argument("--keep", type=Path, help="folder in which cases and diagnoses are kept")
    parser.add_argument("--dry", action="store_true", help="only draw and write the cases")
    parser.add_argument("--program", type=Path, default=Path(sys.executable).parent / "flora-lab")
    parser.add_argument("--timeout-s", type=float, default=1800.0)
    return parser.parse_args()


def main() -> int:
    options = _parsed()

    def work() -> None:
        wanted = _wanted(options)
        if options.dry:
            _only_draw(wanted, options.keep)
            return
        tables = all_tables(run_all(wanted, options))
        print(f"\n{as_text(tables)}", end="")
        if options.markdown is not None:
            files.write_text(options.markdown, as_markdown(tables))

    return run_cli("discovery", work)


if __name__ == "__main__":
    sys.exit(main())
