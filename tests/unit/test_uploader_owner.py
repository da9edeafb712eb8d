"""Two rigs with one target and runs of one name: the second leaves the first one's files alone, and says why."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from uploader_fakes import DAY_NS, Bench, MemoryTarget

from flora_uploader.owner import MARK

THERE = f"bean/{MARK}"


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[tuple[Bench, Bench]]:
    target = MemoryTarget()
    first, second = (Bench(tmp_path / name, target) for name in ("first", "second"))
    yield first, second
    first.kill()
    second.kill()


def test_the_second_sends_nothing_and_says_so_in_one_line(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    first.photograph(1, b"of the first")
    second.photograph(1, b"of the second")
    first.work(60.0)
    before = dict(first.target.files)

    second.work(7200.0)
    first.work(7200.0)

    assert first.target.files == before
    assert not first.uploader.conditions.is_serious
    assert second.uploader.conditions.is_serious
    assert second.uploader.conditions.sentence() == (
        f"/memory/bean is another run of that name (of box1 on pi); nothing of {second.run} is sent: give "
        f"one of both rigs a target of its own, or delete bean/{MARK} there if all of it is this run's"
    )
    assert second.stages() == [("refused", "")]
    assert second.state_of("frames/000001.jpg") == "waiting"


def test_other_runs_of_the_second_go_on(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    first.work()
    second.write("run.toml", b"[camera]\n", run=second.spool / "pea")
    second.write("frames/000001.jpg", b"pea", run=second.spool / "pea")
    second.work(60.0)

    assert second.there("frames/000001.jpg", "pea") == b"pea"


def test_where_both_have_begun_already_the_one_that_was_marked_second_says_so_at_its_next_recheck(
    benches: tuple[Bench, Bench],
) -> None:
    first, second = benches
    for bench in benches:
        bench.photograph(1, b"the same for once")
        bench.work()
        first.target.files.pop(THERE)
    first.work(3600.0)
    second.work(3600.0)

    assert not first.uploader.conditions.is_serious
    assert "another run of that name" in second.uploader.conditions.sentence()


def test_nothing_of_the_second_is_deleted_from_its_spool(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    second.photograph(1, b"one", age_ns=9 * DAY_NS)
    second.work()
    second.target.files.pop(THERE)
    first.work(60.0)
    second.percent_free = 0.0
    second.work(3600.0)

    assert (second.run / "frames" / "000001.jpg").read_bytes() == b"one"


def test_a_lost_ledger_and_another_machine_change_nothing(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    first.photograph(1, b"one")
    first.work()
    shutil.rmtree(second.run)
    shutil.copytree(first.run, second.run)
    second.photograph(2, b"two")
    second.work(60.0)

    assert not second.uploader.conditions.is_serious
    assert second.there("frames/000002.jpg") == b"two"


def test_when_the_other_is_taken_away_the_second_goes_on_by_itself(benches: tuple[Bench, Bench]) -> None:
    first, second = benches
    first.work()
    second.photograph(1, b"of the second")
    second.work(60.0)
    first.target.files.clear()
    second.work(700.0)

    assert second.there("frames/000001.jpg") == b"of the second"
    assert not second.uploader.conditions.is_serious


@pytest.mark.parametrize("damage", [b"", b"{", b"\xff\x00", b'{"run": 3}'])
def test_a_damaged_mark_at_the_target_names_nobody_and_is_written_again(
    benches: tuple[Bench, Bench], damage: bytes
) -> None:
    first, _ = benches
    first.work()
    first.target.files[THERE] = damage
    first.photograph(1, b"one")
    first.work(60.0)

    assert first.target.files[THERE] == (first.run / MARK).read_bytes()
    assert first.there("frames/000001.jpg") == b"one"
    assert not first.uploader.conditions.is_serious


def test_a_run_folder_that_cannot_be_written_to_is_sent_where_nobody_is(
    benches: tuple[Bench, Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, data: bytes) -> None:
        raise PermissionError(path)

    first, second = benches
    monkeypatch.setattr("flora_uploader.owner.write_bytes", refused)
    first.photograph(1, b"one")
    first.work(60.0)
    assert first.there("frames/000001.jpg") == b"one"
    assert THERE not in first.target.files

    monkeypatch.undo()
    second.write("notes.txt", b"of the second")
    second.work(60.0)
    monkeypatch.setattr("flora_uploader.owner.write_bytes", refused)
    first.photograph(2, b"two")
    first.work(60.0)
    assert first.there("frames/000002.jpg") is None
    assert "another run of that name" in first.uploader.conditions.sentence()
