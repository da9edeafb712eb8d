"""What naming hidden effects is worth to controllers: ``python -m tests.discovery.controllers --cases 26 --seed 1``.

Cases that hide one effect in the plant are drawn, written and diagnosed as in :mod:`.cases`. Controllers that see the
stem, and light plans that see nothing, are then evolved in the base simulator and in the extended one, and run on the
same plants of the base with the true effect. What is missed extends nothing, and brings nothing back; what is named
wrongly brings back what it does. Fitness that the effect costs and what comes back of it are pooled over all cases, for
a share of next to nothing is no figure.

Cases that the results file has are not run again. A growth that follows the temperature is left out: no task tells it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flora_common import files
from flora_common.cli import run_cli
from flora_lab.diagnose.controller_gain import Bred, Effort, Kind, bred, controller_gain
from flora_lab.diagnose.controllers_told import for_plans
from flora_lab.evolve.task import ROUND, Task
from flora_lab.simulator.load import load
from flora_lab.simulator.rod_simulator import RodSimulator
from flora_lab.simulator.store import Extension

from .cases import read_results
from .judging import Finder, base_of, claims, judge_world
from .plans import Plan, by_world, plans
from .scoring import pooled
from .tables import Table, as_markdown, as_text
from .units import as_finder_tells

ACTING = (
    "adaptation",
    "circumnutation",
    "diurnal_growth",
    "draught",
    "gravitropism",
    "growth_rate",
    "lamp_ageing",
    "lamp_asymmetry",
    "phototropic_gain",
    "phototropic_latency",
    "proprioception",
    "sag",
    "stiffening",
)
"""Effects on what a plant does."""
EXTENDED = "extended.simulator"
COMPARED = ("without_effect", "base", "extended")
TASKS: dict[Kind, Task] = {"feedback": ROUND, "plan": for_plans(ROUND)}
"""What ``flora-lab diagnose --controllers round`` evolves."""


@dataclass(frozen=True)
class Setting:
    """How cases are judged.

    Attributes:
        finder: the diagnosing program.
        kinds: of controllers.
        effort: of each evolution.
        oracle: whether controllers are evolved in the true plant, too.
    """

    finder: Finder
    kinds: tuple[Kind, ...]
    effort: Effort
    oracle: bool


def true_extension(effect: Mapping[str, Any]) -> Extension:
    """A hidden effect of ``truth.json`` in the simulator's units."""
    return Extension(effect["effect"], as_finder_tells(effect["effect"], effect["parameters"]))


def judge_controllers(world: Sequence[Plan], scratch: Path, setting: Setting) -> Iterator[dict[str, Any]]:
    """Diagnose the cases of a world and run controllers on their plants.

    Args:
        world: cases with the same reference runs.
        scratch: a folder to work in.
        setting: how.

    Yields:
        The line of each case: ``key``, ``truth``, ``named`` (effects that the diagnosis claims), ``error``, and
        ``controllers``, for each kind what :func:`flora_lab.diagnose.controller_gain.controller_gain` tells; None where
        the diagnosis failed.
    """
    cases, kept = scratch / "cases", scratch / "bases"
    base: RodSimulator | None = None
    in_base: dict[Kind, Bred] = {}
    for plan, entry in zip(world, judge_world(world, cases, kept, setting.finder), strict=True):
        folder = cases / plan.key / "diagnosis"
        line = {"key": plan.key, "truth": entry["truth"], "error": entry["error"], "controllers": None}
        if not entry["error"]:
            if base is None:
                base = _loaded(base_of(plan, kept))
                in_base = {kind: bred(TASKS[kind], base, kind, setting.effort) for kind in setting.kinds}
            plant = base.extended([true_extension(effect) for effect in entry["truth"]["effects"]])
            extended = _loaded(folder / EXTENDED) if (folder / EXTENDED).is_dir() else base
            line["controllers"] = {kind: _gain(own, extended, plant, setting) for kind, own in in_base.items()}
        line["named"] = [hidden.name for hidden in claims(entry["diagnosis"])]
        shutil.rmtree(cases / plan.key, ignore_errors=True)
        yield line


def _loaded(path: Path) -> RodSimulator:
    simulator = load(path)
    assert isinstance(simulator, RodSimulator)
    return simulator


def _gain(in_base: Bred, extended: RodSimulator, plant: RodSimulator, setting: Setting) -> dict[str, Any]:
    def of(simulator: RodSimulator) -> Bred:
        return bred(in_base.task, simulator, in_base.kind, setting.effort)

    in_extended = in_base if extended is in_base.simulator else of(extended)
    return controller_gain(in_base, in_extended, plant, of(plant) if setting.oracle else None)


