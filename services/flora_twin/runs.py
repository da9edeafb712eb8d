"""The nine runs that the paper's training set is from, grown in the virtual box.

Wahby et al. 2018, section "Dataset experiments": "six repetitions with a simplistic, non-reactive controller", which
switches the lamps every six hours, and "three repetitions with a closed-loop adaptive controller", which switches
"according to plant tip position"; a stem every five minutes. How long the runs are is not said: 72 h, the time in
which beans grow as high as its later experiments go.

Beside these, on request, runs under random light: whoever judges a simulator by them knows that it has not merely
learned the six-hour beat.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import FloatArray
from flora_common.light_schedule import parse_schedule
from flora_common.runs import LEVELS, Light, RunFile, TargetSection, run_file_text, track_text
from flora_common.tracks import Track
from flora_twin.box import camera_section
from flora_twin.grow import FRAME_S, stem_points_cm
from flora_twin.plant import STEP_S, Plants

OPEN_LOOP: Final = 6
CLOSED_LOOP: Final = 3
HOURS: Final = 72.0
SWITCH_SCHEDULE: Final = "6h"
DEADBAND_CM: Final = 0.5
TARGET_X_CM: Final = (2.0, 7.0)
TARGET_Y_CM: Final = 17.9
SMALLEST_PIXEL_CM: Final = 1e-4
"""A track is told to the micrometre; by a pixel near 0 a position divided by it is no number any more."""
DWELL_H: Final = (0.5, 10.0)
"""How long a lamp shines under random light, hours: from the shortest to the longest."""

Steering = Callable[[float, float, Light], Light]
"""From the time in s, the tip's x in cm and the lamp that shines, to the lamp that is to shine."""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A run that is to be grown.

    Attributes:
        name: of its folder.
        seed: the individual.
        run_file: its run.toml.
        steering: tells the lamps.
    """

    name: str
    seed: int
    run_file: RunFile
    steering: Steering

    def run_text(self) -> str:
        """``run.toml``."""
        return run_file_text(self.run_file)


@dataclass(frozen=True, slots=True)
class VirtualRun:
    """A run that was grown.

    Attributes:
        name: of its folder.
        run_file: its run.toml.
        track: what was measured.
    """

    name: str
    run_file: RunFile
    track: Track

    def track_text(self) -> str:
        """``track.csv``."""
        return track_text(self.track.time_s, self.track.light, self.track.points_cm)

    def run_text(self) -> str:
        """``run.toml``."""
        return run_file_text(self.run_file)


def tip_follower(target_x_cm: float) -> Steering:
    """The lamp on the target's side of the tip; it stays while the tip is within :data:`DEADBAND_CM`.

    flora-controller has the same rule by this name; services do not import one another.
    """

    def steer(_time_s: float, tip_x_cm: float, light: Light) -> Light:
        off_cm = tip_x_cm - target_x_cm
        if abs(off_cm) <= DEADBAND_CM and light in ("left", "right"):
            return light
        return "left" if off_cm > 0 else "right"

    return steer


def open_loop(schedule: str = SWITCH_SCHEDULE) -> Steering:
    """Lamps by time alone."""
    light_at = parse_schedule(schedule)
    return lambda time_s, _tip_x_cm, _light: light_at(time_s)


def random_schedule(individual: int, hours: float) -> str:
    """Left and right in turn, each for a time drawn uniformly from :data:`DWELL_H`, the first lamp by chance.

    Args:
        individual: the plant; the schedule follows from it alone.
        hours: how far the schedule goes at least; its last lamp stays on.

    Returns:
        Text for :func:`flora_common.light_schedule.parse_schedule`, to the second.
    """
    draw = np.random.default_rng([individual, 5])
    lamps = ["left", "right"] if draw.integers(2) == 0 else ["right", "left"]
    entries: list[str] = []
    end_h = 0.0
    while end_h < hours:
        dwell_h = float(draw.uniform(*DWELL_H))
        end_h += dwell_h
        entries.append(f"{lamps[len(entries) % 2]} {dwell_h:.4f}h")
    return ", ".join(entries)


def grow_steered(seeds: Sequence[int], steering: Sequence[Steering], hours: float) -> list[Track]:
    """Grow plants, each under the lamp that its steering chooses from its own stem every five minutes.

    Args:
        seeds: one per plant.
        steering: one per plant.
        hours: length of the run.

    Returns:
        One track per plant, without measuring error. ``light`` of a row shone before it; that of the first is ``dark``,
        as on a rig.
    """
    plants = Plants(seeds)
    rows = int(hours * 3600.0 // FRAME_S) + 1
    steps = round(FRAME_S / STEP_S)
    points: FloatArray = np.empty((plants.batch, rows, 10, 2))
    lights: list[list[Light]] = [["dark"] for _ in seeds]
    for row in range(rows):
        if row:
            levels = np.array([LEVELS[shone[-1]] for shone in lights])
            for _ in range(steps):
                plants.step(levels[:, 0], levels[:, 1], STEP_S)
        lines, used = plants.centreline_cm(), plants.segments
        for i, choose in enumerate(steering):
            points[i, row] = stem_points_cm(lines[i, : used[i] + 1])
            if row < rows - 1:
                lights[i].append(choose(plants.time_s, float(points[i, row, -1, 0]), lights[i][-1]))
    time_s = np.arange(rows, dtype=np.float64) * FRAME_S
    return [Track(time_s, tuple(shone), points[i], {}) for i, shone in enumerate(lights)]


def planned_runs(
    seed: int, *, open_loops: int, closed_loops: int, hours: float, random_loops: int = 0
) -> list[PlannedRun]:
    """The paper's dataset experiments with other plants, and runs under random light, before they are grown.

    Args:
        seed: the plants are the individuals ``seed``, ``seed + 1``, ...; the targets follow from it too.
        open_loops, closed_loops: how many of each.
        hours: length of every run.
        random_loops: how many open-loop runs under a random schedule, each under its own.

    Returns:
        The runs, open loop first, random light last. Targets of closed loops are 2 to 7 cm to the left or right in
        turn, 17.9 cm high.
    """
    draw = np.random.default_rng([seed, 4])
    targets = [
        TargetSection(x_cm=round((-1.0) ** (i + 1) * float(draw.uniform(*TARGET_X_CM)), 2), y_cm=TARGET_Y_CM)
        for i in range(closed_loops)
    ]
    counts = {"open": open_loops, "closed": closed_loops, "random": random_loops}
    names = [f"{kind}-{i + 1}" for kind, count in counts.items() for i in range(count)]
    wanted: list[TargetSection | None] = [*([None] * open_loops), *targets, *([None] * random_loops)]
    seeds = [seed + i for i in range(len(names))]
    steering = [
        *([open_loop()] * open_loops),
        *(tip_follower(target.x_cm) for target in targets),
        *(open_loop(random_schedule(individual, hours)) for individual in seeds[open_loops + closed_loops :]),
    ]
    return [
        PlannedRun(
            name,
            individual,
            RunFile(
                camera=camera_section(),
                rig="twin",
                plant=f"virtual bean, seed {individual}",
                interval_s=FRAME_S,
                target=target,
            ),
            steer,
        )
        for name, individual, target, steer in zip(names, seeds, wanted, steering, strict=True)
    ]


def dataset_runs(
    seed: int,
    *,
    open_loops: int,
    closed_loops: int,
    hours: float,
    random_loops: int = 0,
    pixel_cm: float = 0.0,
) -> list[VirtualRun]:
    """The runs of :func:`planned_runs`, grown without pictures.

    Args:
        seed, open_loops, closed_loops, hours, random_loops: as there.
        pixel_cm: tell tracks in whole pixels of this size, as from pictures that were made small; 0 tells them as they
            are.
    """
    planned = planned_runs(
        seed, open_loops=open_loops, closed_loops=closed_loops, hours=hours, random_loops=random_loops
    )
    tracks = grow_steered([run.seed for run in planned], [run.steering for run in planned], hours)
    return [
        VirtualRun(run.name, run.run_file, _in_pixels(track, pixel_cm) if pixel_cm else track)
        for run, track in zip(planned, tracks, strict=True)
    ]


def _in_pixels(track: Track, pixel_cm: float) -> Track:
    return Track(track.time_s, track.light, np.rint(track.points_cm / pixel_cm) * pixel_cm, track.covariates)
