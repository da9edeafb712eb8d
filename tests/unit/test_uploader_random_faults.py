"""Random faults and deaths at any call: nothing lost, nothing torn, nothing twice."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from uploader_fakes import DAY_NS, Bench, Killed, sha

from flora_common.errors import DiskFull, NasRefused, NasUnreachable, StoreError
from flora_uploader.config import UploaderSection
from flora_uploader.owner import MARK

FAULTS = (
    NasUnreachable("/memory: gone"),
    NasRefused("/memory: read-only"),
    DiskFull("/memory: full"),
    StoreError("/memory/x: strange"),
)


class Story:
    """What the camera wrote, and what may therefore stand at the target."""

    def __init__(self, bench: Bench, chance: random.Random) -> None:
        self.bench = bench
        self.chance = chance
        self.pictures: dict[str, bytes] = {}
        self.table = b""

    def goes_on(self, number: int) -> None:
        data = self.chance.randbytes(self.chance.choice((1, 700, 1 << 20, (1 << 20) + 5)))
        path = self.bench.photograph(number, data)
        self.pictures[path] = data
        self.table += b"%d,left\n" % number
        self.bench.write("track.csv", self.table, age_ns=-number)
        if self.chance.random() < 0.7:
            self.bench.uploader.hear("bean", path, sha(data))

    def check_nothing_torn(self) -> None:
        for name, data in self.bench.target.files.items():
            path = name.removeprefix("bean/")
            if path.endswith(".part"):
                continue
            if path == "track.csv":
                assert self.table.startswith(data)
                assert data.endswith(b"\n")
            elif path == MARK:
                assert data == (self.bench.run / MARK).read_bytes()
            elif path in self.pictures:
                assert data == self.pictures[path], f"{path} is torn"
            else:
                assert path in ("run.toml", "frames.jsonl"), f"{path} is not known"
        assert not self.bench.target.renamed_unsynced


@pytest.mark.parametrize("seed", range(10))
def test_nothing_is_lost_torn_or_doubled(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    bench = Bench(tmp_path, config=UploaderSection(table_every_s=20.0, scan_every_s=10.0))
    story = Story(bench, chance)
    struck = 0
    lasting: list[StoreError] = []

    def at_call(_number: int, what: str) -> None:
        nonlocal struck
        dice = chance.random()
        struck += dice < 0.07
        if dice < 0.03:
            raise Killed
        if dice < 0.06:
            raise chance.choice(FAULTS)
        if dice < 0.07:
            lasting[:] = [chance.choice(FAULTS)]
        elif dice < 0.25:
            lasting.clear()
        if lasting:
            raise lasting[0]

    bench.target.at_call = at_call
    for number in range(1, 25):
        story.goes_on(number)
        try:
            bench.work(chance.choice((0.0, 5.0, 60.0)))
        except Killed:
            bench.kill()
            story.check_nothing_torn()
            bench.start()
        story.check_nothing_torn()
    bench.target.at_call = lambda number, what: None
    if chance.random() < 0.5:
        bench.restart()
    bench.work(2000.0)
    assert struck > 0
    assert bench.uploader.waiting == 0
    assert not bench.uploader.conditions.is_serious, bench.uploader.conditions.sentence()
    expected = {f"bean/{path}": data for path, data in story.pictures.items()}
    expected["bean/track.csv"] = story.table
    expected[f"bean/{MARK}"] = (bench.run / MARK).read_bytes()
    expected["bean/run.toml"] = (bench.run / "run.toml").read_bytes()
    expected["bean/frames.jsonl"] = (bench.run / "frames.jsonl").read_bytes()
    assert bench.target.files == expected  # no .part, no conflict, no double
    bench.kill()


def test_a_quiet_run_writes_every_picture_exactly_once(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    created: list[str] = []
    bench.target.at_call = lambda number, what: created.append(what) if what == "create" else None
    for number in range(1, 20):
        bench.photograph(number, b"%d" % number, age_ns=DAY_NS)
        bench.work(10.0)
        if number % 5 == 0:
            bench.restart()
    bench.work(1000.0)
    pictures = [path for stage, path in bench.stages() if stage == "stored" and path.endswith(".jpg")]
    assert sorted(pictures) == [f"frames/{number:06d}.jpg" for number in range(1, 20)]
    tables = [path for stage, path in bench.stages() if stage == "stored" and not path.endswith(".jpg")]
    assert len(created) == len(pictures) + len(tables) + 1  # and the mark of whose they are
    bench.kill()
