"""Damaged pictures against the stem finder: cut, flipped, black, foreign, a hand in view, two plants, and good ones.

    make fuzz-vision                                              10,000 pictures, some thirty-five minutes on two cores
    .venv/bin/python tests/bench/fuzz_vision.py --pictures 500    fewer

Each picture is read twice, decoded as the services do: by a tracker that has seen nothing before, and by one that has
followed good pictures five minutes apart up to the one that was damaged. The second is then shown the next good picture
and must find the plant again. A reading is *wrong* where its outcome is ``ok`` and its tip is farther from the true one
than 10 mm and three of its own standard deviations, or where no answer can be right; *far* where it is farther than
10 mm and says that it may be. Undamaged pictures go the same way
and tell what is the damage's fault: not what is wrong in them, too, and no tip within a millimetre of theirs.

A rig has noted the SHA-256 of each picture when it was taken, and neither flora-stem nor ``flora-lab track`` reads a
file that has another. What becomes of such files here is told as if nobody had noted it; where that is wrong, it is
tried with the hash, too. The exit status is 1 where any other damaged picture was read wrong, or any raised an error.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Final

TESTS = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TESTS))

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: E402
from rich.table import Table  # noqa: E402

from drawings.damage import AFTER_CAPTURE, KINDS, Damaged, damaged  # noqa: E402
from drawings.good import Good  # noqa: E402
from drawings.run import make_world  # noqa: E402
from flora_common.arrays import FloatArray  # noqa: E402
from flora_common.errors import BadPicture  # noqa: E402
from flora_common.files import sha256_of_bytes  # noqa: E402
from flora_common.runs import LIGHTS  # noqa: E402
from flora_common.vision.lamp_states import from_background  # noqa: E402
from flora_common.vision.path.memory import Memory  # noqa: E402
from flora_common.vision.path.tracker import PathTracker, Sight  # noqa: E402
from flora_common.vision.picture import Picture, decode_picture  # noqa: E402
from flora_common.vision.reading import NO_STEM, OK, StemReading  # noqa: E402
from flora_lab.threads import on_one_core  # noqa: E402
from truth_run import TruthFrame, twin_run  # noqa: E402

FIRST_SEED: Final = 70_001
SIZE_PX: Final = 1640, 1232
EVERY_S: Final = 300.0
FOLLOWED: Final = 4
"""Good pictures that a tracker has seen before the damaged one."""
CONFIDENT_TIP_MM: Final = 10.0
UNDAMAGED: Final = "undamaged"
FRESH, FOLLOWING, AFTER = "nothing before", "followed before", "the good one after"
MODES: Final = (FRESH, FOLLOWING, AFTER)
REFUSED, RIGHT, FAR, WRONG, OTHER, ENDED = "refused", "ok, right", "ok, far", "ok, WRONG", "other", "ENDED"
VERDICTS: Final = (REFUSED, NO_STEM, OTHER, RIGHT, FAR, WRONG, ENDED)
HASH_REFUSES: Final = "the hash refuses it"
WRONG_ANYWAY, SAME_TIP_MM = "undamaged as wrong", 1.0
"""Of those that are wrong: how many were so before they were damaged, or have their tip within this of where it was."""


@dataclass(frozen=True, slots=True)
class Source:
    """A good picture, and what a tracker knows when it comes to it.

    Attributes:
        good: it.
        time_s: when it was taken.
        memory: after the good pictures before.
        after: what the next one shows.
        after_cm: the true stem there.
    """

    good: Good
    time_s: float
    memory: Memory | None
    after: Sight
    after_cm: FloatArray


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one picture in one of the ``MODES``: one of ``VERDICTS``, and words for it."""

    seed: int
    number: int
    kind: str
    mode: str
    verdict: str
    words: str = ""


