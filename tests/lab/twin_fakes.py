"""A `flora-twin` that grows nothing: it writes what the real one would, or fails as it might."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from flora_common.controller_file import load_controller
from flora_common.experiment_file import (
    FORMAT,
    Controller,
    ExperimentFile,
    Measured,
    Pictures,
    Really,
    write_experiment,
)
from flora_common.files import append_line, write_bytes, write_text
from flora_common.runs import CameraSection, ObstacleSection, RunFile, RunFolder, TargetSection, run_file_text
from flora_common.shapes import STEM_POINTS

RUN = "rig/runs/bean"
CALLS = "calls.jsonl"
"""Beside the program: one line for each time that it was started."""
PLAN = "plan.json"
"""Beside the program: how to behave, by seed: ``fail``, ``refuse``, ``other seed``, ``silent``, ``nothing``, ``torn``
with its third photograph torn, ``hang`` until told to end, ``meet N`` if the run of seed N is there at the same time,
else fail, or a signal that it sends to whoever started it, when those that hang do so, before it waits for its own
end."""
ENDED = "ended"
"""Beside the program: a line with the seed of each run that was told to end."""
MEETS_WITHIN_S = 30.0
TIPS = ((0.0, 7.0), (2.0, 13.0), (-1.0, 17.0), (-4.0, 17.5), (-6.0, 21.5))


def write_program(folder: Path, behaviour: dict[str, str] | None = None) -> Path:
    """An executable file that behaves so."""
    folder.mkdir(exist_ok=True)
    (folder / PLAN).write_text(json.dumps(behaviour or {}))
    program = folder / "flora-twin"
    here = Path(__file__).parent
    program.write_text(
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(here)!r})\n"
        "import twin_fakes\nsys.exit(twin_fakes.main(sys.argv))\n"
    )
    program.chmod(0o755)
    return program


def calls(program: Path) -> list[list[str]]:
    """The arguments of each start."""
    file = program.parent / CALLS
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def main(argv: list[str]) -> int:
    """The program."""
    folder = Path(argv[0]).parent
    append_line(folder / CALLS, json.dumps(argv[1:]))
    given = dict(argument[2:].split("=", 1) for argument in argv[2:] if "=" in argument)
    seed = int(given["seed"])
    plan = json.loads((folder / PLAN).read_text())
    behaviour = plan.get(str(seed), "")
    output = Path(given["output"])
    write_text(output / "rig" / "logs" / "flora-stem.log", "what the service said\n")
    if behaviour == "fail":
        print("starting\nflora-twin: flora-stem ended with status 1", file=sys.stderr)
        return 1
    if behaviour == "refuse":
        print("flora-twin: the controller is refused", file=sys.stderr)
        return 2
    if behaviour == "silent":
        return 1
    if behaviour.startswith("meet"):
        write_text(folder / f"here-{seed}", "")
        if not _is_there(folder / f"here-{behaviour.split()[1]}"):
            return 1
    if behaviour == "hang" or behaviour.startswith("SIG"):
        others = [folder / f"here-{other}" for other, how in plan.items() if how == "hang"]
        _wait_for_the_end(folder, seed, None if behaviour == "hang" else signal.Signals[behaviour], others)
    if behaviour == "nothing":
        return 0
    _write(output, given, seed + 1 if behaviour == "other seed" else seed)
    if behaviour == "torn":
        third = output / RUN / "frames" / "2.jpg"
        third.write_bytes(third.read_bytes()[:-50])
    return 0


def _is_there(file: Path) -> bool:
    end_s = time.monotonic() + MEETS_WITHIN_S
    while not file.exists() and time.monotonic() < end_s:
        time.sleep(0.01)
    return file.exists()


def _wait_for_the_end(folder: Path, seed: int, number: signal.Signals | None, others: list[Path]) -> None:
    def end(_number: int, _frame: object) -> None:
        append_line(folder / ENDED, str(seed))
        sys.exit(1)

    signal.signal(signal.SIGTERM, end)
    write_text(folder / f"here-{seed}", "")
    if number is not None and all(_is_there(other) for other in others):
        os.kill(os.getppid(), number)
    while True:
        time.sleep(0.01)  # signal.pause() would miss a signal that comes just before it


def _write(output: Path, given: dict[str, str], seed: int) -> None:
    target = TargetSection(*(float(part) for part in given["target"].split(",")))
    obstacle = ObstacleSection(*(float(part) for part in given["obstacle"].split(",")))
    camera = CameraSection(anchor_px=(80.0, 110.0), px_per_cm=4.0, width_px=160, height_px=120)
    run = RunFolder(output / RUN)
    write_text(run.run_toml, run_file_text(RunFile(camera=camera, target=target, obstacle=obstacle, interval_s=3600.0)))
    jpeg = cv2.imencode(".jpg", np.full((120, 160, 3), 60, dtype=np.uint8))[1].tobytes()
    write_bytes(run.background / "dark.jpg", jpeg)
    for k, tip in enumerate(TIPS):
        write_bytes(run.frames / f"{k}.jpg", jpeg)
        run.append_frame(f"frames/{k}.jpg", 3600.0 * k, "right")
        run.append_track(3600.0 * k, "right", np.outer(np.linspace(0.0, 1.0, STEM_POINTS), tip))
    write_bytes(output / "rig" / "nas" / "copy.jpg", jpeg)
    loaded = load_controller(Path(given["controller"]))
    at_target = 0.9 + 0.001 * (seed % 10)
    outcome = ExperimentFile(
        format=FORMAT,
        software="fake",
        controller=Controller(loaded.file.name, loaded.sha256),
        seed=seed,
        target=target,
        obstacle=obstacle,
        hours=float(given["hours"]),
        stop_height_cm=float(given["stop-height"]),
        measured=Measured(
            ended="height",
            ended_h=4.0,
            fitness_at_target=at_target,
            target_reached_h=3.0,
            fitness_at_end=0.8,
            best_fitness=0.95,
            clearance_cm=1.5,
            photographs=len(TIPS),
            stems=len(TIPS),
            lamp_changes=0,
        ),
        true=Really(1.25, 0.1, 0.2),
        pictures=Pictures(5, 0, 0, 0),
        restarts={},
        took_s=1.0,
        run=RUN,
    )
    write_experiment(output, outcome)
