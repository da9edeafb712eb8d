"""Judge ``flora-lab diagnose`` on hidden effects: ``python -m tests.discovery.cases --cases 400 --seed 1 --jobs 2``.

Draws the cases, writes each to a temporary folder, runs the command on it, keeps a line of JSON for each case in the
results file and prints the whole table at the end. Cases that the results file has are not run again, so an
interrupted judging goes on where it was.

A quarter of the cases hide nothing, a tenth something outside the catalogue, an eighth two effects, the others one,
each effect of the catalogue in turn; of all of these, a fifth have other physics. ``--kinds single:0,none:0`` judges
only these kinds and forms, the cases shared evenly. ``--first 60`` stops after so many: they are shuffled, and any
beginning of them is a fair sample.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flora_common import files
from flora_common.cli import run_cli
from flora_common.errors import BadInput
from flora_common.suggest import did_you_mean

from .scoring import Outcome
from .tables import all_tables, as_markdown, as_text
from .worlds.case import ALL_EFFECTS, KINDS, draw_case
from .worlds.effects import CATALOGUE
from .worlds.outside import OUTSIDE
from .worlds.writing import truth, write_case

SEEDS_PER_KIND = 100_000
SEEDS_PER_JUDGING = SEEDS_PER_KIND * len(KINDS)
OTHER_PHYSICS_EVERY = 5
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Plan:
    """What a case is drawn from."""

    seed: int
    form: int
    kind: str
    effect: str | None
    runs: int

    @property
    def key(self) -> str:
        return f"{self.kind}-{self.form}-{self.effect or 'any'}-{self.seed}-{self.runs}"

    def told(self) -> str:
        return f"{self.kind} form {self.form} {self.effect or ''}".rstrip()


def plans(
    cases: int, seed: int, runs: int = 3, kinds: Sequence[tuple[str, int]] = (), effects: Sequence[str] = ()
) -> list[Plan]:
    """The cases of a judging, shuffled so that any beginning of them is a fair sample.

    More cases with the same seed are the same ones and others.

    Args:
        cases: how many.
        seed: of the judging.
        runs: measured runs in each.
        kinds: kinds and forms to share the cases among; the usual mixture where empty.
        effects: only these effects, in turn; the whole catalogue, or all outside of it, where empty.
    """
    counts: dict[tuple[str, int], int] = {}
    if kinds:
        for number, key in enumerate(kinds):
            counts[key] = cases // len(kinds) + (number < cases % len(kinds))
    else:
        of = {"none": -(-cases // 4), "outside": -(-cases // 10), "pair": cases // 8}
        of["single"] = cases - sum(of.values())
        for kind, count in of.items():
            counts[kind, 1] = count // OTHER_PHYSICS_EVERY
            counts[kind, 0] = count - counts[kind, 1]
    made = []
    for (kind, form), count in counts.items():
        known = list(CATALOGUE) if kind == "single" else list(OUTSIDE) if kind == "outside" else []
        names = [name for name in effects if name in ALL_EFFECTS and (name in OUTSIDE) == (kind == "outside")]
        turn = (names or known) if kind in {"single", "outside"} else []
        base = seed * SEEDS_PER_JUDGING + KINDS.index(kind) * SEEDS_PER_KIND
        for i in range(count):
            made.append(Plan(base + i, form, kind, turn[i % len(turn)] if turn else None, runs))
    order = np.random.default_rng(seed).permutation(len(made))
    return [made[int(i)] for i in order]


def parse_kinds(text: str) -> list[tuple[str, int]]:
    """``single:0,none:1`` as kinds and forms; a kind alone means both forms.

    Raises:
        BadInput: an unknown kind or form.
    """
    found = []
    for part in filter(None, text.split(",")):
        kind, _, form = part.strip().partition(":")
        if kind not in KINDS:
            raise BadInput(f"--kinds: no kind `{kind}`{did_you_mean(kind, KINDS)}")
        if form not in {"", "0", "1"}:
            raise BadInput(f"--kinds: form `{form}` in `{part}` is neither 0 nor 1")
        found += [(kind, int(form))] if form else [(kind, 0), (kind, 1)]
    return found


def judge(plan: Plan, folder: Path, command: Sequence[str], timeout_s: float) -> dict[str, Any]:
    """Draw, write and diagnose one case.

    Args:
        plan: the case.
        folder: where to; must not exist.
        command: the diagnosing program and its subcommand.
        timeout_s: when to give it up.

    Returns:
        The line for the results file: ``key``, ``truth``, ``diagnosis`` (None where it failed), ``seconds``, ``error``.
    """
    case = draw_case(plan.seed, plan.form, plan.kind, plan.runs, effect=plan.effect)
    write_case(case, folder)
    output = folder / "diagnosis"
    runs, held_out = ([str(path) for path in sorted((folder / group).iterdir())] for group in ("measured", "held_out"))
    judged_by = [word for run in held_out for word in ("--holdout", run)]
    started = time.monotonic()
    error = ""
    try:
        done = subprocess.run(
            [*command, *runs, "--reference", str(folder / "reference"), *judged_by, "-o", str(output), "--quiet"],
            env={**os.environ, **dict.fromkeys(THREADS, "1")},
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
        if done.returncode != 0:
            error = f"status {done.returncode}: {(done.stderr.strip() or 'no word').splitlines()[-1]}"
    except subprocess.TimeoutExpired:
        error = f"not ready after {timeout_s:g} s"
    except OSError as problem:
        raise BadInput(f"{command[0]}: cannot be started ({problem.strerror}); run `make setup`") from problem
    seconds = time.monotonic() - started
    diagnosis = None
    if not error:
        try:
            diagnosis = json.loads((output / "diagnosis.json").read_bytes())
        except (OSError, ValueError) as problem:
            error = f"diagnosis.json cannot be read: {problem}"
    return {
        "key": plan.key,
        "truth": truth(case),
        "diagnosis": diagnosis,
        "seconds": round(seconds, 2),
        "error": error,
    }


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
    return [Outcome(entry["truth"], entry["diagnosis"], entry["seconds"]) for entry in entries]


def run_all(wanted: Sequence[Plan], options: argparse.Namespace) -> list[Outcome]:
    """Judge all cases that the results file does not have yet; returns the outcomes of all."""
    done = read_results(options.results)
    left = [plan for plan in wanted if plan.key not in done or done[plan.key]["diagnosis"] is None]
    print(f"{len(wanted)} cases, {len(wanted) - len(left)} of them in {options.results}", flush=True)
    options.results.parent.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="discovery-") as scratch, ThreadPoolExecutor(options.jobs) as pool:

        def work(plan: Plan) -> dict[str, Any]:
            folder = (options.keep or Path(scratch)) / plan.key
            if folder.exists():
                shutil.rmtree(folder)
            try:
                return judge(plan, folder, [str(options.program), "diagnose"], options.timeout_s)
            finally:
                if options.keep is None:
                    shutil.rmtree(folder, ignore_errors=True)

        waiting = {pool.submit(work, plan): plan for plan in left}
        try:
            for number, ready in enumerate(as_completed(waiting), start=1):
                entry = ready.result()
                done[entry["key"]] = entry
                files.append_line(options.results, json.dumps(entry))
                _say(number, len(left), waiting[ready], entry, time.monotonic() - started)
        except BaseException:
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
        write_case(draw_case(plan.seed, plan.form, plan.kind, plan.runs, effect=plan.effect), folder / plan.key)
        print(folder / plan.key, flush=True)


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="discovery", description="Judge flora-lab diagnose on hidden effects.")
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--first", type=int, help="only so many of them, a fair sample")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time, one thread each")
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
        if min(options.cases, options.jobs, options.runs, options.first or 1) < 1:
            raise BadInput("--cases, --first, --jobs and --runs must be at least 1")
        effects = [name for name in options.effects.split(",") if name]
        for name in effects:
            if name not in ALL_EFFECTS:
                raise BadInput(f"--effects: no effect `{name}`{did_you_mean(name, list(ALL_EFFECTS))}")
        wanted = plans(options.cases, options.seed, options.runs, parse_kinds(options.kinds), effects)[: options.first]
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
