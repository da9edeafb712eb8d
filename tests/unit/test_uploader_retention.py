"""Making room never costs a photograph: a test that tries hard to have something unverified deleted."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from uploader_fakes import DAY_NS, Bench, Killed, sha

from flora_common.errors import NasUnreachable
from flora_uploader.config import UploaderSection
from flora_uploader.retention import disk_percent_free


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path, config=UploaderSection(scan_every_s=600.0, recheck_per_hour=0.0))
    yield bench
    bench.kill()


def old(bench: Bench, number: int, data: bytes, days: int = 3) -> str:
    return bench.photograph(number, data, age_ns=days * DAY_NS + number)


def in_spool(bench: Bench) -> set[str]:
    return {str(path.relative_to(bench.run)) for path in bench.run.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("places", "left", "percent"), [(1000, 20, 2.0), (1000, 900, 40.0), (0, 0, 40.0)], ids=["few", "many", "uncounted"]
)
def test_a_disk_without_places_for_files_is_as_full_as_one_without_room(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, places: int, left: int, percent: float
) -> None:
    disk = os.statvfs_result((4096, 4096, 100, 45, 40, places, left, left, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda folder: disk)
    assert disk_percent_free(tmp_path) == pytest.approx(percent)


def test_verified_photographs_make_room_oldest_first(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [old(bench, number, b"%d" % number) for number in (1, 2, 3, 4)]
    bench.work()
    deleted: list[str] = []
    unlink = Path.unlink

    def watched(self: Path, missing_ok: bool = False) -> None:
        deleted.append(self.name)
        unlink(self, missing_ok)
        bench.percent_free += 3.0

    monkeypatch.setattr(Path, "unlink", watched)
    bench.percent_free = 5.0
    bench.work(60.0)
    assert deleted == ["000004.jpg", "000003.jpg"]  # number 4 is the oldest here; 11 % free is enough
    assert [bench.state_of(path) for path in paths] == ["stored", "stored", "freed", "freed"]
    assert bench.uploader.stored == len(bench.target.files) - 1  # and the mark of whose they are


def test_nothing_else_is_ever_deleted(bench: Bench) -> None:
    old(bench, 1, b"1")
    bench.photograph(2, b"of today")
    for path in ("track.csv", "background/left.jpg", "bus/1.mcap", "frames/notes.txt", "pictures/old.jpg"):
        bench.write(path, path.encode(), age_ns=9 * DAY_NS)
    bench.work()
    bench.percent_free = 0.0
    bench.work(3600.0)
    assert in_spool(bench) == {
        *(
            ".flora-owner",
            "run.toml",
            "frames.jsonl",
            "track.csv",
            "background/left.jpg",
            "bus/1.mcap",
            "frames/notes.txt",
        ),
        *("pictures/old.jpg", "frames/000002.jpg"),
    }


@pytest.mark.parametrize("what", ["missing", "flipped", "cut", "gone", "spool file changed", "one file by two ways"])
def test_a_copy_that_is_not_proven_keeps_the_original(bench: Bench, what: str) -> None:
    path = old(bench, 1, b"picture")
    bench.work()
    copy = f"bean/{path}"
    bench.target.at_call = lambda number, call: None
    match what:
        case "missing":
            del bench.target.files[copy]
        case "flipped":
            bench.target.files[copy] = b"pictura"
        case "cut":
            bench.target.files[copy] = b"pict"
        case "gone":
            bench.target.is_there = False
        case "spool file changed":
            bench.write(path, b"newer!!", age_ns=2 * DAY_NS)
        case _:
            bench.target.same_as = copy
    # What would mend the copy is forbidden: only deletion could happen now.
    bench.uploader._next_upload = lambda now_s: None  # type: ignore[method-assign]
    bench.percent_free = 0.0
    bench.work(60.0)
    assert (bench.run / path).exists()


def test_a_copy_that_goes_bad_while_the_disk_fills_is_mended_before_room_is_made(bench: Bench) -> None:
    path = old(bench, 1, b"picture")
    bench.work()
    bench.target.files[f"bean/{path}"] = b"pictura"
    bench.percent_free = 0.0
    bench.work(60.0)
    assert bench.there(path) == b"picture"
    assert bench.state_of(path) == "freed"


@pytest.mark.parametrize("seed", range(5))
def test_no_photograph_is_ever_without_a_whole_copy(tmp_path: Path, seed: int) -> None:
    """Every photograph is, at every moment, whole in the spool or whole at the target, whatever fails or is killed."""
    chance = random.Random(seed)
    bench = Bench(tmp_path, config=UploaderSection(scan_every_s=50.0, recheck_per_hour=400.0))
    pictures: dict[str, bytes] = {}

    def whole_somewhere() -> None:
        for path, data in pictures.items():
            spool = bench.run / path
            assert bench.there(path) == data or (spool.exists() and spool.read_bytes() == data), path

    def at_call(_number: int, what: str) -> None:
        whole_somewhere()
        dice = chance.random()
        if dice < 0.01:
            raise Killed
        if dice < 0.04:
            raise NasUnreachable("/memory: gone")

    bench.target.at_call = at_call
    for number in range(1, 40):
        data = b"picture %d" % number * chance.randint(1, 9)
        pictures[old(bench, number, data, days=chance.choice((0, 2, 5)))] = data
        bench.percent_free = chance.choice((2.0, 9.0, 30.0))
        if number % 13 == 0:
            shutil.rmtree(bench.root / "state")  # the ledger is lost
            bench.kill()
            bench.start()
        try:
            bench.work(chance.choice((0.0, 30.0, 200.0)))
        except Killed:
            bench.kill()
            bench.start()
        whole_somewhere()
    bench.target.at_call = lambda number, what: None
    bench.work(3600.0)
    assert bench.uploader.waiting == 0
    assert {path: bench.there(path) for path in pictures} == pictures
    assert any(not (bench.run / path).exists() for path in pictures)
    bench.kill()


def test_a_ledger_that_lies_does_not_cost_a_photograph(bench: Bench) -> None:
    path = old(bench, 1, b"picture")
    bench.target.is_there = False
    bench.work()
    status = (bench.run / path).stat()
    entry = bench.ledger.get("bean", path)
    assert entry is not None
    bench.ledger.stored(entry, sha(b"picture"), status.st_size, status.st_mtime_ns, bench.clocks.utc_ns)
    bench.target.is_there = True
    bench.percent_free = 0.0
    bench.work(5.0)
    assert bench.there(path) == b"picture" or (bench.run / path).exists()
    bench.work(1200.0)
    assert bench.there(path) == b"picture"
