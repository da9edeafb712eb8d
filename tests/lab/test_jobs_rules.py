"""What a lab may be asked to do, and the book of it: nothing outside of its folder, nothing twice, nothing lost."""

from __future__ import annotations

import re
import typing
from pathlib import Path

import pytest
import typer

from flora_common import files
from flora_common.errors import BadInput, DiskFull, StoreError
from flora_common.messages import Job
from flora_lab.jobs import rules
from flora_lab.jobs.book import BOOK_FILE, MOST_KEPT, MOST_KILLED, MOST_WAITING, Book, Entry
from flora_lab.main import build_app

NOW = "2026-11-25T08:00:00Z"


def job(number: int, *arguments: str, work: str = "evolve", stop: bool = False) -> Job:
    return Job(job=f"{number:016x}", work=work, arguments=arguments, stop=stop)


# What may be asked


@pytest.mark.parametrize(
    "arguments",
    [
        ("bean.simulator", "--task", "left", "--runs", "20", "-o", "left"),
        ("nine/run01", "nine/run02", "--recipe", "mechanistic", "--output=bean.simulator"),
        ("-o", "a/b/c", "--seed=1", "-q"),
        ("tasks/own.toml", "a..b", "..."),
    ],
)
def test_what_stays_in_the_folder_is_taken(arguments: tuple[str, ...]) -> None:
    rules.check("evolve", arguments)


