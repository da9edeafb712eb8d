"""Single faults of target and ledger: each is told, holds up nothing else, and all arrives when it is over."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from uploader_fakes import DAY_NS, Bench, heal, rot

from flora_common.errors import DiskFull, NasRefused, StoreError
from flora_uploader.config import UploaderSection
from flora_uploader.ledger_damage import LedgerDamaged


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.kill()


def fail_with(bench: Bench, call: str, error: StoreError) -> None:
    def at_call(_number: int, what: str) -> None:
        if what == call:
            # A new one each time: raised again, one keeps the frames of all times before, of other cases too.
            raise type(error)(*error.args)

    bench.target.at_call = at_call


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        ("create", NasRefused("/memory: the target refuses to be written"), "refuses"),
        ("write", DiskFull("/memory: the target is full"), "full"),
        ("sync", DiskFull("/memory: the target is full"), "full"),
    ],
)
def test_a_target_that_fails_is_told_once_and_work_resumes(
    bench: Bench, call: str, error: StoreError, words: str
) -> None:
    bench.photograph(1, b"one")
    bench.photograph(2, b"two")
    fail_with(bench, call, error)
    bench.work(300.0)
    assert bench.uploader.conditions.is_serious
    assert words in bench.uploader.conditions.sentence()
    assert not bench.target.files
    assert [stage for stage, _ in bench.stages()] == ["waiting"]
    bench.work(1200.0)
    assert 2 <= len(bench.events) <= 4  # every ten minutes
    assert bench.target.calls < 300
    heal(bench)
    bench.work(601.0)
    assert bench.uploader.waiting == 0
    assert not bench.uploader.conditions.is_serious


def test_a_target_that_is_gone_costs_little_and_is_greeted_when_back(bench: Bench) -> None:
    bench.config = UploaderSection(scan_every_s=7200.0)
    bench.restart()
    bench.target.is_there = False
    for number in range(1, 51):
        bench.photograph(number, b"%d" % number)
    bench.work(7 * 86_400.0)
    assert bench.target.calls < 7 * 24 * 6 + 20
    bench.target.is_there = True
    bench.work(601.0)
    assert bench.uploader.waiting == 0
    assert not bench.uploader.conditions.is_serious


def test_one_bad_file_does_not_hold_up_the_others(bench: Bench) -> None:
    bench.photograph(1, b"one", age_ns=100)
    bench.photograph(2, b"two")

    def at_call(_number: int, what: str) -> None:
        if what == "create" and bench.target.files.get("bean/frames/000002.jpg") is None and not bench.events:
            raise StoreError("/memory/bean/frames/000001.jpg: name too long")

    bench.target.at_call = at_call
    bench.work()
    assert bench.stages()[0] == ("refused", "frames/000001.jpg")
    assert bench.there("frames/000002.jpg") == b"two"
    bench.work(2.0)
    assert bench.uploader.waiting == 0
    assert not bench.uploader.conditions.is_serious


def test_a_refused_file_that_is_taken_away_is_no_trouble_any_more(bench: Bench) -> None:
    bench.work()  # all that there is besides
    bench.write("notes.txt", b"mine")

    def at_call(_number: int, what: str) -> None:
        if what == "create":
            raise StoreError("/memory/bean/notes.txt: something that is no plain file has this name")

    bench.target.at_call = at_call
    bench.work(600.0)
    assert "no plain file" in bench.uploader.conditions.sentence()
    (bench.run / "notes.txt").unlink()
    bench.work(7200.0)
    assert bench.uploader.waiting == 0
    assert bench.uploader.conditions.sentence() == ""


def test_a_damaged_read_back_never_gets_the_name(bench: Bench) -> None:
    path = bench.photograph(1, b"one")
    flipped: list[str] = []

    def at_call(_number: int, what: str) -> None:
        for name in bench.target.files:
            if what == "open" and name.endswith(".part") and not flipped:
                bench.target.files[name] = b"onf"
                flipped.append(name)

    bench.target.at_call = at_call
    bench.work()
    assert flipped
    assert bench.there(path) is None
    assert ("refused", path) in bench.stages()
    bench.work(2.0)
    assert bench.there(path) == b"one"


def test_a_flipped_byte_at_the_target_is_found_within_a_day_and_sent_again(bench: Bench) -> None:
    bench.config = UploaderSection(scan_every_s=7200.0)
    bench.restart()
    for number in range(1, 31):
        bench.photograph(number, b"picture %d" % number)
    bench.work()
    bench.target.files["bean/frames/000017.jpg"] = b"pictura 17"
    del bench.target.files["bean/frames/000018.jpg"]
    bench.work(86_400.0)
    assert bench.there("frames/000017.jpg") == b"picture 17"
    assert bench.there("frames/000018.jpg") == b"picture 18"
    assert bench.uploader.totals.found_damaged == 2
    assert bench.uploader.waiting == 0


def test_a_flipped_byte_is_told_when_the_spool_has_no_picture_any_more(bench: Bench) -> None:
    path = bench.photograph(1, b"one", age_ns=2 * DAY_NS)
    bench.work()
    bench.percent_free = 5.0
    bench.work(60.0)
    assert bench.state_of(path) == "freed"
    bench.target.files[f"bean/{path}"] = b"onf"
    bench.work(3600.0)
    assert bench.state_of(path) == "damaged"
    assert "damaged at the target" in bench.uploader.conditions.sentence()
    bench.target.files[f"bean/{path}"] = b"one"
    bench.restart()
    bench.work()
    assert bench.state_of(path) == "freed"


def test_a_target_that_is_the_spool_itself_is_refused(bench: Bench) -> None:
    path = bench.photograph(1, b"one", age_ns=2 * DAY_NS)
    bench.target.files[f"bean/{path}"] = b"one"
    bench.target.same_as = f"bean/{path}"
    bench.percent_free = 1.0
    bench.work(3600.0)
    assert (bench.run / path).exists()
    assert "not a copy" in bench.uploader.conditions.sentence()


def test_a_ledger_that_cannot_be_written_lets_all_rest(bench: Bench) -> None:
    bench.photograph(1, b"one")
    bench.work()
    bench.ledger._db.execute("PRAGMA query_only = 1")
    bench.photograph(2, b"two")
    bench.work(60.0)
    assert "ledger" in bench.uploader.conditions.sentence()
    bench.ledger._db.execute("PRAGMA query_only = 0")
    bench.work(700.0)
    assert bench.there("frames/000002.jpg") == b"two"
    assert not bench.uploader.conditions.is_serious


@pytest.mark.parametrize("call", ["connect", "rename done"])
def test_a_ledger_that_goes_bad_at_any_moment_is_not_waited_for(bench: Bench, call: str) -> None:
    bench.photograph(1, b"one")
    struck: list[str] = []

    def at_call(_number: int, what: str) -> None:
        if what == call and not struck:
            struck.append(what)
            rot(bench.ledger)

    bench.target.at_call = at_call
    with pytest.raises(LedgerDamaged, match="the ledger is damaged"):
        bench.work(3600.0)
    bench.uploader.abandon()
    told = bench.ledger.close_damaged(LedgerDamaged("damaged"))
    bench.ledger.close()
    assert "a new ledger was begun" in told
    bench.start()
    bench.work()
    assert bench.uploader.waiting == 0
    assert bench.there("frames/000001.jpg") == b"one"
    assert not [name for name in bench.target.files if "conflict" in name]
