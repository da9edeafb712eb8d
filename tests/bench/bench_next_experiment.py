"""Is the next experiment that a diagnosis asks for worth more than one more of the same?

    .venv/bin/python tests/bench/bench_next_experiment.py --worlds 8 --cases 5 --seed 31000 --json told.json

Effects, drawn at random from the whole catalogue, are hidden in one run under the paper's turns of six hours. Where the
diagnosis of that run asks for light, a second plant is measured three times over: under the same turns, under turns of
24 hours, and under what the map favours; its constants, chance and errors are the same each time. Told is how probable
the true cause is then, alone or with those that no light tells from it, among all causes and none.

Cases of a world have the same reference runs and other plants and effects. With ``--json`` it goes on where it was, and
``--sum`` tells of several such files.
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
from tests.discovery.worlds.case import Case, draw_case  # noqa: E402
from tests.discovery.worlds.writing import write_case  # noqa: E402

from flora_common.files import write_text  # noqa: E402
from flora_lab.diagnose.cross_fit import learn_from  # noqa: E402
from flora_lab.diagnose.explain import Explainer  # noqa: E402
from flora_lab.diagnose.explanation import Explanation  # noqa: E402
from flora_lab.diagnose.inputs import read_reference, read_runs  # noqa: E402
from flora_lab.diagnose.knowledge import Knowledge  # noqa: E402
from flora_lab.diagnose.next_experiment import next_experiment  # noqa: E402
from flora_lab.diagnose.scene import Scene  # noqa: E402
from flora_lab.effects.catalogue import BY_NAME  # noqa: E402

DEFAULT, LONG = "6h", "24h"
TEMPERATURE, NOTHING = 2.0, 3.0
"""Nats are divided by the first, and no cause is so many times more probable than any: nothing has been claimed here,
where a diagnosis is surer of what comes first (:data:`flora_lab.diagnose.verdict.FIRST_BELIEF`)."""


@dataclass(frozen=True)
class Told:
    """One case.

    Attributes:
        seed, number: of its world, and in it.
        effect: that is hidden.
        asked: light that the map of the first run favours; empty where it asks for none.
        first: probability of the truth after one run.
        default, long, followed: the same after a second one under each light; 0 where no light is asked for.
    """

    seed: int
    number: int
    effect: str
    asked: str
    first: float
    default: float = 0.0
    long: float = 0.0
    followed: float = 0.0


def probability(explanation: Explanation, effect: str) -> float:
    """Of the true cause, or of one that is exactly the same."""
    stage = explanation.stages[0]
    gains = np.array([tried.gain for tried in stage.tried])
    weights = scipy.special.softmax(np.append(gains / TEMPERATURE, np.log(NOTHING)))
    same = {effect, *BY_NAME[effect].exactly}
    return float(sum(w for w, tried in zip(weights, stage.tried, strict=False) if tried.effect.name in same))


class World:
    """A species, what its reference runs tell of it, and cases of it."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._seed, self._folder = seed, folder
        case = self._written(0, DEFAULT)
        runs = read_runs(sorted((case / "measured").iterdir()), print)
        told = read_reference(case / "reference", runs)
        self._usual_c = told.usual_temperature_c()
        self._known: Knowledge = learn_from(told.scenes(self._usual_c))

    def _case(self, number: int, *light: str) -> Case:
        return draw_case(self._seed, 0, "single", len(light), held_out=1, light=light, number=number)

    def _written(self, number: int, *light: str) -> Path:
        folder = Path(tempfile.mkdtemp(dir=self._folder)) / "case"
        write_case(self._case(number, *light), folder)
        return folder

    def _scenes(self, number: int, *light: str) -> list[Scene]:
        paths = sorted((self._written(number, *light) / "measured").iterdir())
        return read_runs(paths, print).scenes(self._usual_c)

    def judged(self, number: int) -> Told:
        """One case."""
        (hidden,) = self._case(number, DEFAULT).hidden
        scenes = self._scenes(number, DEFAULT)
        explanation = Explainer(scenes, self._known).explain()
        asked = next_experiment(scenes, self._known.base, explanation, self._known.errors).favours
        first = probability(explanation, hidden.name)
        if not asked:
            return Told(self._seed, number, hidden.name, "", first)
        after = {}
        for light in {DEFAULT, LONG, asked}:
            found = Explainer(self._scenes(number, DEFAULT, light), self._known).explain()
            after[light] = probability(found, hidden.name)
        return Told(self._seed, number, hidden.name, asked, first, after[DEFAULT], after[LONG], after[asked])


def printed(found: Sequence[Told]) -> None:
    asked = [one for one in found if one.asked]
    others = sum(one.asked != DEFAULT for one in asked)
    print(f"{len(found)} cases; light is asked for in {len(asked)}; the map favours another than six hours in {others}")
    if not asked:
        return
    followed, default, long, first = (
        np.array([getattr(one, name) for one in asked]) for name in ("followed", "default", "long", "first")
    )
    print(f"of those {len(asked)}: mean probability of the truth after one run {first.mean():.2f},")
    lights = {"turns of six hours again": default, "turns of 24 hours": long, "what the map favours": followed}
    for name, values in lights.items():
        print(f"  after one more, {name}: {values.mean():.2f}; 80 % or more in {int((values >= 0.8).sum())}")
    differs = followed != default
    if differs.any():
        p_value = scipy.stats.wilcoxon(followed[differs], default[differs], alternative="greater").pvalue
        better = int((followed > default).sum())
        print(f"  what it favours is better in {better}, worse in {int(differs.sum()) - better}: p = {p_value:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--cases", type=int, default=5, help="of each world")
    parser.add_argument("--seed", type=int, default=31_000, help="of the first world")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--sum", type=Path, nargs="+", help="files to tell of; nothing is judged")
    options = parser.parse_args()
    files = options.sum or [path for path in [options.json] if path is not None and path.exists()]
    found = [Told(**row) for file in files for row in json.loads(file.read_text(encoding="utf-8"))]
    known = {(one.seed, one.number) for one in found}
    for seed in range(options.seed, options.seed + (0 if options.sum else options.worlds)):
        left = [number for number in range(options.cases) if (seed, number) not in known]
        if not left:
            continue
        with tempfile.TemporaryDirectory() as folder:
            world = World(seed, Path(folder))
            for number in left:
                found.append(world.judged(number))
                print(found[-1], flush=True)
                if options.json is not None:
                    write_text(options.json, json.dumps([asdict(one) for one in found], indent=1))
    printed(found)


if __name__ == "__main__":
    main()
