"""What naming an effect is worth to controllers: evolved without it and with it, run on plants that have it.

    make bench-controllers                                                    some twenty minutes
    make bench-controllers BENCH='--effects sag --kinds plan --seeds 2 --json out/gain.json'

For each effect controllers are evolved three times over: in the simulator without it, in the one that was extended by
it with parameters as far off as a diagnosis usually is, and in one with the true parameters, which is as good as it
gets. All are run on the same plants, which have the effect. Feedback controllers see the stem; light plans see nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

TESTS = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS))

from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from bench.machine import processor  # noqa: E402
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET  # noqa: E402
from flora_common.shapes import Obstacle  # noqa: E402
from flora_lab.diagnose.controller_gain import Effort, Kind, controller_gain  # noqa: E402
from flora_lab.evolve.task import Scenario, Task  # noqa: E402
from flora_lab.simulator.store import Extension  # noqa: E402
from lab.evolve_simulators import mechanistic  # noqa: E402


@dataclass(frozen=True)
class Hidden:
    """An effect: as it is, and as a diagnosis might have found it."""

    true: Extension
    found: Extension


HIDDEN = {
    "lamp_asymmetry": Hidden(
        Extension("lamp_asymmetry", {"right_to_left": 1.8}), Extension("lamp_asymmetry", {"right_to_left": 1.7})
    ),
    "sag": Hidden(Extension("sag", {"amplitude": 0.9}), Extension("sag", {"amplitude": 0.85})),
    "stiffening": Hidden(Extension("stiffening", {"factor": 0.65}), Extension("stiffening", {"factor": 0.68})),
}
"""Parameters are 5 to 6 % off, the median of what a diagnosis comes to."""
WITH_ROOM = Obstacle(-8.24, 8.8)
"""A plan cannot see, and plants differ: past the obstacle of the paper's reality it would come only by luck."""
TASKS: dict[Kind, Task] = {
    "feedback": Task(
        "round one",
        (Scenario("reality", REALITY_TARGET, REALITY_OBSTACLE),),
        stop_height_cm=18.5,
        collision_at_most=0.3,
    ),
    "plan": Task(
        "past one", (Scenario("past", REALITY_TARGET, WITH_ROOM),), stop_height_cm=18.5, collision_at_most=0.3
    ),
}


def main() -> int:
    options = parsed()
    effort = Effort(options.seeds, options.generations, options.population, options.individuals, options.judges)
    console = Console(width=None if sys.stdout.isatty() else 170)
    rows = []
    for effect in options.effects:
        for kind in options.kinds:
            began, hidden, base = time.perf_counter(), HIDDEN[effect], mechanistic()
            told = controller_gain(
                TASKS[kind],
                base,
                base.extended([hidden.found]),
                base.extended([hidden.true]),
                kind,
                effort,
                oracle=True,
            )
            rows.append({"effect": effect, **hidden.true.parameters, **told})
            print(f"{effect}, {kind}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    show(console, rows, effort)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        machine = {"processor": processor(), "load": os.getloadavg()[0]}
        options.json.write_text(json.dumps({"rows": rows, "machine": machine}, indent=1) + "\n")
    return 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="+", choices=list(HIDDEN), default=list(HIDDEN))
    parser.add_argument("--kinds", nargs="+", choices=list(TASKS), default=list(TASKS))
    parser.add_argument("--seeds", type=int, default=5, help="independent evolutions in each simulator")
    parser.add_argument("--generations", type=int, default=30)
    parser.add_argument("--population", type=int, default=40)
    parser.add_argument("--individuals", type=int, default=5, help="plants that evolution tries each controller on")
    parser.add_argument("--judges", type=int, default=24, help="plants that decide")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    return parser.parse_args()


def show(console: Console, rows: list[dict[str, Any]], effort: Effort) -> None:
    title = f"fitness (collisions) on {effort.judges} plants with the effect, mean of {effort.seeds} evolutions each"
    table = Table(title=title, title_justify="left")
    columns = ("effect", "controllers", "evolved without it", "extended", "with the truth", "extended - without")
    for name in (*columns, "without it, no effect", "recovered"):
        table.add_column(name)
    for row in rows:
        apart = row["difference"]
        recovered = "-" if row["recovered"] is None else f"{row['recovered']:.2f}"
        table.add_row(
            row["effect"],
            row["kind"],
            *(cell(row[name]) for name in ("base", "extended", "oracle")),
            f"{apart['mean']:+.3f} ± {apart['standard_error']:.3f}",
            cell(row["without_effect"]),
            recovered,
        )
    console.print(table)


def cell(told: dict[str, float]) -> str:
    return f"{told['mean']:.3f} ± {told['sd_of_seeds']:.3f} ({100 * told['collisions']:.0f} %)"


if __name__ == "__main__":
    sys.exit(main())
