"""Accepted controllers on the disk: whole before and after every switch, whatever ends the process on the way."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from flora_common.controller_file import SUFFIX, LoadedController
from flora_common.errors import BadController, DiskFull
from flora_common.files import sha256_of_bytes
from flora_common.signing import signer_of
from flora_controller.shelf import MOST_KEPT, MOST_REMEMBERED, RECORD, Entry, GivenUp, Shelf, ShelfRecord
from signing_keys import ADA, signed, trusted

FILES = [signed(serial=number) for number in range(1, 6)]
EMPTY = ShelfRecord(base="waypoint")


def entry(loaded: LoadedController) -> Entry:
    return Entry(loaded.sha256, "0123456789abcdef", f"serial {loaded.file.serial}")


def put(shelf: Shelf, record: ShelfRecord, *loaded: LoadedController) -> ShelfRecord:
    """Each of these steers in turn."""
    for one in loaded:
        shelf.put(one)
        record = record.with_first(entry(one))
        shelf.write(record)
    return record


def kept(folder: Path) -> set[str]:
    return {path.name.removesuffix(SUFFIX) for path in folder.iterdir() if path.name != RECORD}


@pytest.fixture
def shelf(tmp_path: Path) -> Shelf:
    return Shelf(tmp_path)


def test_an_empty_shelf_is_no_trouble(shelf: Shelf) -> None:
    assert shelf.read(base="waypoint") == (EMPTY, "")


def test_what_was_put_there_is_found_again_whole(shelf: Shelf, tmp_path: Path) -> None:
    record = put(shelf, EMPTY, FILES[0])

    again, trouble = Shelf(tmp_path).read(base="waypoint")

    assert (again, trouble) == (record, "")
    assert shelf.load(FILES[0].sha256).data == FILES[0].data


def test_the_last_three_are_kept_and_nothing_else(shelf: Shelf, tmp_path: Path) -> None:
    record = put(shelf, EMPTY, *FILES)

    assert [e.sha256 for e in record.line] == [f.sha256 for f in reversed(FILES[-MOST_KEPT:])]
    assert kept(tmp_path) == {f.sha256 for f in FILES[-MOST_KEPT:]}


def test_a_candidate_is_kept_beside_the_three_and_goes_when_it_is_given_up(shelf: Shelf, tmp_path: Path) -> None:
    record = put(shelf, EMPTY, *FILES[:3])
    shelf.put(FILES[3])
    record = record.with_candidate(entry(FILES[3]))
    shelf.write(record)
    assert kept(tmp_path) == {f.sha256 for f in FILES[:4]}

    record = record.without(entry(FILES[3]), "flickers", note="gave up")
    shelf.write(record)

    assert kept(tmp_path) == {f.sha256 for f in FILES[:3]}
    given_up = record.given_up_of(FILES[3].sha256)
    assert given_up is not None
    assert given_up.reason == "flickers"
    assert record.note == "gave up"


def test_giving_up_the_first_puts_the_one_behind_it_first(shelf: Shelf) -> None:
    record = put(shelf, EMPTY, *FILES[:3]).without(entry(FILES[2]), "no answer", note="n")

    assert [e.sha256 for e in record.line] == [FILES[1].sha256, FILES[0].sha256]


def test_one_that_steers_again_is_in_the_line_once(shelf: Shelf) -> None:
    record = put(shelf, EMPTY, FILES[0], FILES[1], FILES[0])

    assert [e.sha256 for e in record.line] == [FILES[0].sha256, FILES[1].sha256]


def test_the_operators_choice_empties_the_line_and_forgets_no_failure(shelf: Shelf) -> None:
    record = put(shelf, EMPTY, *FILES[:2]).without(entry(FILES[1]), "r", note="n").on_base("dark", (), "by hand")

    assert (record.base, record.line, record.candidate, record.note) == ("dark", (), None, "")
    assert record.given_up_of(FILES[1].sha256) is not None


def test_the_operators_choice_gives_up_all_that_was_offered_and_could_be_accepted_again(shelf: Shelf) -> None:
    (steers, behind, trial, dropped, by_hand), other = FILES, f"{7:064x}"
    record = put(shelf, ShelfRecord(base=f"old name {by_hand.sha256}"), behind, steers).with_candidate(entry(trial))

    record = record.on_base(f"new {other}", (steers.sha256, dropped.sha256, by_hand.sha256, other), "by hand")

    assert {g.sha256 for g in record.given_up} == {f.sha256 for f in (steers, behind, trial, dropped)}
    assert {g.reason for g in record.given_up} == {"by hand"}
    assert record.given_up_of(steers.sha256) == GivenUp(steers.sha256, entry(steers).offer, "by hand")


def test_failures_are_remembered_up_to_a_bound() -> None:
    record = EMPTY
    for number in range(MOST_REMEMBERED + 5):
        record = record.without(Entry(f"{number:064x}", "0" * 16, "x"), "r" * 9999, note="n" * 9999)

    assert len(record.given_up) == MOST_REMEMBERED
    assert record.given_up_of(f"{4:064x}") is None
    assert record.given_up_of(f"{5:064x}") is not None
    assert len(record.note) == 500


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"{",
        b"\xff",
        b"[" * 9999,
        b'{"base": "x", "version": 2}',
        b'{"base": "x", "line": [{"sha256": "../../etc/passwd", "offer": "", "name": ""}]}',
    ],
)
def test_a_damaged_record_is_told_and_the_configured_controller_steers(
    shelf: Shelf, tmp_path: Path, damage: bytes
) -> None:
    (tmp_path / RECORD).write_bytes(damage)

    record, trouble = shelf.read(base="waypoint")

    assert record == EMPTY
    assert "the configured controller steers" in trouble


def test_a_file_that_was_damaged_or_is_gone_is_told(shelf: Shelf, tmp_path: Path) -> None:
    put(shelf, EMPTY, FILES[0])
    path = tmp_path / f"{FILES[0].sha256}{SUFFIX}"
    path.write_bytes(FILES[0].data.replace(b'"serial":1', b'"serial":2'))
    with pytest.raises(BadController, match="damaged since it was accepted"):
        shelf.load(FILES[0].sha256)
    path.unlink()
    with pytest.raises(BadController, match="cannot be read"):
        shelf.load(FILES[0].sha256)


def test_a_full_disk_leaves_the_old_state(shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = put(shelf, EMPTY, FILES[0])

    def no_room(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_room)
    with pytest.raises(DiskFull):
        shelf.put(FILES[1])
    with pytest.raises(DiskFull):
        shelf.write(record.with_first(entry(FILES[1])))
    monkeypatch.undo()

    assert shelf.read(base="waypoint") == (record, "")
    assert kept(tmp_path) == {FILES[0].sha256}


# Killed on the way

SWITCH = """
import builtins, os, pathlib, sys, tempfile
sys.path[:0] = {tests!r}
from flora_controller.shelf import Shelf
from test_controller_shelf import EMPTY, FILES, entry
shelf = Shelf(pathlib.Path({folder!r}))
before, _ = shelf.read(base="waypoint")
left = {point}
def counted(call):
    def counting(*arguments, **options):
        global left
        left -= 1
        if left == 0:
            os._exit(9)
        return call(*arguments, **options)
    return counting
