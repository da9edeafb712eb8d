"""Is the next experiment that a diagnosis asks for worth more than one more of the same?

    .venv/bin/python tests/bench/bench_next_experiment.py --cases 16 --seed 31000

Effects that are hard to name are hidden in one run under the paper's turns of six hours. A second plant is then
measured three times over, under the same turns, under turns of 24 hours, and under those that the diagnosis of the
first run asks for; its constants, chance and errors are the same each time. Told is how probable the true cause is
then, alone or with those that no light tells from it, among all causes and none.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

for library in ("OMP", "OPENBLAS", "NUMBA"):
    os.environ[f"{library}_NUM_THREADS"] = "1"

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np  # noqa: E402
import scipy.special  # noqa: E402
import scipy.stats  # noqa: E402
from tests.discovery.worlds.case import draw_case  # noqa: E402
from tests.discovery.worlds.writing import write_case  # noqa: E402

from flora_lab.diagnose.cross_fit import learn_from  # noqa: E402
from flora_lab.diagnose.explain import Explainer  # noqa: E402
from flora_lab.diagnose.inputs import read_reference, read_runs  # noqa: E402
from flora_lab.diagnose.knowledge import Knowledge  # noqa: E402
from flora_lab.diagnose.next_experiment import candidates_of, next_experiment  # noqa: E402
from flora_lab.effects.catalogue import BY_NAME  # noqa: E402

HARD = (
    "gravitropism",
    "proprioception",
    "adaptation",
    "phototropic_gain",
    "stiffening",
    "lamp_asymmetry",
    "growth_rate",
    "lamp_ageing",
)
DEFAULT, LONG = "6h", "24h"
TEMPERATURE, NOTHING = 2.0, 3.0
"""Nats are divided by the first, and no cause is so many times more probable than any: nothing has been claimed here,
where a diagnosis is surer of what comes first (:data:`flora_lab.diagnose.verdict.FIRST_BELIEF`)."""


@dataclass(frozen=True)
class Told:
    """One case: probability of the truth after one run, and after a second one under each light."""

    effect: str
    first: float
    asked: str
    default: float
    long: float
    followed: float


def probability(explainer: Explainer, effect: str) -> float:
    """Of the true cause, or of one that is exactly the same."""
    stage = explainer.explain().stages[0]
    gains = np.array([tried.gain for tried in stage.tried])
    weights = scipy.special.softmax(np.append(gains / TEMPERATURE, np.log(NOTHING)))
    same = {effect, *BY_NAME[effect].exactly}
    return float(sum(w for w, tried in zip(weights, stage.tried, strict=False) if tried.effect.name in same))


def judged(seed: int, effect: str, scratch: Path) -> Told | None:
    """One case; None where the first run leaves nothing to ask."""

    def measured(name: str, *light: str) -> list[Path]:
        case = draw_case(seed, 0, "single", len(light), effect=effect, held_out=1, light=light)
        write_case(case, scratch / name)
        return sorted((scratch / name / "measured").iterdir())

    first = measured("first", DEFAULT)
    runs = read_runs(first, print)
    told = read_reference(scratch / "first" / "reference", runs)
    usual_c = told.usual_temperature_c()
    known: Knowledge = learn_from(told.scenes(usual_c))

    def explainer(paths: Sequence[Path]) -> Explainer:
        return Explainer(read_runs(paths, print).scenes(usual_c), known)

    explanation = explainer(first).explain()
    if len(candidates_of(explanation)) < 2:
        return None
    asked = next_experiment(runs.scenes(usual_c), known.base, explanation, known.errors).light_schedule
    if not asked:
        return None
    after = {light: probability(explainer(measured(light, DEFAULT, light)), effect) for light in {DEFAULT, LONG, asked}}
    return Told(effect, probability(explainer(first), effect), asked, after[DEFAULT], after[LONG], after[asked])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=16)
    parser.add_argument("--seed", type=int, default=31_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: list[Told] = []
    for number in range(options.cases):
        effect = HARD[number % len(HARD)]
        with tempfile.TemporaryDirectory() as folder:
            told = judged(options.seed + number, effect, Path(folder))
        print(number + 1, effect, told or "one run leaves nothing to ask", flush=True)
        found += [told] if told is not None else []
        if options.json is not None:
            options.json.write_text(json.dumps([asdict(one) for one in found], indent=1), encoding="utf-8")
    followed, default, long, first = (
        np.array([getattr(one, name) for one in found]) for name in ("followed", "default", "long", "first")
    )
    print(f"{len(found)} cases; mean probability of the truth after one run {first.mean():.2f},")
    for name, values in (("turns of six hours again", default), ("turns of 24 hours", long), ("asked for", followed)):
        print(f"  after one more, {name}: {values.mean():.2f}; 80 % or more in {int((values >= 0.8).sum())}")
    differs = followed != default
    if differs.any():
        p_value = scipy.stats.wilcoxon(followed[differs], default[differs], alternative="greater").pvalue
        print(f"  another light was asked for in {int(differs.sum())}; better than the same again: p = {p_value:.3f}")


if __name__ == "__main__":
    main()
