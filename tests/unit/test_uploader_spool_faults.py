"""A spool whose files vanish, grow, cannot be read or have strange names: told, and the others go on."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from uploader_fakes import Bench, heal, sha

from flora_common.errors import StoreError


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.kill()


def test_a_vanished_picture_is_told_and_found_again(bench: Bench) -> None:
    bench.target.is_there = False
    path = bench.photograph(1, b"one")
    bench.work()
    (bench.run / path).unlink()
    bench.target.is_there = True
    bench.work(600.0)
    assert bench.state_of(path) == "vanished"
    assert "vanished from the spool" in bench.uploader.conditions.sentence()
    bench.write(path, b"one")
    bench.work(60.0)
    assert bench.there(path) == b"one"


def test_a_run_folder_that_goes_away_with_waiting_files_is_told(bench: Bench) -> None:
    bench.target.is_there = False
    older = bench.spool / "older"
    bench.write("run.toml", b"x", run=older)
    bench.write("frames/1.jpg", b"x", run=older)
    bench.work()
    older.rename(bench.root / "elsewhere")
    bench.target.is_there = True
    bench.work(7200.0)
    assert bench.state_of("frames/1.jpg", "older") == "vanished"
    assert "the run folder is gone" in bench.uploader.conditions.sentence()
    (bench.root / "elsewhere").rename(older)
    bench.work(3700.0)
    assert bench.there("frames/1.jpg", "older") == b"x"
    assert "is gone" not in bench.uploader.conditions.sentence()


class BadSectors:
    """Paths that a disk does not give out, nor anything below them."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.number = errno.EIO
        self.paths: list[Path] = []
        for name in ("stat", "lstat", "scandir", "open"):
            patch.setattr(os, name, self._bad_or(getattr(os, name)))

    def _bad_or(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def asked(path: Any, *arguments: Any, **keywords: Any) -> Any:
            if isinstance(path, str | Path) and any(Path(path).is_relative_to(bad) for bad in self.paths):
                raise OSError(self.number, os.strerror(self.number), str(path))
            return call(path, *arguments, **keywords)

        return asked


@pytest.fixture
def bad_sectors(monkeypatch: pytest.MonkeyPatch) -> BadSectors:
    return BadSectors(monkeypatch)


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOTCONN, errno.ESTALE, errno.EHOSTDOWN])
def test_a_run_folder_on_a_dead_mount_is_told_and_does_not_hold_up_the_others(
    bench: Bench, bad_sectors: BadSectors, number: int
) -> None:
    older = bench.spool / "older"
    for run in ("newer", "older"):
        bench.write("run.toml", b"x", run=bench.spool / run)
    bench.target.is_there = False
    bench.write("frames/1.jpg", b"x", run=older)
    bench.photograph(1, b"one")
    bench.work()
    bench.target.is_there = True
    bad_sectors.number, bad_sectors.paths = number, [older]
    bench.restart()
    bench.work(7200.0)
    assert bench.there("frames/000001.jpg") == b"one"
    assert bench.there("run.toml", "newer") == b"x"
    assert bench.state_of("frames/1.jpg", "older") == "waiting"
    assert bench.uploader.conditions.is_serious
    said = f"{older}: the run folder cannot be looked at ({os.strerror(number)})"
    assert bench.uploader.conditions.sentence().startswith(said)
    bad_sectors.paths.clear()
    bench.work(3700.0)
    assert bench.there("frames/1.jpg", "older") == b"x"
    assert bench.uploader.conditions.sentence() == ""


def test_a_run_folder_that_is_gone_is_told_beside_one_that_cannot_be_looked_at(
    bench: Bench, bad_sectors: BadSectors
) -> None:
    bench.target.is_there = False
    for run in ("away", "dead"):
        bench.write("run.toml", b"x", run=bench.spool / run)
    bench.work()
    (bench.spool / "away").rename(bench.root / "elsewhere")
    (bench.spool / "linked").symlink_to(bench.root / "elsewhere")
    bad_sectors.paths = [bench.spool / "dead", bench.root / "elsewhere"]
    bench.restart()
    bench.work(7200.0)
    assert bench.state_of("run.toml", "dead") == "waiting"
    assert bench.state_of("run.toml", "away") == "vanished"
    assert "(and 1 more such)" in bench.uploader.conditions.sentence()


def test_a_run_folder_whose_disk_fails_while_it_is_sent_waits(bench: Bench, bad_sectors: BadSectors) -> None:
    path = bench.photograph(1, b"one")
    bench.target.is_there = False
    bench.work()
    (bench.run / path).unlink()
    bench.target.is_there = True

    def at_call(_number: int, what: str) -> None:
        bad_sectors.paths = [bench.run / "run.toml"]

    bench.target.at_call = at_call
    bench.work(600.0)
    assert bench.state_of(path) == "waiting"
    assert "cannot be looked at" in bench.uploader.conditions.sentence()
    bench.uploader.begin_closing()
    while not bench.uploader.is_idle:
        bench.uploader.step()


