"""Ended runs: found once, diagnosed once, told once; what fails is not tried for ever."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from flora_common import files
from flora_common.errors import DiskFull, StoreError
from flora_common.runs import CameraSection, RunFile, run_file_text
from flora_lab.serve.casebook import AGAIN_S, Casebook
from flora_lab.serve.child import Ended
from flora_lab.serve.finished import Lasting, Patience, finished
from flora_lab.serve.ledger import MOST_ATTEMPTS, Entry

NOW_S = 1_800_000_000.0
PATIENCE = Patience(settled_s=1800.0, settled_when_told_s=900.0)
NOBODY = Lasting("", 1e9, False)
OK = Ended(0, "")
DIAGNOSIS = {
    "verdict": "explained",
    "summary": "The stem bends under its own weight.",
    "causes": [
        {"effect": "sag", "confidence": 0.97, "parameters": {"weight": 0.7}, "interval": {"weight": [0.6, 0.8]}},
        {"effect": "draught", "confidence": 0.3, "parameters": {}, "interval": {}},
    ],
    "gain": {},
}


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    return tmp_path / "nas"


@pytest.fixture
def simulator(tmp_path: Path) -> Path:
    folder = tmp_path / "base.simulator"
    folder.mkdir()
    (folder / "simulator.toml").write_text("[provenance]\ntrack = []\n")
    return folder


def add_run(runs: Path, name: str, text: str = "a track", *, age_s: float = 4000.0, plant: str = "") -> Path:
    folder = runs / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "track.csv").write_text(text)
    os.utime(folder / "track.csv", (NOW_S - age_s, NOW_S - age_s))
    if plant:
        run_file = RunFile(camera=CameraSection((1.0, 2.0), 20.0), plant=plant)
        (folder / "run.toml").write_text(run_file_text(run_file))
    return folder


def opened(tmp_path: Path) -> Casebook:
    return Casebook(tmp_path / "found", lambda: "2027-01-15T08:00:00Z")


def scan(book: Casebook, runs: Path, lasting: Lasting = NOBODY) -> int:
    return book.add(finished("box1", runs, lasting, PATIENCE, NOW_S, book.ledger.knows))


def write_diagnosis(book: Casebook, entry: Entry, diagnosis: Any = DIAGNOSIS) -> None:
    book.folder_of(entry).mkdir(parents=True)
    (book.folder_of(entry) / "diagnosis.json").write_text(json.dumps(diagnosis))


def begun(book: Casebook, simulator: Path, now_s: float = 0.0) -> Entry:
    entry = book.next(simulator, now_s)
    assert entry is not None
    book.begins(entry)
    return entry


@pytest.mark.parametrize(
    ("lasting", "age_s", "is_found"),
    [
        (NOBODY, 4000.0, True),
        (NOBODY, 1000.0, False),  # its track may still grow
        (Lasting("bean", 60.0, False), 4000.0, False),  # the rig is at it
        (Lasting("bean", 1000.0, False), 4000.0, False),
        (Lasting("bean", 1000.0, True), 1000.0, True),  # the bus said that it is over
        (Lasting("bean", 2000.0, True), 600.0, False),  # but not all has come
        (Lasting("bean", 2000.0, False), 4000.0, True),  # the rig fell silent
        (Lasting("other", 1.0, False), 4000.0, True),
    ],
)
def test_a_run_has_ended_when_nothing_comes_any_more(
    tmp_path: Path, runs: Path, lasting: Lasting, age_s: float, is_found: bool
) -> None:
    add_run(runs, "bean", age_s=age_s)
    assert scan(opened(tmp_path), runs, lasting) == int(is_found)


def test_folders_that_are_no_runs_are_passed_over(tmp_path: Path, runs: Path) -> None:
    add_run(runs, ".bean.part")
    add_run(runs, "two words")
    (runs / "empty").mkdir()
    (runs / "file").write_text("")
    assert scan(opened(tmp_path), runs) == 0
    assert scan(opened(tmp_path), tmp_path / "not mounted") == 0


def test_a_run_that_may_not_be_read_is_told_and_hides_no_other(tmp_path: Path, runs: Path) -> None:
    for name in ("a-run", "b-private", "c-run"):
        add_run(runs, name)
    (runs / "b-private" / "track.csv").unlink()
    (runs / "b-private" / "track.csv").mkdir()  # for root, too, no file that can be read
    unreadable: list[str] = []
    found = finished("box1", runs, NOBODY, PATIENCE, 2 * NOW_S, lambda *_: False, on_unreadable=unreadable.append)
    assert [entry.run for entry in found] == ["a-run", "c-run"]
    assert unreadable == [f"{runs / 'b-private'}: cannot be read (Is a directory)"]


def test_a_disk_that_was_full_for_a_while_costs_no_attempt(
    tmp_path: Path, runs: Path, simulator: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise DiskFull("no room")

    add_run(runs, "bean-07")
    book = opened(tmp_path)
    scan(book, runs)
    with monkeypatch.context() as patch:
        patch.setattr(files, "write_bytes", full)
        for _ in range(MOST_ATTEMPTS + 1):
            with pytest.raises(DiskFull):
                begun(book, simulator)
    assert begun(book, simulator).attempts == 1


def test_a_run_is_diagnosed_once_and_told_once_whatever_is_killed(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "bean-07", plant="Saxa 7")
    book = opened(tmp_path)
    assert scan(book, runs) == 1
    entry = begun(book, simulator)
    assert book.arguments(entry, simulator)[:4] == ["diagnose", str(runs / "bean-07"), "--simulator", str(simulator)]
    write_diagnosis(book, entry)
    book = opened(tmp_path)  # killed after the folder was written, before the ledger knew
    assert book.next(simulator, 0.0) is None
    ((entry, message),) = book.unsaid()
    assert (message.run, message.plant, message.verdict) == ("bean-07", "Saxa 7", "explained")
    assert (message.causes, message.confidence) == (("sag", "draught"), (0.97, 0.3))
    assert message.path == str(book.folder_of(entry))
    book = opened(tmp_path)  # killed before it was said
    assert len(book.unsaid()) == 1
    book.said(book.unsaid()[0][0])
    book = opened(tmp_path)
    assert book.unsaid() == []
    assert scan(book, runs) == 0
    assert book.next(simulator, 0.0) is None


def test_the_record_tells_what_was_found_in_which_plant(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "bean-07", "one", plant="Saxa 7")
    add_run(runs, "bean-08", "two", plant="Sax|a <8>")
    book = opened(tmp_path)
    scan(book, runs)
    first = begun(book, simulator)
    write_diagnosis(book, first)
    book.ended(first, OK, 0.0)
    second = begun(book, simulator)
    book.ended(second, Ended(2, "track.csv: is 3.0 h long"), 0.0)
    lines = [json.loads(line) for line in (tmp_path / "found" / "found.jsonl").read_text().splitlines()]
    assert [(line["plant"], line["stage"]) for line in lines] == [("Saxa 7", "done"), ("Sax|a <8>", "failed")]
    assert lines[0]["causes"][0]["parameters"] == {"weight": 0.7}
    assert lines[1]["reason"] == "track.csv: is 3.0 h long"
    page = (tmp_path / "found" / "found.md").read_text()
    assert "## Saxa 7" in page
    assert "sag (97 %: weight 0.7); draught (30 %: )" in page
    assert f"[report]({first.name}/report.html)" in page
    assert "## Sax\\|a \\<8\\>" in page
    assert "not diagnosed" in page


def test_bad_input_fails_at_once_and_is_told_until_another_one_is_done(
    tmp_path: Path, runs: Path, simulator: Path
) -> None:
    add_run(runs, "short", "one")
    book = opened(tmp_path)
    scan(book, runs)
    book.ended(begun(book, simulator), Ended(2, "short: is 3.0 h long; at least 6 h are needed"), 0.0)
    assert book.next(simulator, 1e9) is None
    ((entry, message),) = book.unsaid()
    assert (message.verdict, message.sentence) == ("failed", "short: is 3.0 h long; at least 6 h are needed")
    book.said(entry)
    book = opened(tmp_path)
    assert book.trouble() == "box1/short could not be diagnosed: short: is 3.0 h long; at least 6 h are needed"
    assert book.unsaid() == []
    add_run(runs, "long", "two")
    scan(book, runs)
    entry = begun(book, simulator)
    write_diagnosis(book, entry)
    entry.when = ""
    book.ended(entry, OK, 0.0)
    assert book.trouble() == ""


def test_what_ends_without_a_word_is_tried_again_later_but_not_for_ever(
    tmp_path: Path, runs: Path, simulator: Path
) -> None:
    add_run(runs, "bean")
    book = opened(tmp_path)
    scan(book, runs)
    now_s = 0.0
    for attempt in range(1, MOST_ATTEMPTS + 1):
        entry = begun(book, simulator, now_s)
        assert entry.attempts == attempt
        book.ended(entry, Ended(-9, ""), now_s)
        assert book.next(simulator, now_s + 0.5 * AGAIN_S) is None
        now_s += AGAIN_S
    assert book.next(simulator, 1e9) is None
    assert [message.sentence for _, message in book.unsaid()] == ["it said nothing (signal 9)"]


def test_a_diagnosis_that_kills_the_machine_is_counted_and_one_that_was_stopped_is_not(
    tmp_path: Path, runs: Path, simulator: Path
) -> None:
    add_run(runs, "bean")
    scan(opened(tmp_path), runs)
    for _ in range(5):
        book = opened(tmp_path)
        book.given_up(begun(book, simulator))
    for _ in range(MOST_ATTEMPTS):
        begun(opened(tmp_path), simulator)
    book = opened(tmp_path)
    assert book.next(simulator, 0.0) is None
    assert [message.sentence for _, message in book.unsaid()] == ["the service was killed while it was diagnosed"]


def test_a_run_whose_track_has_changed_is_diagnosed_anew(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "bean", "short")
    book = opened(tmp_path)
    scan(book, runs)
    first = begun(book, simulator)
    write_diagnosis(book, first)
    book.ended(first, OK, 0.0)
    add_run(runs, "bean", "longer", age_s=3000.0)
    assert scan(book, runs) == 1
    assert begun(book, simulator).name != first.name
    add_run(runs, "bean", "longer", age_s=2500.0)  # the same again, written anew
    assert scan(book, runs) == 0
    assert book.ledger.entries[-1].track_mtime_ns == int((NOW_S - 2500.0) * 1e9)


def test_runs_that_the_simulator_was_learned_from_are_left_out(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "healthy", "one")
    add_run(runs, "other", "two")
    book = opened(tmp_path)
    scan(book, runs)
    own = book.ledger.entries[0].track_sha256
    (simulator / "simulator.toml").write_text(f'[provenance]\n[[provenance.track]]\nsha256 = "{own}"\n')
    entry = book.next(simulator, 0.0)
    assert entry is not None
    assert entry.run == "other"
    assert [e.stage for e in opened(tmp_path).ledger.entries] == ["left out", "waiting"]
    assert book.unsaid() == []


def test_a_diagnosis_that_is_none_has_failed(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "bean")
    book = opened(tmp_path)
    scan(book, runs)
    entry = begun(book, simulator)
    write_diagnosis(book, entry, {"verdict": "perhaps"})
    book.ended(entry, OK, 0.0)
    assert entry.stage == "failed"
    assert "its diagnosis.json is none" in entry.reason


def test_diagnoses_are_found_again_where_the_ledger_was_lost(tmp_path: Path, runs: Path, simulator: Path) -> None:
    add_run(runs, "bean")
    book = opened(tmp_path)
    scan(book, runs)
    entry = begun(book, simulator)
    write_diagnosis(book, entry)
    book.ended(entry, OK, 0.0)
    (tmp_path / "found" / "ledger.json").unlink()
    book = opened(tmp_path)
    scan(book, runs)
    assert book.next(simulator, 0.0) is None
    assert [e.stage for e in book.ledger.entries] == ["done"]


def test_something_else_in_the_ledgers_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "ledger.json").write_text("[]")
    with pytest.raises(StoreError, match="not a ledger of flora-lab"):
        opened(tmp_path)
