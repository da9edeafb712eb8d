"""Folders that are there whole or not at all."""

from __future__ import annotations

import errno
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