def test_an_announcement_from_a_run_folder_on_a_dead_mount_is_an_expected_problem(
    bench: Bench, bad_sectors: BadSectors
) -> None:
    bad_sectors.paths = [bench.run]
    bench.work()
    with pytest.raises(StoreError, match="cannot be looked at"):
        bench.uploader.hear("bean", "frames/000001.jpg", sha(b"one"))


def test_a_folder_that_cannot_be_listed_does_not_hold_up_other_runs(bench: Bench, bad_sectors: BadSectors) -> None:
    for run in ("a", "z"):
        bench.write("run.toml", b"x", run=bench.spool / run)
        bench.write("frames/1.jpg", b"x", run=bench.spool / run)
    bad_sectors.paths = [bench.spool / "a" / "frames"]
    bench.restart()
    bench.work(60.0)
    assert bench.there("frames/1.jpg", "z") == b"x"
    assert f"{bad_sectors.paths[0]}: the spool cannot be listed" in bench.uploader.conditions.sentence()
    bad_sectors.paths.clear()
    bench.work(60.0)
    assert bench.there("frames/1.jpg", "a") == b"x"
    assert bench.uploader.conditions.sentence() == ""


def test_a_file_that_still_grows_waits_quietly(bench: Bench) -> None:
    file = bench.write("bus/0001.mcap", b"a" * 100)

    def at_call(_number: int, what: str) -> None:
        if what == "write" and "bus/0001.mcap" not in [path for _, path in bench.stages()]:
            with file.open("ab") as more:
                more.write(b"b")

    bench.target.at_call = at_call
    bench.work()
    assert bench.there("bus/0001.mcap") is None
    heal(bench)
    bench.work(60.0)
    assert bench.there("bus/0001.mcap") == file.read_bytes()
    assert "refused" not in [stage for stage, _ in bench.stages()]


@pytest.mark.parametrize("path", ["frames", ".", "link.jpg"])
def test_an_announcement_of_what_is_no_file_leaves_nothing_that_waits(bench: Bench, path: str) -> None:
    bench.photograph(1, b"one")
    (bench.run / "link.jpg").symlink_to("frames/000001.jpg")
    bench.work()
    bench.uploader.hear("bean", path, sha(b"one"))
    bench.work(60.0)
    assert bench.state_of(path) == "unknown"
    assert bench.uploader.waiting == 0
    assert bench.uploader.conditions.sentence() == ""


def test_a_file_of_a_year_that_the_ledger_cannot_hold_goes_as_others_do(bench: Bench) -> None:
    path = bench.photograph(1, b"one")
    late_ns = 12_000_000_000 * 1_000_000_000  # year 2350, which ext4 takes
    os.utime(bench.run / path, ns=(late_ns, late_ns))
    if (bench.run / path).stat().st_mtime_ns != late_ns:
        pytest.skip("this file system knows no such year")
    bench.work(60.0)
    assert (bench.there(path), bench.state_of(path)) == (b"one", "stored")
    bench.work(60.0)
    assert bench.stages().count(("stored", path)) == 1


def test_names_that_are_no_text_are_told(bench: Bench) -> None:
    Path(os.fsdecode(os.fsencode(bench.run) + b"/frames/\xff.jpg")).write_bytes(b"x")
    bench.work()
    assert "not UTF-8" in bench.uploader.conditions.sentence()
    assert bench.uploader.waiting == 0


def test_a_folder_that_lies_too_deep_is_told(bench: Bench) -> None:
    bench.write("1/2/3/4/5/6/7/8/there.txt", b"x")
    bench.work()
    assert bench.there("1/2/3/4/5/6/7/8/there.txt") == b"x"
    assert bench.uploader.conditions.sentence() == ""
    bench.write("1/2/3/4/5/6/7/8/9/not-there.txt", b"x")
    bench.work(3700.0)
    assert bench.uploader.conditions.sentence() == (
        "1 path of files or run folders not sent, for names that are not UTF-8 text, or more than 8 folders of depth: "
        "'1/2/3/4/5/6/7/8/9'"
    )


def test_a_run_folder_whose_name_is_no_text_is_told_and_the_others_go_on(bench: Bench) -> None:
    other = Path(os.fsdecode(os.fsencode(bench.run.parent) + b"/bean-\xff"))
    (other / "frames").mkdir(parents=True)
    (other / "run.toml").write_bytes((bench.run / "run.toml").read_bytes())
    (other / "frames" / "000001.jpg").write_bytes(b"x")
    file = bench.write("notes.txt", b"a" * 100)
    bench.work()
    assert bench.there("notes.txt") == file.read_bytes()
    sentence = bench.uploader.conditions.sentence()
    assert "1 path of files or run folders not sent, for names that are not UTF-8" in sentence
    assert "bean-" in sentence.encode().decode()


def test_the_present_run_folder_is_counted_once_where_its_name_is_no_text(bench: Bench) -> None:
    present = Path(os.fsdecode(os.fsencode(bench.run.parent) + b"/bean-\xff"))
    bench.run.rename(present)
    bench.run = present
    bench.restart()
    bench.work()
    assert (
        "1 path of files or run folders not sent, for names that are not UTF-8" in bench.uploader.conditions.sentence()
    )
