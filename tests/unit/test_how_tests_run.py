"""How the tests themselves are run: in which order, and what they make once."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from file_order import spread
from made_once import Folder, made_once


def test_files_that_wait_come_among_those_that_work_and_quick_ones_last() -> None:
    files = ["contract/c1", "lab/l1", "lab/l2", "lab/l3", "lab/l4", "rig/r1", "rig/r2", "rig/r3", "unit/u1", "unit/u2"]
    items = [(Path("tests") / file, number) for file in files for number in range(2)]
    ordered = spread(items, lambda item: item[0])
    assert sorted(ordered) == sorted(items)
    names = [path.name for path, _ in ordered]
    assert names[::2] == names[1::2], "each file whole"
    assert "".join(name[0] for name in names[::2]) == "clrlrlrluu"
    assert [name for name in names[::2] if name[0] in "lu"] == ["l1", "l2", "l3", "l4", "u1", "u2"]


def test_what_is_made_once_is_made_by_the_first_and_read_by_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []

    def make() -> list[str]:
        made.append(1)
        time.sleep(0.1)
        return ["it"]

    monkeypatch.setattr(Folder, "path", None)
    assert [made_once("one", make), made_once("one", make)] == [["it"]] * 2
    assert len(made) == 2, "a process alone keeps what it wants to keep"
    monkeypatch.setattr(Folder, "path", tmp_path)
    found: list[list[str]] = []
    threads = [threading.Thread(target=lambda: found.append(made_once("two", make))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [["it"]] * 4
    assert len(made) == 3
    with pytest.raises(ZeroDivisionError):
        made_once("three", lambda: 1 // 0)
    assert made_once("three", lambda: 7) == 7
