"""An unfinished evolution is one process's at a time, and keeps how long commands have worked on it."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flora_common.errors import BadInput
from flora_common.lock import hold
from flora_lab.evolve import kept_runs
from flora_lab.evolve.kept_runs import LOCK_FILE, TIME_FILE, WORK_FILE, KeptRuns, Worked

WORK = {"seed": 1}


def ticking() -> Any:
    """A clock by which ten seconds pass between two looks."""
    return itertools.count(1000.0, 10.0).__next__


@contextlib.contextmanager
def begun(path: Path, *, resume: bool = False, force: bool = False, work: Any = WORK) -> Iterator[KeptRuns]:
    with KeptRuns(path, work, ticking()) as kept:
        kept.begin(resume=resume, force=force)
        yield kept


@pytest.mark.parametrize("options", [{}, {"resume": True}, {"force": True}])
def test_only_one_at_a_time(tmp_path: Path, options: dict[str, bool]) -> None:
    with begun(tmp_path / "e"):
        with pytest.raises(BadInput, match=f"process {os.getpid()} works in it"), begun(tmp_path / "e", **options):
            pass
        assert (tmp_path / "e" / WORK_FILE).is_file()
    with begun(tmp_path / "e", resume=True):
        assert (tmp_path / "e" / WORK_FILE).is_file()


def test_it_is_let_go_of_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), begun(tmp_path / "e"):
        raise RuntimeError
    for _ in range(2):
        with pytest.raises(BadInput, match="seed was 1 and is 2"), begun(tmp_path / "e", resume=True, work={"seed": 2}):
            pass


def test_a_folder_that_was_finished_meanwhile_is_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with begun(tmp_path / "e"):
        pass

    def too_late(path: Path) -> int:
        descriptor = hold(path)
        shutil.rmtree(path.parent)
        return descriptor

    monkeypatch.setattr(kept_runs, "hold", too_late)
    with pytest.raises(BadInput, match="has just ended; look what it wrote"), begun(tmp_path / "e", resume=True):
        pass


def test_killed_before_anything_was_kept_is_as_if_never_begun(tmp_path: Path) -> None:
    (tmp_path / "e").mkdir()
    (tmp_path / "e" / LOCK_FILE).write_text("1\n")
    (tmp_path / "e" / ".work.json.abc.part").write_text("{")
    with begun(tmp_path / "e") as kept:
        assert kept.worked.commands == 1
        assert (tmp_path / "e" / WORK_FILE).is_file()


def test_times_of_all_commands_are_added_up(tmp_path: Path) -> None:
    with begun(tmp_path / "e") as kept:
        assert kept.worked == Worked(1, 10.0)
        kept.save(1, b"")  # after 20 s
    with begun(tmp_path / "e", resume=True) as kept:
        assert kept.worked == Worked(2, 30.0)
    # a command that kept nothing leaves no trace
    with begun(tmp_path / "e", resume=True) as kept:
        kept.save(2, b"")
        assert kept.worked == Worked(2, 40.0)
    with begun(tmp_path / "e", resume=True) as kept:
        assert kept.worked == Worked(3, 40.0)
    with begun(tmp_path / "e", force=True, resume=True) as kept:  # what is to be replaced is the finished one
        assert kept.worked == Worked(3, 40.0)
    with begun(tmp_path / "e", force=True) as kept:
        assert kept.worked == Worked(1, 10.0)
        assert {path.name for path in (tmp_path / "e").iterdir()} == {LOCK_FILE, WORK_FILE}


@pytest.mark.parametrize(
    "damage", [b"", b'{"wall', b'{"\xff": 1}', b'{"commands": -1}', b'{"commands": 1, "wall": 2.0}']
)
def test_a_damaged_time_is_told(tmp_path: Path, damage: bytes) -> None:
    with begun(tmp_path / "e") as kept:
        kept.save(1, b"")
    (tmp_path / "e" / TIME_FILE).write_bytes(damage)
    with pytest.raises(BadInput, match=r"time.json: cannot be read; remove it"), begun(tmp_path / "e", resume=True):
        pass
    (tmp_path / "e" / TIME_FILE).unlink()
    with begun(tmp_path / "e", resume=True) as kept:
        assert kept.worked.commands == 1


@pytest.mark.parametrize(
    "damage", [b"", b"[]", b'{"\xff": 1}', b"[" * 100_000, b'{"seed": ' + b"[" * 1500 + b"]" * 1500 + b"}"]
)
def test_a_damaged_work_file_is_told_and_nothing_is_dropped(tmp_path: Path, damage: bytes) -> None:
    with begun(tmp_path / "e") as kept:
        kept.save(1, b"a run")
    (tmp_path / "e" / WORK_FILE).write_bytes(damage)
    said = r"e(/work\.json)?: (cannot be read|is damaged); give --force in place of --resume"
    with pytest.raises(BadInput, match=said), begun(tmp_path / "e", resume=True):
        pass
    assert (tmp_path / "e" / "run-01.json").read_bytes() == b"a run"
