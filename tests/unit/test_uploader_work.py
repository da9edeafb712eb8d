"""The uploader's daily work, on a target in memory."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from uploader_fakes import DAY_NS, Bench, sha

from flora_uploader.config import UploaderSection
from flora_uploader.transfer import CHUNK_BYTES, SYNC_BYTES, Order, transfer


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.kill()


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


def test_no_recheck_and_no_deletion_where_switched_off(bench: Bench) -> None:
    bench.config = UploaderSection(keep_percent_free=0.0, recheck_per_hour=0.0)
    bench.percent_free = 1.0
    bench.restart()
    path = bench.photograph(1, b"one", age_ns=9 * DAY_NS)
    bench.work(7200.0)
    assert (bench.run / path).exists()
    assert bench.uploader.totals.rechecked == 0