def tables(lines: Sequence[Mapping[str, Any]], kinds: Sequence[Kind]) -> list[Table]:
    """What all cases together say, and each case."""
    done = [line for line in lines if line["controllers"] is not None]
    summary, each = [], []
    for kind in kinds:
        told = [line["controllers"][kind] for line in done]
        if not told:
            continue
        summary.append(
            (
                kind,
                str(len(told)),
                *(_cell(*(one[name] for one in told)) for name in COMPARED),
                *_of_truth(told),
                str(pooled([(one["difference"]["mean"], one["cost"]["mean"]) for one in told])),
                ">= 0.50",
            )
        )
    for line in sorted(done, key=lambda one: str(one["truth"]["effects"])):
        hidden = line["truth"]["effects"][0]
        strength = ", ".join(f"{name} {value:.3g}" for name, value in hidden["parameters"].items())
        cells = (_cell(line["controllers"][kind][name]) for kind in kinds for name in COMPARED)
        each.append((hidden["effect"], strength, ", ".join(line["named"]) or "-", *cells))
    truth = ("true plant's", "of what the truth brings")
    header = ("controllers", "cases", "without effect", "base's", "extended's", *truth, "of the cost", "aim")
    per_kind = tuple(f"{kind}: {name}" for kind in kinds for name in ("without effect", "base's", "extended's"))
    return [
        Table("Fitness (collisions) on plants with a hidden effect", header, summary),
        Table("By case", ("hidden", "strength", "named", *per_kind), each),
    ]


def _of_truth(told: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Fitness of controllers that were evolved in the true plant, and what comes back as a share of what they bring."""
    if not all("oracle" in one for one in told):
        return "-", "-"
    brought = [(one["difference"]["mean"], one["oracle"]["mean"] - one["base"]["mean"]) for one in told]
    return _cell(*(one["oracle"] for one in told)), str(pooled(brought))


def _cell(*told: Mapping[str, float]) -> str:
    fitness, collisions = (np.mean([one[part] for one in told]) for part in ("mean", "collisions"))
    return f"{fitness:.3f} ({100 * collisions:.0f} %)"


def run_all(wanted: Sequence[Plan], results: Path, setting: Setting) -> list[Mapping[str, Any]]:
    """Judge all cases that the results file does not have; returns the lines of all."""
    done = read_results(results)
    left = [plan for plan in wanted if not is_judged(done.get(plan.key), setting)]
    print(f"{len(wanted)} cases, {len(wanted) - len(left)} of them in {results}", flush=True)
    results.parent.mkdir(parents=True, exist_ok=True)
    started, judged = time.monotonic(), 0
    for world in by_world(left):
        with tempfile.TemporaryDirectory(prefix="controllers-") as scratch:
            for line in judge_controllers(world, Path(scratch), setting):
                judged += 1
                done[line["key"]] = line
                files.append_line(results, json.dumps(line))
                left_min = (time.monotonic() - started) / judged * (len(left) - judged) / 60.0
                print(f"{judged}/{len(left)} {_said(line)} ({left_min:.0f} min left)", flush=True)
    return [done[plan.key] for plan in wanted]


def is_judged(line: Mapping[str, Any] | None, setting: Setting) -> bool:
    """Whether a line has all that is asked for."""
    told = None if line is None else line["controllers"]
    asked = {"oracle"} if setting.oracle else set()
    return told is not None and all(kind in told and asked <= set(told[kind]) for kind in setting.kinds)


def _said(line: Mapping[str, Any]) -> str:
    hidden = line["truth"]["effects"][0]["effect"]
    if line["error"]:
        return f"{hidden}: {line['error']}"
    shares = (
        f"{k} {one['cost']['mean']:+.3f} {one['difference']['mean']:+.3f}" for k, one in line["controllers"].items()
    )
    return f"{hidden} -> {', '.join(line['named']) or 'nothing'}; cost and what comes back: {', '.join(shares)}"


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="discovery-gain", description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--cases", type=int, default=26)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--per-world", type=int, default=5, help="so many cases share their reference runs")
    parser.add_argument("--kinds", nargs="+", choices=list(TASKS), default=list(TASKS))
    parser.add_argument("--seeds", type=int, default=3, help="independent evolutions in each simulator")
    parser.add_argument("--generations", type=int, default=30)
    parser.add_argument("--population", type=int, default=40)
    parser.add_argument("--individuals", type=int, default=12, help="plants that evolution tries each controller on")
    parser.add_argument("--judges", type=int, default=24, help="plants that decide")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--oracle", action="store_true", help="evolve in the true plant, too: as good as it gets")
    parser.add_argument("--results", type=Path, default=Path("out/discovery/controllers.jsonl"))
    parser.add_argument("--markdown", type=Path, help="write the tables here, too")
    parser.add_argument("--program", type=Path, default=Path(sys.executable).parent / "flora-lab")
    parser.add_argument("--timeout-s", type=float, default=1800.0)
    return parser.parse_args()


def main() -> int:
    options = _parsed()
    effort = Effort(
        options.seeds, options.generations, options.population, options.individuals, options.judges, options.threads
    )
    setting = Setting(Finder(options.program, options.timeout_s), tuple(options.kinds), effort, options.oracle)

    def work() -> None:
        wanted = plans(options.cases, options.seed, 3, [("single", 0)], ACTING, options.per_world)
        told = tables(run_all(wanted, options.results, setting), setting.kinds)
        print(f"\n{as_text(told)}", end="")
        if options.markdown is not None:
            files.write_text(options.markdown, as_markdown(told))

    return run_cli("discovery-gain", work)


if __name__ == "__main__":
    sys.exit(main())