class Setting:
    """One plant in its setup, with a tracker and the good pictures that are to be damaged.

    Args:
        family: "drawn" or "twin".
        seed: which individual.
        sources: how many good pictures.
        size_px: of the drawn pictures; those of the twin have their own.
        hours: how old the plant becomes.
    """

    def __init__(
        self, family: str, seed: int, *, sources: int = 10, size_px: tuple[int, int] = SIZE_PX, hours: float = 72.0
    ) -> None:
        self.seed = seed
        rng = np.random.default_rng([seed, 7])
        latest = round(hours * 3600.0 / EVERY_S) - 1
        if family == "drawn":
            world = make_world(seed, hours=hours, size_px=size_px)
            self.camera, background = world.section, list(world.background())
            starts = np.sort(rng.choice(latest - FOLLOWED, sources, replace=False))
            stretches = [[world.frame(float((i + k) * EVERY_S)) for k in range(FOLLOWED + 2)] for i in starts]
        else:  # the box's pictures come in their order only, and slowly: one stretch of them
            run = twin_run(seed, hours=(FOLLOWED + sources) * EVERY_S / 3600.0 + 0.01)
            self.camera, background = run.camera, list(run.background)
            frames = list(run.frames())
            stretches = [frames[i : i + FOLLOWED + 2] for i in range(sources)]
        self.size_px = self.camera.width_px, self.camera.height_px
        self.tracker = PathTracker(from_background([self.decoded(jpeg) for jpeg in background]), self.camera)
        self.sources = [self._source(stretch, background) for stretch in stretches]

    def decoded(self, data: bytes, sha256: str | None = None) -> Picture:
        """As flora-stem and flora-lab decode them."""
        return decode_picture(data, where="picture", expected_size=self.size_px, sha256=sha256)

    def is_right_with_hash(self, picture: Damaged, mode: str) -> bool:
        """Whether it is not read wrong by who knows the hash of the picture that was taken."""
        source = self.sources[picture.source]
        if picture.kind not in AFTER_CAPTURE:
            return False
        try:
            self.decoded(picture.data, sha256_of_bytes(source.good.jpeg))
        except BadPicture:
            if mode != AFTER:
                return True
            self.tracker.memory = source.memory
            after = self.tracker.follow(source.after, source.time_s + EVERY_S)
            return verdict(after, source.after_cm)[0] != WRONG
        return False

    def _source(self, stretch: Sequence[TruthFrame], background: Sequence[bytes]) -> Source:
        *before, frame, after = stretch
        self.tracker.memory = None
        for earlier in before:
            self.tracker.read(self.decoded(earlier.jpeg), earlier.time_s)
        empty = background[LIGHTS.index(frame.light) * (len(background) // 4)]
        good = Good(frame.jpeg, frame.centreline_cm, empty, self.camera)
        sight = self.tracker.look(self.decoded(after.jpeg))
        return Source(good, frame.time_s, self.tracker.memory, sight, after.centreline_cm)

    def pictures(self, count: int) -> Iterator[Damaged]:
        """The good pictures as they are, then so many damaged ones."""
        goods = [source.good for source in self.sources]
        for i, good in enumerate(goods):
            yield Damaged(UNDAMAGED, good.jpeg, True, good.centreline_cm, i)
        yield from damaged(self.seed, count, goods)

    def results(self, count: int) -> Iterator[Result]:
        """What becomes of these pictures, three results each."""
        undamaged: dict[tuple[str, int], tuple[str, FloatArray | None]] = {}
        for number, picture in enumerate(self.pictures(count)):
            for mode, verdict, said, tip_cm in self.judged(picture):
                if picture.kind == UNDAMAGED:
                    undamaged[mode, picture.source] = verdict, tip_cm
                before, before_cm = undamaged[mode, picture.source]
                same_stem = picture.truth_cm is self.sources[picture.source].good.centreline_cm
                anyway = verdict == WRONG and (before == WRONG or (same_stem and is_same_tip(tip_cm, before_cm)))
                words = f"{said}; {WRONG_ANYWAY}" if anyway else said
                if verdict == WRONG and not anyway and self.is_right_with_hash(picture, mode):
                    words = f"{said}; {HASH_REFUSES}"
                yield Result(self.seed, number, picture.kind, mode, verdict, words)

    def judged(self, picture: Damaged) -> Iterator[tuple[str, str, str, FloatArray | None]]:
        """Mode, verdict, words, and the tip, for each mode."""
        source, truth_cm = self.sources[picture.source], picture.truth_cm
        memory = source.memory
        try:
            self.tracker.memory = None
            try:
                decoded = self.decoded(picture.data)
                fresh = self.tracker.read(decoded, source.time_s)
            except BadPicture as refusal:
                yield from ((mode, REFUSED, str(refusal), None) for mode in (FRESH, FOLLOWING))
            else:
                yield FRESH, *verdict(fresh, truth_cm)
                # as the rig does: near the place where the stem was, if that is enough
                self.tracker.memory = memory
                yield FOLLOWING, *verdict(self.tracker.read(decoded, source.time_s), truth_cm)
                memory = self.tracker.memory
            self.tracker.memory = memory
            after = self.tracker.follow(source.after, source.time_s + EVERY_S)
            yield AFTER, *verdict(after, source.after_cm)
        except Exception:  # noqa: BLE001 - whatever it is: a service would have ended
            yield FOLLOWING, ENDED, traceback.format_exc(), None


def verdict(reading: StemReading, truth_cm: FloatArray | None) -> tuple[str, str, FloatArray | None]:
    """One of ``VERDICTS``, words for it, and the tip, cm, where one was told without doubt."""
    if reading.outcome == NO_STEM:
        return NO_STEM, reading.reason, None
    if reading.outcome != OK or reading.points_cm is None or reading.uncertainty_mm is None:
        return OTHER, f"{reading.outcome}: {reading.reason}", None
    tip_cm = reading.points_cm[-1]
    if truth_cm is None:
        return WRONG, "where there is none", tip_cm
    off_mm = 10.0 * float(np.hypot(*(tip_cm - truth_cm[-1])))
    sure_mm = float(reading.uncertainty_mm[-1])
    words = f"tip {off_mm:.1f} mm off, said {sure_mm:.1f} mm"
    if off_mm <= CONFIDENT_TIP_MM:
        return RIGHT, words, tip_cm
    return (WRONG if off_mm > 3.0 * sure_mm else FAR), words, tip_cm


def is_same_tip(tip_cm: FloatArray | None, other_cm: FloatArray | None) -> bool:
    """Whether two readings end at one place."""
    if tip_cm is None or other_cm is None:
        return False
    return 10.0 * float(np.hypot(*(tip_cm - other_cm))) < SAME_TIP_MM


@on_one_core()
def fuzzed(family: str, seed: int, count: int) -> list[Result]:
    """Results of one individual; in a process of its own."""
    silenced = os.open(os.devnull, os.O_WRONLY)  # the JPEG library prints a line for each damaged file
    kept = os.dup(2)
    os.dup2(silenced, 2)
    try:
        return list(Setting(family, seed).results(count))
    finally:
        os.dup2(kept, 2)
        os.close(silenced)
        os.close(kept)


def table(mode: str, results: Sequence[Result]) -> Table:
    """How many of each kind of damage had each verdict."""
    out = Table(title=mode, title_justify="left")
    out.add_column("damage")
    for head in ("pictures", *VERDICTS, WRONG_ANYWAY, HASH_REFUSES):
        out.add_column(head, justify="right")
    mine = [r for r in results if r.mode == mode]
    spoilt = [r for r in mine if r.kind != UNDAMAGED]
    for kind, some in [(k, [r for r in mine if r.kind == k]) for k in (UNDAMAGED, *KINDS)] + [("all damaged", spoilt)]:
        count = Counter(r.verdict for r in some)
        anyway, refused = (sum(r.words.endswith(words) for r in some) for words in (WRONG_ANYWAY, HASH_REFUSES))
        if kind == "all damaged":
            out.add_section()
        numbers = (len(some), *(count[v] for v in VERDICTS), anyway, refused)
        out.add_row(kind, *(f"{n:,}" if n else "·" for n in numbers))
    return out


def main() -> int:
    options = parsed()
    each = 5 * len(KINDS)
    runs = max(1, -(-options.pictures // each))
    jobs = [("twin" if k % 10 == 9 else "drawn", options.first_seed + k) for k in range(runs)]
    results: list[Result] = []
    aside = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    context = multiprocessing.get_context("spawn")
    with Progress(*columns, console=aside) as progress, ProcessPoolExecutor(options.processes, context) as pool:
        bar = progress.add_task("damaged pictures", total=options.pictures)
        left, waiting = options.pictures, []
        for family, seed in jobs:
            waiting.append(pool.submit(fuzzed, family, seed, min(each, left)))
            left -= each
        for done in as_completed(waiting):
            some = done.result()
            results += some
            progress.advance(bar, sum(r.mode == AFTER and r.kind != UNDAMAGED for r in some))
    console = Console(width=None if sys.stdout.isatty() else 120)
    for mode in MODES:
        console.print(table(mode, results))
    bad = [r for r in results if r.verdict in (WRONG, ENDED) and r.kind != UNDAMAGED]
    for r in bad if options.list else []:
        console.print(f"seed {r.seed} picture {r.number}: {r.kind}, {r.mode}: {r.words}", highlight=False)
    mine = [r for r in bad if not r.words.endswith(WRONG_ANYWAY)]
    passed = [r for r in mine if not r.words.endswith(HASH_REFUSES)]
    console.print(
        f"{len(bad)} wrong readings, {len(mine)} of them by the damage; "
        f"{len(mine) - len(passed)} of these are of files that the hash at capture refuses"
    )
    return 1 if passed else 0


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Damaged pictures against the stem finder.")
    parser.add_argument("--pictures", type=int, default=10_000, help="how many damaged ones (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the individuals (default %(default)s)")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="name each picture that was read wrong")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
