"""Simulators on plants that no recipe ever saw: one step, free runs, the best that could be done, and time scales.

    .venv/bin/python tests/bench/bench_simulators.py                 quick: 6 + 6 plants, some two minutes
    .venv/bin/python tests/bench/bench_simulators.py --full --json out/simulators.json      the tables of the docs
    .venv/bin/python tests/bench/bench_simulators.py --pixels        what small pictures do to the paper's recipe
    .venv/bin/python tests/bench/bench_simulators.py --chance        do plants lie where simulated ones do by chance?

Trains every recipe on the paper's nine experiments, grown in the virtual box, and judges them on other individuals,
half under six-hour switching, half under random light. docs/results/simulators.md says what the figures mean.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS))

import numpy as np  # noqa: E402

from bench.simulators.floors import tip_errors_mm  # noqa: E402
from flora_lab.dataset.store import read_dataset  # noqa: E402
from flora_lab.main import main as lab  # noqa: E402
from flora_lab.rollout.at_time_scale import AtTimeScale  # noqa: E402
from flora_lab.rollout.intervals import median  # noqa: E402
from flora_lab.rollout.report import as_json  # noqa: E402
from flora_lab.rollout.work import judge_all  # noqa: E402
from flora_lab.run_tracks import RunTrack, load_runs  # noqa: E402
from flora_lab.simulator.interface import Chance, run  # noqa: E402
from flora_lab.simulator.load import load  # noqa: E402
from flora_lab.simulator.measured import in_steps, side_by_side  # noqa: E402
from flora_twin.main import main as twin  # noqa: E402

TRAINING_SEED = 1
HELD_OUT_SEED = 9001
"""Individuals from here on judge and nothing else; who tunes a recipe takes others (--held-out-seed)."""
HORIZONS_H = (1.0, 6.0, 24.0)
WATCH_H = 24.0
PIXELS_CM = (0.0, 0.18, 0.36, 0.72)
ROWS_PER_H = 12
CHANCE_H = (6, 24, 48, 72)
DRAWN = 100


def main() -> int:
    options = parsed()
    with tempfile.TemporaryDirectory() as scratch:
        work = options.keep or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        found = (pixels if options.pixels else chance if options.chance else simulators)(work, options)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def simulators(work: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Train all recipes, judge them, print the tables."""
    each = options.plants or (12 if options.full else 6)
    nine = grown(work / "nine", TRAINING_SEED)
    held = grown(work / "held-out", options.held_out_seed, open_loop=each, closed_loop=0, random=each)
    recipes = {
        "sequence": ["--recipe", "sequence"],
        "mechanistic": ["--recipe", "mechanistic"],
        "paper": ["--recipe", "paper"],
        "paper, by plant": ["--recipe", "paper", "--split", "plant"],
    }
    trained: dict[str, Any] = {}
    for name, arguments in recipes.items():
        path = work / f"{name.replace(', ', '-').replace(' ', '-')}.simulator"
        began_s = time.perf_counter()
        trained[name] = {"results": told([*arguments, *map(str, sorted(nine.iterdir())), "-o", str(path), "--force"])}
        trained[name] |= {"path": path, "seconds": time.perf_counter() - began_s}
        print(f"trained {name} in {trained[name]['seconds']:.0f} s", file=sys.stderr)
    tracks = load_runs(sorted(held.iterdir()))
    scaled = judged({"paper": load(trained["paper"]["path"])}, tracks, options.seed, time_scale=True)
    factor = next(iter(scaled["time_scales"].values()))["factor"]["value"]
    all_of_them = {name: load(entry["path"]) for name, entry in trained.items()}
    slowed = f"paper at its best time scale ({factor:.2f})"
    all_of_them[slowed] = AtTimeScale(load(trained["paper"]["path"]), factor)
    found = judged(all_of_them, tracks, options.seed)
    floors = floors_of(tracks, options.seed)
    show(found, floors, (*all_of_them, "nothing-moves", "goes-on"))
    show_times_better(found, ("sequence", "mechanistic"), slowed, tracks, all_of_them, options.seed)
    return {
        "rollout": found,
        "floors": floors,
        "time_scale": scaled["time_scales"],
        "training": {name: {"results": e["results"], "seconds": e["seconds"]} for name, e in trained.items()},
    }


