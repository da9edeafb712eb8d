"""The uploader's daily work and its single faults, on a target in memory."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from uploader_fakes import DAY_NS, Bench, rot, sha

from flora_common.errors import DiskFull, NasRefused, StoreError
from flora_uploader.config import UploaderSection
from flora_uploader.ledger_damage import LedgerDamaged
from flora_uploader.transfer import CHUNK_BYTES, SYNC_BYTES, Order, transfer


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


def heal(bench: Bench) -> None:
    bench.target.at_call = lambda number, what: None


def test_every_file_of_record_arrives_and_nothing_else(bench: Bench) -> None:
    bench.photograph(1, b"one")
    bench.write("background/left.jpg", b"left")
    bench.write("bus/0001.mcap", b"messages")
    bench.write("bus/0002.mcap.open", b"still written")
    bench.write("track.csv", b"time_s\n")
    bench.write("truth/000001.json", b"{}")
    bench.write(".hidden", b"x")
    bench.write("frames/.000002.jpg.abc.part", b"x")
    bench.write("state.lock", b"x")
    (bench.run / "frames" / "link.jpg").symlink_to(bench.run / "run.toml")
    os.mkfifo(bench.run / "pipe")
    bench.write("frames/000001.jpg", b"older run", run=bench.spool / "older")
    bench.write("run.toml", b"[camera]\n", run=bench.spool / "older")
    bench.write("notes.txt", b"not a run", run=bench.spool / "no-run")
    bench.work()
    assert sorted(bench.target.files) == [
        "bean/.flora-owner",
        *("bean/background/left.jpg", "bean/bus/0001.mcap", "bean/frames.jsonl", "bean/frames/000001.jpg"),
        *(
            "bean/run.toml",
            "bean/track.csv",
            "bean/truth/000001.json",
            "older/.flora-owner",
            "older/frames/000001.jpg",
            "older/run.toml",
        ),
    ]
    assert bench.uploader.waiting == 0
    assert bench.uploader.stored == len(bench.target.files) - 2  # and two marks of whose they are
    assert not bench.target.renamed_unsynced
    stored = [event for event in bench.events if event.stage == "stored"]
    assert {event.sha256 for event in stored if event.path == "frames/000001.jpg"} == {sha(b"one"), sha(b"older run")}
    assert stored[0].destination.startswith("/memory/")


@pytest.mark.parametrize("size", [3 * SYNC_BYTES + 5, 2 * SYNC_BYTES, SYNC_BYTES - CHUNK_BYTES])
def test_no_step_of_a_copy_flushes_more_than_a_slow_link_takes_within_the_watchdogs_time(
    bench: Bench, size: int
) -> None:
    source = bench.write("bus/0001.mcap", bytes(size))
    calls: list[str] = []
    bench.target.at_call = lambda _number, what: calls.append(what)
    order = Order(source, "bean/bus/0001.mcap", "once", "", "0badcafe")
    unsynced = 0
    for _ in transfer(order, bench.target):
        step = [what for what in calls if what in ("write", "sync")]
        calls.clear()
        assert len(step) <= 1  # the loop that feeds the watchdog has its turn after each
        if step == ["write"]:
            unsynced += CHUNK_BYTES
        elif step == ["sync"]:
            assert unsynced <= SYNC_BYTES
            unsynced = 0
    assert unsynced == 0
    assert not bench.target.renamed_unsynced
    assert bench.there("bus/0001.mcap") == bytes(size)


def test_oldest_first_tables_last(bench: Bench) -> None:
    bench.photograph(3, b"3", age_ns=10)
    bench.photograph(1, b"1", age_ns=30)
    bench.photograph(2, b"2", age_ns=20)
    bench.write("track.csv", b"t\n", age_ns=DAY_NS)
    bench.work()
    order = [path for stage, path in bench.stages() if stage == "stored"]
    assert order[:3] == ["frames/000001.jpg", "frames/000002.jpg", "frames/000003.jpg"]
    assert set(order[3:]) == {"run.toml", "frames.jsonl", "track.csv"}


def test_an_announced_photograph_goes_without_a_scan(bench: Bench) -> None:
    bench.work()
    bench.write("frames/000001.jpg", b"fresh")
    bench.work()
    assert bench.there("frames/000001.jpg") is None
    bench.uploader.hear("bean", "frames/000001.jpg", sha(b"fresh"))
    bench.work()
    assert bench.there("frames/000001.jpg") == b"fresh"
    bench.uploader.hear("bean", "frames/000001.jpg", sha(b"fresh"))  # kept by the bus, heard again
    bench.uploader.hear("another", "frames/000009.jpg", sha(b"fresh"))
    bench.uploader.hear("bean", "frames/000009.jpg", sha(b"not there"))
    bench.work()
    assert [path for stage, path in bench.stages() if stage == "stored"].count("frames/000001.jpg") == 1


def test_tables_go_again_when_changed_but_not_more_often_than_asked(bench: Bench) -> None:
    bench.write("track.csv", b"a\n")
    bench.work()
    bench.write("track.csv", b"a\nb\n", age_ns=-1000)
    bench.work(100.0)
    assert bench.there("track.csv") == b"a\n"
    bench.work(600.0)
    assert bench.there("track.csv") == b"a\nb\n"
    assert not any("conflict" in path for path in bench.target.files)


def test_tables_go_at_a_polite_stop(bench: Bench) -> None:
    bench.write("track.csv", b"a\n")
    bench.work()
    bench.write("track.csv", b"a\nb\n", age_ns=-1000)
    bench.photograph(1, b"late")
    bench.uploader.begin_closing()
    while not bench.uploader.is_idle:
        bench.uploader.step()
    assert bench.there("track.csv") == b"a\nb\n"
    assert bench.there("frames/000001.jpg") == b"late"


def test_a_table_that_is_no_continuation_keeps_the_old_one(bench: Bench) -> None:
    bench.target.files["bean/track.csv"] = b"of another plant\n"
    bench.write("track.csv", b"a\n")
    bench.work()
    assert bench.there("track.csv") == b"a\n"
    assert bench.there(f"track.csv.conflict-{sha(b'of another plant' + bytes([10]))[:8]}") == b"of another plant\n"


def test_what_is_there_already_counts_after_it_was_read(bench: Bench) -> None:
    path = bench.photograph(1, b"same")
    bench.target.files[f"bean/{path}"] = b"same"
    bench.work()
    assert bench.state_of(path) == "stored"
    assert bench.uploader.totals.found_there == 1


def test_another_picture_of_that_name_is_kept(bench: Bench) -> None:
    path = bench.photograph(1, b"ours")
    bench.target.files[f"bean/{path}"] = b"theirs"
    bench.target.files[f"bean/{path}.conflict-{sha(b'theirs')[:8]}"] = b"earlier"
    bench.work()
    assert bench.there(path) == b"ours"
    assert bench.there(f"{path}.conflict-{sha(b'theirs')[:8]}") == b"earlier"
    assert bench.there(f"{path}.conflict-{sha(b'theirs')[:8]}-2") == b"theirs"
    assert any("kept as" in event.reason for event in bench.events)


def test_what_two_rigs_send_to_one_place_in_turn_is_kept_once(bench: Bench) -> None:
    path = bench.photograph(1, b"ours")
    aside = f"bean/{path}.conflict-{sha(b'theirs')[:8]}"
    bench.target.files |= {f"bean/{path}": b"theirs", aside: b"theirs"}
    bench.work()
    assert bench.there(path) == b"ours"
    assert bench.target.files[aside] == b"theirs"
    assert f"{aside}-2" not in bench.target.files
    assert any(f"kept as {aside}" in event.reason for event in bench.events)


def test_a_picture_that_is_not_what_the_camera_wrote_is_not_sent(bench: Bench) -> None:
    path = bench.photograph(1, b"whole")
    (bench.run / path).write_bytes(b"who")
    bench.target.files[f"bean/{path}"] = b"whole"
    bench.photograph(2, b"next")
    bench.work()
    assert bench.state_of(path) == "damaged"
    assert bench.there(path) == b"whole"
    assert bench.there("frames/000002.jpg") == b"next"
    assert ("refused", path) in bench.stages()
    assert bench.uploader.conditions.is_serious
    assert "not what the camera wrote" in bench.uploader.conditions.sentence()
    assert not [name for name in bench.target.files if name.endswith(".part")]
    bench.write(path, b"whole", age_ns=-5000)  # put right by hand
    bench.work(60.0)
    assert bench.state_of(path) == "stored"
    assert not bench.uploader.conditions.is_serious


def test_a_hash_announced_after_storing_is_compared(bench: Bench) -> None:
    bench.photograph(1, b"rotten", announce=False)
    bench.work()
    assert bench.state_of("frames/000001.jpg") == "stored"
    bench.write("frames.jsonl", json.dumps({"file": "frames/000001.jpg", "sha256": sha(b"good")}).encode() + b"\n")
    bench.work(60.0)
    assert bench.state_of("frames/000001.jpg") == "damaged"


def test_torn_and_strange_lines_of_the_frames_log_are_left_out(bench: Bench) -> None:
    bench.photograph(1, b"one")
    with (bench.run / "frames.jsonl").open("ab") as log:
        log.write(b'[]\n\xff\xfe\n{"file": 3}\n' + b"[" * 5000 + b'\n{"file": "frames/000001.jpg", "sha')
    bench.work()
    assert bench.uploader.waiting == 0


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


def test_names_that_are_no_text_are_told(bench: Bench) -> None:
    Path(os.fsdecode(os.fsencode(bench.run) + b"/frames/\xff.jpg")).write_bytes(b"x")
    bench.work()
    assert "not UTF-8" in bench.uploader.conditions.sentence()
    assert bench.uploader.waiting == 0


def test_a_run_folder_whose_name_is_no_text_is_told_and_the_others_go_on(bench: Bench) -> None:
    other = Path(os.fsdecode(os.fsencode(bench.run.parent) + b"/bean-\xff"))
    (other / "frames").mkdir(parents=True)
    (other / "run.toml").write_bytes((bench.run / "run.toml").read_bytes())
    (other / "frames" / "000001.jpg").write_bytes(b"x")
    file = bench.write("notes.txt", b"a" * 100)
    bench.work()
    assert bench.there("notes.txt") == file.read_bytes()
    sentence = bench.uploader.conditions.sentence()
    assert "1 files or run folders have names that are not UTF-8" in sentence
    assert "bean-" in sentence.encode().decode()


def test_the_present_run_folder_is_counted_once_where_its_name_is_no_text(bench: Bench) -> None:
    present = Path(os.fsdecode(os.fsencode(bench.run.parent) + b"/bean-\xff"))
    bench.run.rename(present)
    bench.run = present
    bench.restart()
    bench.work()
    assert "1 files or run folders have names that are not UTF-8" in bench.uploader.conditions.sentence()


def test_the_spools_disk_is_watched(bench: Bench) -> None:
    bench.work()
    assert bench.uploader.conditions.sentence() == ""
    for free, words, serious in ((45.0, "50 %", False), (19.0, "80 %", True), (4.0, "95 %", True)):
        bench.percent_free = free
        bench.work(11.0)
        assert words in bench.uploader.conditions.sentence()
        assert bench.uploader.conditions.is_serious is serious
    bench.percent_free = 80.0
    bench.work(11.0)
    assert bench.uploader.conditions.sentence() == ""


def test_another_target_starts_from_the_beginning(bench: Bench) -> None:
    bench.photograph(1, b"one")
    bench.work()
    bench.target.files.clear()
    bench.target.name = "/another"
    bench.restart()
    bench.work()
    assert bench.there("frames/000001.jpg") == b"one"


def test_a_frame_retaken_under_its_name_keeps_both(bench: Bench) -> None:
    bench.write("background/left.jpg", b"first")
    bench.work()
    bench.write("background/left.jpg", b"second", age_ns=-1000)
    bench.work(60.0)
    assert bench.there("background/left.jpg") == b"second"
    assert bench.there(f"background/left.jpg.conflict-{sha(b'first')[:8]}") == b"first"


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


def test_no_recheck_and_no_deletion_where_switched_off(bench: Bench) -> None:
    bench.config = UploaderSection(keep_percent_free=0.0, recheck_per_hour=0.0)
    bench.percent_free = 1.0
    bench.restart()
    path = bench.photograph(1, b"one", age_ns=9 * DAY_NS)
    bench.work(7200.0)
    assert (bench.run / path).exists()
    assert bench.uploader.totals.rechecked == 0
