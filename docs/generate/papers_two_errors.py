"""Tables and figures of docs/results/the-papers-two-errors.md, from the folder that its commands make.

    .venv/bin/python docs/generate/papers_two_errors.py STUDY docs/images

STUDY holds ``dataset`` and ``judged`` (photographed runs with a track.csv by the path method, of ``dataset`` at least
some), ``tracks/paper4`` and ``tracks/paper8`` (the published method's tracks of ``dataset``) and ``why`` (the
diagnosis). Simulators by the paper's recipe are trained from each set of tracks, three seeds each, into
``STUDY/simulators``, unless they are there.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from matplotlib.figure import Figure

from flora_common.arrays import FloatArray
from flora_common.tracks import read_track
from flora_lab.diagnose.diagnosis import Diagnosis
from flora_lab.diagnose.inputs import read_runs
from flora_lab.diagnose.learned_told import table
from flora_lab.diagnose.mended_simulator import BASE, CLOCK, MEMORY, STILL
from flora_lab.figure_style import BLUE, COLOURS, GREY, GRID, ORANGE, new_figure, png
from flora_lab.rollout.time_scale import TimeScale, best_time_scale
from flora_lab.simulator.load import load
from flora_lab.simulator.measured import MeasuredRun
from flora_twin.photographs import TRUTH_CSV

SEEDS: Final = (1, 2, 3)
TRAIN: Final = Path(sys.executable).with_name("flora-lab")
SAME_CM: Final = 1e-3
"""Stems that are told in micrometres and differ by less are one."""
WRONG: Final = {BASE: BLUE, CLOCK: COLOURS[4], MEMORY: ORANGE, STILL: GREY}
TITLES: Final = {
    BASE: "as learned",
    CLOCK: "clock set right",
    MEMORY: "and a memory beside it",
    STILL: "a stem that does not move",
}


@dataclass(frozen=True, slots=True)
class Source:
    """How the photographs were measured.

    Attributes:
        name: of its simulators.
        title: for people.
        tracks: what ``flora-lab train`` is given.
        options: and with which options the training set is made.
    """

    name: str
    title: str
    tracks: list[Path]
    options: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Clock:
    """What the simulators of a source make of time.

    Attributes:
        source: of the tracks.
        scales: one per seed.
        gone: share of measured pairs in which no point moves, which the recipe drops.
        tip_stays: share in which the tip does not move.
        step_mm: median way of the tip in five minutes.
    """

    source: Source
    scales: list[TimeScale]
    gone: float
    tip_stays: float
    step_mm: float


def main(study: Path, images: Path) -> None:
    """All of it."""
    judged = read_runs(sorted((study / "judged").iterdir())).measured
    print(ruler_table(study))
    clocks = [clock_of(source, study, judged) for source in sources(study)]
    print(clock_table(clocks))
    found = msgspec.json.decode((study / "why" / "diagnosis.json").read_bytes(), type=Diagnosis)
    rows = table(found.learned)
    print("\n".join(["| " + " | ".join(row) + " |" for row in [rows[0], ["---"] * len(rows[0]), *rows[1:]]]))
    (images / "two-errors-clock.png").write_bytes(png(clock_figure(clocks)))
    (images / "two-errors-gain.png").write_bytes(png(gain_figure(found)))
    (images / "two-errors-tips.png").write_bytes((study / "why" / "pictures" / "learned.png").read_bytes())


def sources(study: Path) -> list[Source]:
    """The same photographs, measured in three ways."""
    small, smaller = (sorted((study / "tracks" / name).glob("*.csv")) for name in ("paper4", "paper8"))
    path = sorted((study / "dataset").glob("*/track.csv"))
    return [
        Source("paper410", "published method, 410 px", small),
        Source("paper410-all", "the same, duplicates kept", small, ("--without", "duplicates")),
        Source("paper205", "published method, 205 px", smaller),
        Source("path", f"path method, 1640 px, {len(path)} runs", path),
    ]


def ruler_table(study: Path) -> str:
    """How far tips are from where they truly are, in Markdown."""
    lines = ["| tracks | runs | tip off, median, mm | 95 %, mm |", "| --- | --- | --- | --- |"]
    for source in [s for s in sources(study) if not s.options] + [
        Source("judged", "path method, judged runs", sorted((study / "judged").glob("*/track.csv")))
    ]:
        off_mm = np.concatenate([tips_off_mm(study, file) for file in source.tracks])
        lines.append(
            f"| {source.title} | {len(source.tracks)} | {np.median(off_mm):.1f} | {np.percentile(off_mm, 95):.1f} |"
        )
    return "\n".join(lines)


def tips_off_mm(study: Path, file: Path) -> FloatArray:
    """Distance of a track's tips from the true ones, shape (n,)."""
    folder = file.parent if file.name == "track.csv" else study / "dataset" / file.stem
    found, true = read_track(file), read_track(folder / TRUTH_CSV)
    rows = np.searchsorted(true.time_s, found.time_s - 1.0)
    return np.asarray(10.0 * np.linalg.norm(found.points_cm[:, -1] - true.points_cm[rows, -1], axis=1))


