"""Folders that are there whole or not at all."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from flora_common.errors import DiskFull
from flora_common.files import whole_folder


def fill(path: Path, text: str, *, replace: bool = False) -> None:
    with whole_folder(path, replace=replace) as folder:
        (folder / "inner").mkdir()
        (folder / "inner" / "file").write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_it_appears_whole_with_its_parents(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b"
    with whole_folder(path) as folder:
        (folder / "file").write_text("x")
        assert not path.exists()
    assert names(tmp_path) == ["a", "a/b", "a/b/file"]


def test_an_error_in_between_leaves_nothing_or_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "data"
    for replace in (False, True):
        before = names(tmp_path)
        with pytest.raises(ValueError, match="stop"), whole_folder(path, replace=replace) as folder:  # noqa: PT012
            (folder / "file").write_text("half")
            raise ValueError("stop")
        assert names(tmp_path) == before
        if not replace:
            fill(path, "old")
    assert (path / "inner" / "file").read_text() == "old"


def test_an_old_folder_is_replaced_only_when_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "data"
    fill(path, "old")
    with pytest.raises(FileExistsError):
        fill(path, "new")
    assert (path / "inner" / "file").read_text() == "old"
    fill(path, "new", replace=True)
    assert (path / "inner" / "file").read_text() == "new"
    assert names(tmp_path) == ["data", "data/inner", "data/inner/file"]


def test_the_old_folder_comes_back_where_the_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "data"
    fill(path, "old")
    rename = Path.rename

    def fails(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise OSError(errno.EIO, "broken")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with pytest.raises(OSError, match="broken"):
        fill(path, "new", replace=True)
    assert (path / "inner" / "file").read_text() == "old"
    assert names(tmp_path) == ["data", "data/inner", "data/inner/file"]


def test_a_full_disk_is_told(tmp_path: Path) -> None:
    path = tmp_path / "data"
    with pytest.raises(DiskFull, match="data: no room on the disk"), whole_folder(path):
        raise OSError(errno.ENOSPC, "no space left")
    assert names(tmp_path) == []


MAKER = """
import sys, time
from pathlib import Path
from flora_common.files import whole_folder
path, aside = Path(sys.argv[1]), sys.argv[2] == "aside"
with whole_folder(path, replace=True) as folder:
    (folder / "file").write_text("half")
    if aside:
        path.rename(folder.parent / "old")
    print("working", flush=True)
    time.sleep(60)
"""


@contextmanager
def maker(path: Path, moment: str) -> Iterator[subprocess.Popen[str]]:
    """A process that makes this folder, and is not ready; killed at the end."""
    command = [sys.executable, "-c", MAKER, str(path), moment]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "working\n"
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


def test_what_a_killed_process_left_goes_with_the_next_one_and_what_a_living_one_makes_stays(tmp_path: Path) -> None:
    path = tmp_path / "data"
    with maker(path, "new"):
        fill(path, "meanwhile")
        assert len(list(tmp_path.glob(".data.*.part"))) == 1
    fill(tmp_path / "data.b", "another's name begins alike")
    assert len(list(tmp_path.glob(".data.*.part"))) == 1
    fill(path, "new", replace=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "data.b"]
    assert (path / "inner" / "file").read_text() == "new"


def test_an_old_folder_that_stepped_aside_for_one_that_never_came_is_put_back(tmp_path: Path) -> None:
    path = tmp_path / "data"
    fill(path, "old")
    with maker(path, "aside"):
        assert not path.exists()
    with pytest.raises(FileExistsError):
        fill(path, "new")
    assert (path / "inner" / "file").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["data"]
