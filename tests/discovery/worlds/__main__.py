"""Write one case: ``python -m tests.discovery.worlds --seed 1 --form 0 --kind single -o DIR``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from flora_common.cli import run_cli
from flora_common.errors import BadInput

from .case import HOURS, KINDS, draw_case
from .writing import write_case


def main() -> int:
    parser = argparse.ArgumentParser(prog="worlds", description="Write a case with a hidden effect.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--form", type=int, default=0, help="0: planar stem; 1: other physics")
    parser.add_argument("--kind", default="single", help=", ".join(KINDS))
    parser.add_argument("--effect", help="name of the effect; drawn where missing")
    parser.add_argument("--number", type=int, default=0, help="which plants of the seed's world are measured")
    parser.add_argument("--runs", type=int, default=3, help="measured runs")
    parser.add_argument("--reference", type=int, default=9, help="runs without an effect")
    parser.add_argument("--hours", type=float, default=HOURS, help="length of each run")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to make")
    options = parser.parse_args()

    def work() -> None:
        if options.output.exists():
            raise BadInput(f"{options.output}: is there already; name a new folder")
        case = draw_case(
            options.seed,
            options.form,
            options.kind,
            options.runs,
            options.reference,
            effect=options.effect,
            hours=options.hours,
            number=options.number,
        )
        write_case(case, options.output)
        told = ", ".join(f"{hidden.name} {hidden.parameters}" for hidden in case.hidden)
        print(f"{options.output}: {told or 'nothing hidden'}")

    return run_cli("worlds", work)


if __name__ == "__main__":
    sys.exit(main())
