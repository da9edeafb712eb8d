"""Run ``flora-lab diagnose`` on drawn cases: one by one, or the cases of a world with what the first has learned."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flora_common.errors import BadInput

from .plans import Plan
from .units import as_worlds_have
from .worlds.case import Case, Hidden, draw_case, named_mm
from .worlds.writing import truth, write_case

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
BASE = "base.simulator"


@dataclass(frozen=True)
class Finder:
    """The diagnosing program.

    Attributes:
        program: it has the subcommand ``diagnose``.
        timeout_s: when to give up a case.
        report: whether it draws pictures and a page, which nobody looks at unless cases are kept.
    """

    program: Path
    timeout_s: float
    report: bool = False

    def command(self, folder: Path, base: Path | None) -> list[str]:
        """What is called for a written case; its output is ``diagnosis`` in the case's folder."""
        runs, held_out = (
            [str(path) for path in sorted((folder / part).iterdir())] for part in ("measured", "held_out")
        )
        start = ["--reference", str(folder / "reference")] if base is None else ["--simulator", str(base)]
        judged_by = [word for run in held_out for word in ("--holdout", run)]
        words = [str(self.program), "diagnose", *runs, *start, *judged_by, "-o", str(folder / "diagnosis")]
        return [*words, *([] if self.report else ["--no-report"]), "--quiet"]


def drawn(plan: Plan) -> Case:
    """The case of a plan."""
    return draw_case(plan.seed, plan.form, plan.kind, plan.runs, effect=plan.effect, number=plan.number)


def base_of(plan: Plan, kept: Path) -> Path:
    """Where in a folder it is kept what was learned from the reference runs of a case."""
    return kept / f"{plan.form}-{plan.seed}" / BASE


def judge_world(world: Sequence[Plan], cases: Path, kept: Path, finder: Finder) -> Iterator[dict[str, Any]]:
    """Judge cases that have the same reference runs: what was learned from these in one serves those after it.

    Args:
        world: the cases.
        cases: a folder; each case's own folder in it is made anew, and left to the caller.
        kept: a folder for what was learned; not that of the cases.
        finder: the diagnosing program.

    Yields:
        The line of each case for the results file, see :func:`judge`, as soon as it is judged.
    """
    base: Path | None = None
    for plan in world:
        folder = cases / plan.key
        if folder.exists():
            shutil.rmtree(folder)
        entry = judge(plan, folder, finder, base)
        learned = folder / "diagnosis" / BASE
        if base is None and learned.is_dir():
            base = Path(shutil.copytree(learned, base_of(plan, kept)))
        yield entry


def judge(plan: Plan, folder: Path, finder: Finder, base: Path | None = None) -> dict[str, Any]:
    """Draw, write and diagnose one case.

    Args:
        plan: the case.
        folder: where to; must not exist.
        finder: the diagnosing program.
        base: what was learned from the same reference runs; learned in this case where missing.

    Returns:
        The line for the results file: ``key``, ``truth``, ``diagnosis`` (None where it failed), ``seconds``,
        ``learned`` (whether these are with the learning from the reference), ``error``; ``named_mm``, what its claims
        are worth about the held-out plants, see :func:`.worlds.case.named_mm`.

    Raises:
        BadInput: the program cannot be started.
    """
    case = drawn(plan)
    write_case(case, folder)
    command = finder.command(folder, base)
    started = time.monotonic()
    error = ""
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **dict.fromkeys(THREADS, "1")},
            capture_output=True,
            text=True,
            timeout=finder.timeout_s,
        )
        if done.returncode != 0:
            error = f"status {done.returncode}: {(done.stderr.strip() or 'no word').splitlines()[-1]}"
    except subprocess.TimeoutExpired:
        error = f"not ready after {finder.timeout_s:g} s"
    except OSError as problem:
        raise BadInput(f"{finder.program}: cannot be started ({problem.strerror}); run `make setup`") from problem
    seconds = time.monotonic() - started
    diagnosis = None
    if not error:
        try:
            diagnosis = json.loads((folder / "diagnosis" / "diagnosis.json").read_bytes())
        except (OSError, ValueError) as problem:
            error = f"diagnosis.json cannot be read: {problem}"
    return {
        "key": plan.key,
        "truth": truth(case),
        "diagnosis": diagnosis,
        "seconds": round(seconds, 2),
        "learned": base is None,
        "error": error,
        "named_mm": named_mm(case, claims(diagnosis)),
    }


def claims(diagnosis: Mapping[str, Any] | None) -> list[Hidden]:
    """What a diagnosis says that is at work, in the worlds' units; nothing where it does not explain the runs."""
    if diagnosis is None or diagnosis.get("verdict") != "explained":
        return []
    return [
        Hidden(str(cause["effect"]), as_worlds_have(str(cause["effect"]), cause["parameters"]))
        for cause in diagnosis["causes"]
    ]