for owner, name in ((os, "open"), (os, "fsync"), (os, "fchmod"), (os, "fdopen"), (os, "close"), (tempfile, "mkstemp"),
                    (pathlib.Path, "replace"), (pathlib.Path, "unlink"), (pathlib.Path, "iterdir")):
    setattr(owner, name, counted(getattr(owner, name)))
shelf.put(FILES[3])
shelf.write(before.with_first(entry(FILES[3])))
"""


def test_killed_at_any_file_operation_of_a_switch_the_old_or_the_new_state_stands_whole(tmp_path: Path) -> None:
    old_line = [f.sha256 for f in (FILES[2], FILES[1], FILES[0])]
    new_line = [f.sha256 for f in (FILES[3], FILES[2], FILES[1])]
    found: list[str] = []
    for point in range(1, 60):
        folder = tmp_path / str(point)
        put(Shelf(folder), EMPTY, *FILES[:3])
        script = SWITCH.format(
            tests=[str(path) for path in Path(__file__).parents[:2]], folder=str(folder), point=point
        )
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert done.returncode in (0, 9), done.stderr

        record, trouble = Shelf(folder).read(base="waypoint")
        line = [e.sha256 for e in record.line]
        assert trouble == ""
        assert line in (old_line, new_line)
        for sha256 in line:
            assert sha256_of_bytes(Shelf(folder).load(sha256).data) == sha256
        found.append("old" if line == old_line else "new")

        put(Shelf(folder), record, FILES[4])  # whatever was left lying about goes with the next switch
        assert kept(folder) == {FILES[4].sha256, *line[:2]}
        if done.returncode == 0:
            break
    print(f"\nkilled at {len(found) - 1} points: {found.count('old')} times the old state, else the new one")
    assert done.returncode == 0, "more operations than the test looks at"
    # Both sides of the one rename were looked at, and there is no way back behind it.
    assert found == sorted(found, reverse=True)
    assert found.count("old") >= 8
    assert found.count("new") >= 4


# Read while it is switched


def _read_while_switching(folder: Path, how_many: int) -> int:
    shelf = Shelf(folder)
    record = put(shelf, EMPTY, *FILES[:2])
    bad: list[str] = []
    is_over = threading.Event()
    reads = 0

    def read() -> None:
        nonlocal reads
        keys = trusted(ADA)
        while not is_over.is_set():
            try:
                raw = json.loads((folder / RECORD).read_bytes())
                loaded = shelf.load(raw["line"][0]["sha256"])
                signer_of(loaded, keys)
                assert raw["line"][0]["name"] == f"serial {loaded.file.serial}"
            except (OSError, ValueError, BadController, AssertionError) as problem:
                bad.append(repr(problem))
            reads += 1

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for number in range(how_many):
            record = record.with_first(entry(FILES[number % 2]))
            shelf.write(record)
    finally:
        is_over.set()
        reader.join()
    assert bad == []
    return reads


def test_a_reader_never_finds_half_a_switch(tmp_path: Path) -> None:
    """Neither a missing file, nor one with the other one's name or signature."""
    assert _read_while_switching(tmp_path, 1000) > 100


@pytest.mark.slow
def test_a_reader_never_finds_half_of_a_hundred_thousand_switches(tmp_path: Path) -> None:
    print(f"\n{_read_while_switching(tmp_path, 20_000)} reads during 20,000 switches, 0 missing, 0 mixed")