@pytest.mark.parametrize(
    "argument",
    [
        "/etc/passwd",
        "../other",
        "a/../../b",
        "..",
        "~/x",
        "~root",
        "--output=/tmp/x",
        "--output=../x",
        "-o/tmp/x",
        "-o../x",
        "--config=~/x",
        "a\\..\\b",
        "a\nb",
        "a\x00b",
        "--cluster",
        "--cluster=auto",
    ],
)
def test_what_leads_out_of_the_folder_or_to_other_machines_is_refused(argument: str) -> None:
    with pytest.raises(BadInput) as told:
        rules.check("evolve", ["bean.simulator", argument])
    assert "\n" not in str(told.value)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of all jobs: ``out`` is a link to a folder elsewhere, ``in`` to one in it."""
    made = tmp_path / "jobs"
    (made / "real").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (made / "out").symlink_to(tmp_path / "elsewhere")
    (made / "in").symlink_to("real")
    return made


@pytest.mark.parametrize(
    "arguments",
    [
        ("out/run", "-o", "out"),
        ("-o", "out/x"),
        ("-oout",),
        ("-qoout",),
        ("--output=out/x",),
        ("-o", "in", "--overlays", "out/seen"),
        ("-o", "in", "--contact=out/a.png"),
        ("-o", "in", "--film", "out/a.mp4"),
        ("--strip", "out/a.png"),
        ("--tensorboard", "out"),
        ("-o", "ou*"),
    ],
)
def test_nothing_is_written_through_a_link(folder: Path, arguments: tuple[str, ...]) -> None:
    asked = Book(folder).ask(job(1, *arguments), NOW)

    assert (asked.stage, "a link leads it out of the folder" in asked.text) == ("refused", True)


@pytest.mark.parametrize("arguments", [("out/run", "-o", "in/x"), ("-oreal",), ("out/*", "--output=new/a/b", "-q")])
def test_links_may_lead_to_what_is_read(folder: Path, arguments: tuple[str, ...]) -> None:
    assert Book(folder).ask(job(1, *arguments), NOW).stage == "waiting"


@pytest.mark.parametrize("work", ["publish", "keygen", "sign", "serve", "submit", "evovle", "", "rm"])
def test_what_needs_a_key_or_is_no_work_is_refused(work: str) -> None:
    with pytest.raises(BadInput, match="is no work for a lab"):
        rules.check(work, [])


@pytest.mark.parametrize("work", ["rollout", "evaluate", "rhythm"])
def test_what_shows_its_results_needs_a_folder_for_them(work: str) -> None:
    """A job has no screen: it was done, and what it had found was lost."""
    with pytest.raises(BadInput, match="name a folder for it with -o"):
        rules.check(work, ["x", "--json", "--offset=1"])
    for told in (["-o", "out"], ["-oout"], ["--output", "out"], ["--output=out"]):
        rules.check(work, ["x", *told])


def test_every_work_is_a_subcommand_and_those_that_go_on_take_the_option() -> None:
    group = typer.main.get_command(build_app())
    commands = group.commands  # type: ignore[attr-defined]
    assert set(rules.WORKS) <= set(commands)
    takes = {name for name in rules.WORKS for one in commands[name].params if rules.RESUME in one.opts}
    assert takes == set(rules.GO_ON)


# The book


def test_a_job_waits_its_turn_and_is_the_same_when_it_is_asked_for_again(tmp_path: Path) -> None:
    book = Book(tmp_path)
    first, second = (book.ask(job(n, "a"), NOW) for n in (1, 2))
    assert book.ask(job(1, "other"), NOW) is first
    assert [book.progress(one).before for one in (first, second)] == [0, 1]
    assert book.next() is first
    book.begins(first, NOW)
    told = book.progress(first, text="generations", share=0.5, took_s=3.0)
    assert (told.stage, told.share, told.text, told.took_s) == ("working", 0.5, "generations", 3.0)
    assert book.progress(second).before == 1
    book.ends(first, "done", "all\n is   well", utc=NOW, took_s=9.0)
    told = book.progress(first)
    assert (told.stage, told.share, told.text, told.took_s) == ("done", 1.0, "all is well", 9.0)
    assert book.next() is second
    assert book.progress(second).before == 0


def test_what_was_noted_is_there_after_a_restart_and_what_was_at_work_waits_again(tmp_path: Path) -> None:
    book = Book(tmp_path)
    entries = [book.ask(job(n, "bean.simulator"), NOW) for n in range(3)]
    book.begins(entries[0], NOW)
    again = Book(tmp_path)
    assert [one.stage for one in again.jobs] == ["waiting"] * 3
    entry = again.next()
    assert entry is not None
    assert entry.job == entries[0].job
    again.begins(entry, NOW)
    assert entry.command(tmp_path) == ["evolve", "bean.simulator", "--resume"]


@pytest.mark.parametrize("work", rules.WORKS)
def test_only_what_can_go_on_is_told_to(tmp_path: Path, work: str) -> None:
    book = Book(tmp_path)
    entry = book.ask(job(1, "x", work=work), NOW)
    book.begins(entry, NOW)
    assert entry.command(tmp_path) == [work, "x"]
    book.begins_later(entry)
    book.begins(entry, NOW)
    assert entry.command(tmp_path) == [work, "x", *(["--resume"] if work in ("track", "train", "evolve") else [])]


def test_who_says_resume_is_not_told_twice(tmp_path: Path) -> None:
    assert Entry("1", "train", ["x", "--resume"], attempts=2).command(tmp_path) == ["train", "x", "--resume"]


def test_patterns_stand_for_what_is_in_the_labs_folder(tmp_path: Path) -> None:
    for run in ("open-2", "open-1", "closed-1"):
        (tmp_path / "nine" / run).mkdir(parents=True)
    entry = Entry("1", "train", ["nine/open-*", "nothing/*", "-o", "--name=*", "bean.simulator"])
    wanted = ["train", "nine/open-1", "nine/open-2", "nothing/*", "-o", "--name=*", "bean.simulator"]
    assert entry.command(tmp_path) == wanted


def test_nonsense_is_refused_and_not_noted(tmp_path: Path) -> None:
    book = Book(tmp_path)
    for asked in (job(1, "/etc"), job(2, work="rm"), job(3, stop=True), job(4, work=rules.KNOWN)):
        entry = book.ask(asked, NOW)
        told = book.progress(entry)
        assert (told.stage, told.share, told.before) == ("refused", None, 0)
        assert told.text
    assert book.jobs == []
    assert not (tmp_path / BOOK_FILE).exists()


def test_too_many_are_refused_until_some_are_done(tmp_path: Path) -> None:
    book = Book(tmp_path)
    entries = [book.ask(job(n), NOW) for n in range(MOST_WAITING)]
    assert book.ask(job(1000), NOW).stage == "refused"
    book.ends(entries[0], "stopped", "", utc=NOW, took_s=0.0)
    assert book.ask(job(1000), NOW).stage == "waiting"


def test_the_oldest_that_are_over_are_forgotten(tmp_path: Path) -> None:
    book = Book(tmp_path)
    waits = book.ask(job(0), NOW)
    for n in range(1, MOST_KEPT + 11):
        book.ends(book.ask(job(n), NOW), "done", "", utc=NOW, took_s=0.0)
    assert len(book.jobs) == MOST_KEPT + 1
    assert book.jobs[0] is waits
    assert book.jobs[1].job == f"{11:016x}"


def test_without_room_a_job_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise DiskFull("no room")

    book = Book(tmp_path)
    monkeypatch.setattr(files, "write_bytes", full)
    with pytest.raises(DiskFull):
        book.ask(job(1), NOW)
    assert book.jobs == []


def test_a_job_for_whose_beginning_there_is_no_room_waits_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise DiskFull("no room")

    book = Book(tmp_path)
    entry = book.ask(job(1), NOW)
    with monkeypatch.context() as patch:
        patch.setattr(files, "write_bytes", full)
        with pytest.raises(DiskFull):
            book.begins(entry, NOW)
    assert book.next() is entry
    book.begins(entry, NOW)
    assert (entry.stage, entry.attempts) == ("working", 1)


def test_a_job_that_kills_the_lab_is_not_begun_for_ever_and_one_that_it_outlives_is(tmp_path: Path) -> None:
    Book(tmp_path).ask(job(1), NOW)
    for _ in range(5):  # a lab that is stopped says so
        book = Book(tmp_path)
        entry = book.next()
        assert entry is not None
        book.begins(entry, NOW)
        book.begins_later(entry)
    for _ in range(MOST_KILLED):
        book = Book(tmp_path)
        entry = book.next()
        assert entry is not None
        book.begins(entry, NOW)
    book = Book(tmp_path)
    assert book.next() is None
    told = book.progress(book.jobs[0])
    assert (told.stage, "killed 3 times" in told.text) == ("failed", True)


@pytest.mark.parametrize(
    "data", [b"", b"[]", b"{", b'{"jobs": [{"job": 1}]}', b'{"jobs": [{"job": "\xff"}]}', b"[" * 9999]
)
def test_a_book_that_is_none_is_told_in_a_line(tmp_path: Path, data: bytes) -> None:
    (tmp_path / BOOK_FILE).write_bytes(data)
    with pytest.raises(StoreError, match=re.escape(BOOK_FILE)):
        Book(tmp_path)


def test_the_stages_are_those_of_the_message() -> None:
    stages = set(typing.get_args(typing.get_type_hints(Entry)["stage"]))
    assert {"waiting", "working", "done", "refused", "failed", "stopped"} == stages
