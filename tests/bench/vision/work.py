"""One run through all methods: photographs are made, ours read them as they come, the other tools from a folder."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from bench.vision.figures import Found, RunScores, line_distances_mm, run_scores
from bench.vision.methods import METHODS
from drawings import drawn_run
from flora_common.arrays import FloatArray
from flora_common.runs import CameraSection
from flora_lab.threads import on_one_core
from truth_run import FULL_PX, TruthFrame, TruthRun, twin_run

FAMILIES: Final[dict[str, Callable[..., TruthRun]]] = {"twin": twin_run, "drawings": drawn_run}
OTHER_TOOLS: Final = ("skimage", "plantcv")
SCRIPT: Final = Path(__file__).with_name("other_tools.py")
WORST: Final = 12
APART_S: Final = 3600.0
ENDS_S: Final = 900.0
STRETCH_AT: Final = 2 / 3
"""Where in the run the stretch of consecutive frames begins: a plant that has leaves."""

Progress = Callable[[], None]
"""Called after every frame and method."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How much is done.

    Attributes:
        hours, every_s: of each run.
        every: every so many frames is judged by all methods,
        stretch: and so many consecutive ones.
        other_python: of the other tools' environment; None leaves them out.
        pictures: whether the worst frames are kept.
        size_px: width and height of the photographs.
    """

    hours: float
    every_s: float
    every: int
    stretch: int
    other_python: Path | None
    pictures: bool = False
    size_px: tuple[int, int] = FULL_PX

    def run(self, family: str, seed: int) -> TruthRun:
        """An individual's photographs."""
        return FAMILIES[family](seed, hours=self.hours, every_s=self.every_s, size_px=self.size_px)

    @property
    def frames(self) -> int:
        """Photographs per run."""
        return int(self.hours * 3600.0 / self.every_s + 1e-9) + 1

    def judged(self) -> list[int]:
        """The frames that all methods are judged on: spread, the stretch, and the first and last quarter-hour."""
        ends = min(self.frames, int(ENDS_S // self.every_s) + 1)
        chosen = {*range(0, self.frames, self.every), *self.stretch_frames()}
        return sorted(chosen | {*range(ends)} | {*range(self.frames - ends, self.frames)})

    def stretch_frames(self) -> range:
        """The consecutive frames."""
        first = min(round(STRETCH_AT * self.frames), max(0, self.frames - self.stretch))
        return range(first, min(self.frames, first + self.stretch))

    def steps(self) -> int:
        """How often :data:`Progress` is called per run."""
        return self.frames + (len(self.judged()) if self.other_python else 0)


@dataclass(frozen=True, slots=True, eq=False)
class BadFrame:
    """A frame that a method did badly on; ``mm`` is the mean distance, infinite without a stem."""

    run: str
    time_s: float
    jpeg: bytes
    camera: CameraSection
    true_cm: FloatArray
    found: Found
    mm: float


@dataclass(slots=True, eq=False)
class RunResult:
    """What came of one run.

    Attributes:
        scores: per method, on the frames that all are judged on.
        all_scores: per method that reads every frame, on every frame.
        worst: per method, its worst frames, worst first; none unless pictures are wanted.
        stretch: the consecutive frames; none unless time is to be measured by them.
    """

    family: str
    name: str
    scores: dict[str, RunScores] = field(default_factory=dict)
    all_scores: dict[str, RunScores] = field(default_factory=dict)
    worst: dict[str, list[BadFrame]] = field(default_factory=dict)
    stretch: list[TruthFrame] = field(default_factory=list)


@on_one_core()
def judge_run(
    family: str, seed: int, methods: Sequence[str], scale: Scale, progress: Progress, *, keep_stretch: bool = False
) -> RunResult:
    """Photograph one run and let every method read it."""
    run = scale.run(family, seed)
    judged = scale.judged()
    wanted = set(judged)
    result = RunResult(family, run.name)
    readers = {name: METHODS[name](run.camera, run.background) for name in methods if name in METHODS}
    found: dict[str, list[Found]] = {name: [] for name in readers}
    times_s: list[float] = []
    true_cm: list[FloatArray] = []
    with tempfile.TemporaryDirectory(prefix="flora-bench-") as name:
        folder = Path(name)
        write_background(folder, run)
        for number, frame in enumerate(run.frames()):
            times_s.append(frame.time_s)
            true_cm.append(frame.centreline_cm)
            for method, read in readers.items():
                found[method].append(read(frame.jpeg, frame.time_s))
                if scale.pictures:
                    bad = _bad_frame(run, frame.time_s, frame.jpeg, frame.centreline_cm, found[method][-1])
                    _keep_worst(result.worst.setdefault(method, []), bad)
            if number in wanted:
                (folder / "frames" / frame_name(number)).write_bytes(frame.jpeg)
            if keep_stretch and number in scale.stretch_frames():
                result.stretch.append(frame)
            progress()
        others = [name for name in methods if name in OTHER_TOOLS]
        if scale.other_python and others:
            seen, _ = run_other_tools(scale.other_python, folder, run.camera, judged, others, progress)
            for method, lines in seen.items():
                found[method] = [Found("no_stem", None)] * len(times_s)
                for i, one in zip(judged, lines, strict=True):
                    found[method][i] = one
                    if scale.pictures:
                        jpeg = (folder / "frames" / frame_name(i)).read_bytes()
                        bad = _bad_frame(run, times_s[i], jpeg, true_cm[i], one)
                        _keep_worst(result.worst.setdefault(method, []), bad)
    for method, of_method in found.items():
        result.scores[method] = run_scores(times_s, true_cm, of_method, judged)
        if method in readers:
            result.all_scores[method] = run_scores(times_s, true_cm, of_method, range(len(times_s)))
    return result


@dataclass(frozen=True, slots=True)
class Timing:
    """Medians in ms over the same frames, method and bare decode taken in turns, on one core."""

    method_ms: float
    decode_ms: float


@on_one_core()
def time_methods(
    family: str, seed: int, frames: Sequence[TruthFrame], methods: Sequence[str], scale: Scale
) -> dict[str, Timing]:
    """Time per full-size frame from the file's bytes to the stem, beside decoding the file and nothing more.

    Args:
        family, seed: the run,
        frames: and some consecutive ones of it. The first tenth is for warming up and not counted.
        methods, scale: as for :func:`judge_run`.
    """
    run = scale.run(family, seed)
    warm = -(-len(frames) // 10)
    out = {}
    for name in methods:
        if name not in METHODS:
            continue
        read = METHODS[name](run.camera, run.background)
        decode_ms, method_ms = [], []
        for frame in frames:
            began = time.perf_counter()
            cv2.imdecode(np.frombuffer(frame.jpeg, dtype=np.uint8), cv2.IMREAD_COLOR)
            decoded = time.perf_counter()
            read(frame.jpeg, frame.time_s)
            method_ms.append((time.perf_counter() - decoded) * 1e3)
            decode_ms.append((decoded - began) * 1e3)
        out[name] = Timing(float(np.median(method_ms[warm:])), float(np.median(decode_ms[warm:])))
    others = [name for name in methods if name in OTHER_TOOLS]
    if scale.other_python and others:
        with tempfile.TemporaryDirectory(prefix="flora-bench-") as temporary:
            folder = Path(temporary)
            write_background(folder, run)
            for number, frame in enumerate(frames):
                (folder / "frames" / frame_name(number)).write_bytes(frame.jpeg)
            _, ms = run_other_tools(scale.other_python, folder, run.camera, range(len(frames)), others, lambda: None)
        for name in others:
            out[name] = Timing(float(np.median(ms[name][warm:])), float(np.median(ms["decode"][warm:])))
    return out


def frame_name(number: int) -> str:
    return f"{number:05d}.jpg"


def write_background(folder: Path, run: TruthRun) -> None:
    """``background/`` of a run, and an empty ``frames/``."""
    for part in ("background", "frames"):
        (folder / part).mkdir()
    for number, jpeg in enumerate(run.background):
        (folder / "background" / frame_name(number)).write_bytes(jpeg)


def run_other_tools(
    python: Path, folder: Path, camera: CameraSection, frames: Sequence[int], tools: Sequence[str], progress: Progress
) -> tuple[dict[str, list[Found]], dict[str, FloatArray]]:
    """Let the other environment read photographs of a folder.

    Returns:
        Per tool what it found in each of ``frames``; and ms per frame, of each tool and of ``decode``.

    Raises:
        RuntimeError: its process failed.
    """
    told = {
        "anchor_px": camera.anchor_px,
        "px_per_cm": camera.px_per_cm,
        "frames": [frame_name(number) for number in frames],
    }
    (folder / "run.json").write_text(json.dumps(told), encoding="utf-8")
    out = folder / "found.npz"
    on_one_core = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with (folder / "stderr.txt").open("w+", encoding="utf-8") as said:
        process = subprocess.Popen(
            [python, SCRIPT, folder, out, "--tools", ",".join(tools)],
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
            env={**os.environ, **on_one_core},
        )
        assert process.stdout is not None
        for _ in process.stdout:
            progress()
        if process.wait() != 0:
            said.seek(0)
            raise RuntimeError(f"{SCRIPT.name} ended with {process.returncode}: {said.read()[-2000:]}")
    with np.load(out, allow_pickle=False) as stored:
        found = {}
        for tool in tools:
            ends = np.cumsum(stored[f"{tool}_counts"])
            lines = np.split(stored[f"{tool}_points"], ends[:-1])
            found[tool] = [Found("ok", line) if len(line) > 1 else Found("no_stem", None) for line in lines]
        return found, {name: stored[f"{name}_ms"] for name in (*tools, "decode")}


def _bad_frame(run: TruthRun, time_s: float, jpeg: bytes, true_cm: FloatArray, found: Found) -> BadFrame:
    mm = float("inf") if found.line_cm is None else float(line_distances_mm(found.line_cm, true_cm).mean())
    return BadFrame(run.name, time_s, jpeg, run.camera, true_cm, found, mm)


def _keep_worst(worst: list[BadFrame], new: BadFrame) -> None:
    """Up to 12 in which a stem was found and 4 in which none was, an hour apart so that they do not all show one."""
    empty = new.found.line_cm is None
    rivals = [
        bad
        for bad in worst
        if (bad.found.line_cm is None) == empty and bad.run == new.run and abs(bad.time_s - new.time_s) < APART_S
    ]
    if any(bad.mm >= new.mm for bad in rivals):
        return
    kept = sorted([*(bad for bad in worst if bad not in rivals), new], key=lambda bad: -bad.mm)
    without = [bad for bad in kept if bad.found.line_cm is None]
    worst[:] = without[: WORST // 3] + [bad for bad in kept if bad.found.line_cm is not None][:WORST]