def pixels(work: Path, options: argparse.Namespace) -> dict[str, Any]:
    """The paper's recipe on tracks told in whole pixels."""
    each = options.plants or (12 if options.full else 6)
    held = grown(work / "held-out", options.held_out_seed, open_loop=each, closed_loop=0, random=each)
    tracks = load_runs(sorted(held.iterdir()))
    print(
        "| pixel, mm | measured pairs that change | growth over 6 h, simulated / real | best time scale | at it, mm |"
    )
    print("|---|---|---|---|---|")
    rows = []
    for pixel_cm in PIXELS_CM:
        runs = grown(work / f"nine-{pixel_cm}", TRAINING_SEED, pixel_cm=pixel_cm)
        data = work / f"{pixel_cm}.data"
        plain = ["--without", "noise", "--without", "generic", "--without", "mirror"]
        quiet(lab, ["dataset", *map(str, sorted(runs.iterdir())), "-o", str(data), *plain, "--force", "-q"])
        counts = {count.step: count.vectors for count in read_dataset(data).info.count}
        path = work / f"{pixel_cm}.simulator"
        told(["--recipe", "paper", *map(str, sorted(runs.iterdir())), "-o", str(path), "--force"])
        found = judged({"paper": load(path)}, tracks, options.seed, time_scale=True)
        scale = next(iter(found["time_scales"].values()))
        growth = value_at(found, "unseen", 6.0, "growth", "paper")
        row = {
            "pixel_mm": 10.0 * pixel_cm,
            "kept": counts["duplicates"] / counts["pairs"],
            "growth_ratio": 1.0 + growth["value"],
            "factor": scale["factor"],
            "mean_tip_error_mm": scale["mean_tip_error_mm"],
        }
        rows.append(row)
        low, high = scale["factor"]["low"], scale["factor"]["high"]
        print(
            f"| {row['pixel_mm']:.1f} | {100 * row['kept']:.0f} % | {row['growth_ratio']:.1f} | "
            f"{scale['factor']['value']:.1f} [{low:.1f}, {high:.1f}] | {row['mean_tip_error_mm']:.0f} |",
            flush=True,
        )
    return {"pixels": rows}