def clock_of(source: Source, study: Path, judged: tuple[MeasuredRun, ...]) -> Clock:
    """Train, and see how fast the simulated plants live."""
    scales = []
    folder = study / "simulators"
    folder.mkdir(exist_ok=True)
    for seed in SEEDS:
        simulator = folder / f"{source.name}-{seed}.simulator"
        if not simulator.exists():
            trained_on: list[str | Path] = [*source.tracks]
            if source.options:
                data = folder / f"{source.name}.data"
                if not data.exists():
                    run(["dataset", *source.tracks, "-o", data, *source.options, "-q"])
                trained_on = [data]
            run(["train", *trained_on, "--recipe", "paper", "--seed", str(seed), "-o", simulator])
        scales.append(best_time_scale(load(simulator), judged, seed=1))
        print(source.name, seed, scales[-1].factor, file=sys.stderr)
    moves = [np.abs(np.diff(read_track(file).points_cm, axis=0)) for file in source.tracks]
    still = np.concatenate([(move.max(axis=(1, 2)) < SAME_CM) for move in moves])
    way_cm = np.concatenate([np.hypot(*move[:, -1].T) for move in moves])
    return Clock(source, scales, float(still.mean()), float((way_cm < SAME_CM).mean()), float(10.0 * np.median(way_cm)))


def run(arguments: list[str | Path]) -> None:
    """A command of the lab."""
    subprocess.run([TRAIN, *arguments], check=True, stdout=subprocess.DEVNULL)


def clock_table(clocks: list[Clock]) -> str:
    """In Markdown."""
    lines = [
        "| measured by | no point moves | the tip stays | its way in 5 min, median, mm | too fast by, seeds 1, 2, 3 | "
        "error as learned, mm | at the best factor, mm |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for clock in clocks:
        factors = ", ".join(f"{scale.factor.value:.1f}" for scale in clock.scales)
        as_is, best = (
            ", ".join(f"{value:.0f}" for value in values)
            for values in ([s.error_as_is_mm for s in clock.scales], [s.error_mm for s in clock.scales])
        )
        lines.append(
            f"| {clock.source.title} | {100 * clock.gone:.1f} % | {100 * clock.tip_stays:.0f} % | "
            f"{clock.step_mm:.2f} | {factors} | {as_is} | {best} |"
        )
    return "\n".join(lines)


def clock_figure(clocks: list[Clock]) -> Figure:
    """How often the tip stays, and the error against the factor by which the clock is slowed down."""
    figure = new_figure(9.6, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    shown = [clock for clock in clocks if not clock.source.options]
    places = np.arange(len(shown))
    left.barh(places - 0.2, [100 * c.tip_stays for c in shown], 0.38, color=BLUE, label="the tip stays")
    left.barh(places + 0.2, [100 * c.gone for c in shown], 0.38, color=ORANGE, label="no point moves: dropped")
    left.set_yticks(places, [c.source.title for c in shown], fontsize=8)
    left.invert_yaxis()
    left.set_xlabel("pairs five minutes apart, %")
    left.legend(fontsize=8, frameon=False)
    for clock, colour in zip(clocks, COLOURS, strict=False):
        curves: list[FloatArray] = [scale.errors_mm for scale in clock.scales]
        for number, (scale, errors) in enumerate(zip(clock.scales, curves, strict=True)):
            label = clock.source.title if number == 0 else None
            right.plot(scale.factors, errors, color=colour, linewidth=1.2, alpha=0.85, label=label)
            right.plot(scale.factor.value, scale.error_mm, "o", color=colour, markersize=5)
    right.set(xscale="log", yscale="log", xlabel="the simulator's clock, slowed down so many times")
    right.set_ylabel("mean tip error, mm")
    right.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    right.set_ylim(15.0, 12_000.0)  # room for the legend above the curves
    right.legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
    for ax in (left, right):
        ax.grid(color=GRID, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure


def gain_figure(found: Diagnosis) -> Figure:
    """Tip errors before and after, by the time since the first stem."""
    errors = found.learned["tip_error_mm"]
    times = list(errors)
    names = [name for name in WRONG if name in errors[times[0]]]
    figure = new_figure(7.6, 3.4)
    ax = figure.subplots()
    wide = 0.8 / len(names)
    for i, name in enumerate(names):
        places = np.arange(len(times)) + (i - (len(names) - 1) / 2) * wide
        values = [errors[when][name] for when in times]
        bars = ax.bar(places, values, wide, color=WRONG[name], label=TITLES[name])
        ax.bar_label(bars, [f"{value:.0f}" for value in values], fontsize=7)
    ax.set_xticks(
        np.arange(len(times)), [{"end": "the end", "mean": "mean"}.get(w, w.replace("h", " h")) for w in times]
    )
    ax.set(yscale="log", ylabel="tip error, mm", xlabel="from the first stem")
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
