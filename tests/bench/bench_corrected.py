"""Does a learned simulator follow plants with an effect better, once a diagnosis has put that effect beside it?

    .venv/bin/python tests/bench/bench_corrected.py --out out/corrected

An LSTM is learned from the nine healthy runs of a drawn world; then for each effect three runs of other plants with it
are diagnosed, and three further ones held out. A quarter of an hour on one core.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for library in ("OMP", "OPENBLAS", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

from tests.discovery.worlds.case import draw_case  # noqa: E402
from tests.discovery.worlds.writing import write_case  # noqa: E402

from flora_lab.main import main as flora_lab  # noqa: E402

EFFECTS = ("growth_rate", "sag", "lamp_asymmetry")


def lab(*arguments: str | Path) -> None:
    """One command of the lab; what goes wrong has been told already."""
    status = flora_lab([str(one) for one in arguments])
    if status:
        sys.exit(status)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=502_001, help="of the world")
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    options = parser.parse_args()
    learned = options.out / "lstm.simulator"
    for number, effect in enumerate(EFFECTS):
        case, found = options.out / effect, options.out / f"{effect}-found"
        drawn = draw_case(options.seed, 0, "single", 3, effect=effect, held_out=3, number=number)
        write_case(drawn, case)
        if not learned.exists():
            lab("train", *sorted((case / "reference").iterdir()), "-o", learned, "-q")
        held_out = [part for path in sorted((case / "held_out").iterdir()) for part in ("--holdout", path)]
        given = ("--simulator", learned, "--reference", case / "reference", "-o", found, "--no-report", "--quiet")
        lab("diagnose", *sorted((case / "measured").iterdir()), *held_out, *given)
        told = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
        print(drawn.hidden, "named", [(cause["effect"], cause["parameters"]) for cause in told["causes"]])
        for when, row in told.get("learned", {}).get("tip_error_mm", {}).items():
            print(f"  {when}: {row}", flush=True)


if __name__ == "__main__":
    main()