def chance(work: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Individuals and courses drawn by chance, from each held-out plant's first stem."""
    each = options.plants or (12 if options.full else 6)
    nine = grown(work / "nine", TRAINING_SEED)
    held = grown(work / "held-out", options.held_out_seed, open_loop=each, closed_loop=0, random=each)
    batch = side_by_side([in_steps(track) for track in load_runs(sorted(held.iterdir()))])
    plants = batch.points_cm.shape[1]
    print("| | axis | " + " | ".join(f"{hours} h" for hours in CHANCE_H) + " |\n|---|---|" + "---|" * len(CHANCE_H))
    found: dict[str, Any] = {}
    for name in ("sequence", "mechanistic"):
        path = work / f"{name}.simulator"
        if not path.exists():
            told(["--recipe", name, *map(str, sorted(nine.iterdir())), "-o", str(path)])
        simulator = load(path)
        seeds = Chance(np.arange(plants * DRAWN))
        state = simulator.start(np.repeat(batch.points_cm[0], DRAWN, axis=0), seeds)
        inside = {}
        for row, light in enumerate(np.repeat(batch.light, DRAWN, axis=1), start=1):
            state, stems = simulator.step(state, light, batch.step_s)
            if row % ROWS_PER_H == 0 and row // ROWS_PER_H in CHANCE_H:
                below = stems[:, -1].reshape(plants, DRAWN, 2) < batch.points_cm[row, :, None, -1]
                share = below.mean(axis=1)
                inside[row // ROWS_PER_H] = ((share > 0.05) & (share < 0.95)).mean(axis=0).tolist()
        found[name] = inside
        for axis in range(2):
            cells = " | ".join(f"{100.0 * inside[hours][axis]:.0f} %" for hours in CHANCE_H)
            print(f"| {name} | {'xy'[axis]} | {cells} |", flush=True)
    members = load(work / "sequence.simulator").members()
    unusual = {"as they were": batch.light, "one lamp": np.ones_like(batch.light) * np.array([1.0, 0.0])}
    unusual |= {"dark": np.zeros_like(batch.light), "both lamps": np.ones_like(batch.light)}
    print("\n| lamps | tips of the members from their middle at 72 h, mm |\n|---|---|")
    parting = {}
    for name, light in unusual.items():
        tips = np.stack([run(one, one.start(batch.points_cm[0]), light, batch.step_s)[-1, :, -1] for one in members])
        away = np.sqrt(((tips - tips.mean(axis=0)) ** 2).sum(axis=-1).mean(axis=0))
        parting[name] = 10.0 * float(np.median(away))
        print(f"| {name} | {parting[name]:.1f} |")
    return {"inside_90_percent": found, "plants": plants, "drawn": DRAWN, "members_part_mm": parting}


def grown(
    folder: Path, seed: int, *, open_loop: int = 6, closed_loop: int = 3, random: int = 0, pixel_cm: float = 0.0
) -> Path:
    """Virtual runs, unless they are there."""
    if not folder.exists():
        loops = ["--open-loop", str(open_loop), "--closed-loop", str(closed_loop), "--random", str(random)]
        quiet(twin, ["runs", "-o", str(folder), "--seed", str(seed), *loops, "--pixel-cm", str(pixel_cm)])
    return folder


def told(arguments: Sequence[str]) -> dict[str, Any]:
    """Results of ``flora-lab train``."""
    return json.loads(quiet(lab, ["train", *arguments, "--json"]))["results"]


def quiet(command: Any, arguments: Sequence[str]) -> str:
    """Run a command of the project; what it printed."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        status = command(list(arguments))
    if status != 0:
        raise SystemExit(f"{' '.join(arguments)}: exit status {status}")
    return printed.getvalue()


def judged(
    simulators: Mapping[str, Any], tracks: Sequence[RunTrack], seed: int, *, time_scale: bool = False
) -> dict[str, Any]:
    """``flora-lab rollout --json``: first stem, and after watching a day."""
    _, summary = judge_all(
        simulators,
        tracks,
        watch_h=WATCH_H,
        every_h=1e3,
        horizons_h=HORIZONS_H,
        time_scale=time_scale,
        seed=seed,
        stage=lambda _name, _count: lambda: None,
    )
    return as_json(summary)


def floors_of(tracks: Sequence[RunTrack], seed: int) -> dict[str, Any]:
    """Errors of the plants' own equations, as medians over plants."""
    individuals = [int(track.plant.rsplit(" ", 1)[1]) for track in tracks]
    found: dict[str, Any] = {}
    for start, hours in (("unseen", 0.0), ("watched", WATCH_H)):
        errors = tip_errors_mm(individuals, [track.track for track in tracks], round(hours * ROWS_PER_H))
        for name, array in errors.items():
            rows = [*(round(h * ROWS_PER_H) - 1 for h in HORIZONS_H), len(array) - 1]
            estimates = [median(array[row], seed) for row in rows]
            found[f"{start}: {name}"] = [[e.value, e.low, e.high] for e in estimates]
    return found


def value_at(found: Mapping[str, Any], start: str, hours: float | None, measure: str, name: str) -> dict[str, Any]:
    """One entry of a rollout's errors; ``hours`` None is the end."""
    for entry in found["errors"]:
        at = entry["horizon_h"]
        same = at is None if hours is None else at is not None and abs(at - hours) < 1e-6
        if (entry["start"], entry["measure"], entry["simulator"]) == (start, measure, name) and same:
            return entry
    raise KeyError((start, hours, measure, name))


def show(found: Mapping[str, Any], floors: Mapping[str, Any], names: Sequence[str]) -> None:
    """Tables in Markdown."""
    titles = {"unseen": "from the first stem", "watched": f"after watching {WATCH_H:g} h"}
    print(f"\n{len(found['runs'])} runs of {found['plants']} plants; medians over plants, 95 % intervals")
    for start, title in titles.items():
        print(f"\n**Tip error in mm, running free {title}**\n")
        print("| | 1 h | 6 h | 24 h | end |\n|---|---|---|---|---|")
        for name in names:
            if name == "goes-on" and start == "unseen":
                continue
            cells = [cell(value_at(found, start, hours, "tip_mm", name)) for hours in (*HORIZONS_H, None)]
            print(f"| {name} | {' | '.join(cells)} |")
        for name in ("typical constants", "own constants"):
            cells = [f"{v:.1f} [{low:.1f}, {high:.1f}]" for v, low, high in floors[f"{start}: {name}"]]
            print(f"| the box's own equations, {name} | {' | '.join(cells)} |")
        print(f"\n**Growth, % too much, running free {title}**\n")
        print("| | 6 h | 24 h | end |\n|---|---|---|---|")
        for name in names[:-2]:
            cells = [cell(value_at(found, start, hours, "growth", name), 100.0) for hours in (6.0, 24.0, None)]
            print(f"| {name} | {' | '.join(cells)} |")
    print("\n**One step of five minutes, tip error in mm**\n\n| | 5 min |\n|---|---|")
    for name in names[:-1]:
        print(f"| {name} | {cell(value_at(found, 'one_step', 1.0 / ROWS_PER_H, 'tip_mm', name), digits=2)} |")


def show_times_better(
    found: Mapping[str, Any],
    ours: Sequence[str],
    theirs: str,
    tracks: Sequence[RunTrack],
    simulators: Mapping[str, Any],
    seed: int,
) -> None:
    """How many times smaller our errors are than the paper's recipe at its best."""
    print(f"\n**Times smaller than {theirs}: ratio of median tip errors**\n")
    print("| | start | 1 h | 6 h | 24 h | end |\n|---|---|---|---|---|---|")
    for name in ours:
        first = found if name == found["simulators"][0] else None
        told_of = first or judged({name: simulators[name], theirs: simulators[theirs]}, tracks, seed)
        for start in ("unseen", "watched"):
            cells = []
            for hours in (*HORIZONS_H, None):
                for entry in told_of["differences"]:
                    at = entry["horizon_h"]
                    same = at is None if hours is None else at is not None and abs(at - hours) < 1e-6
                    if (entry["start"], entry["measure"], entry["other"]) == (start, "tip_mm", theirs) and same:
                        cells.append(cell(entry["times_better"]))
            print(f"| {name} | {start} | {' | '.join(cells)} |")


def cell(entry: Mapping[str, Any], times: float = 1.0, digits: int = 1) -> str:
    """A number with its interval."""
    value, low, high = (np.nan if entry[k] is None else times * entry[k] for k in ("value", "low", "high"))
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="12 + 12 held-out plants")
    parser.add_argument("--plants", type=int, help="held-out plants under each kind of light")
    parser.add_argument("--pixels", action="store_true", help="the paper's recipe on tracks in whole pixels")
    parser.add_argument("--chance", action="store_true", help="individuals and courses drawn by chance")
    parser.add_argument("--held-out-seed", type=int, default=HELD_OUT_SEED)
    parser.add_argument("--seed", type=int, default=1, help="of the resampling of plants")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", type=Path, help="a folder to keep runs and simulators in")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
