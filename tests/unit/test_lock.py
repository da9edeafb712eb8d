"""A lock file: one holder, named, and gone with its process."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from flora_common.lock import AlreadyHeld, hold, hold_folder


def test_one_holder_at_a_time_and_the_second_is_told_whose_it_is(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    path.write_text("999999999 and what an older holder had to say\n")
    first = hold(path)
    assert path.read_text() == f"{os.getpid()}\n"
    with pytest.raises(AlreadyHeld) as by:
        hold(path)
    assert by.value.pid == str(os.getpid())
    os.close(first)
    os.close(hold(path))


def test_a_folder_has_one_holder_by_whatever_name_and_nothing_is_written_there(tmp_path: Path) -> None:
    folder, link = tmp_path / "run", tmp_path / "current"
    folder.mkdir()
    link.symlink_to(folder)
    held = hold_folder(link)
    with pytest.raises(AlreadyHeld):
        hold_folder(folder)
    assert list(folder.iterdir()) == []
    os.close(held)
    os.close(hold_folder(folder))


def test_what_is_no_number_is_not_repeated(tmp_path: Path) -> None:
    held = hold(tmp_path / "lock")
    (tmp_path / "lock").write_bytes(b"\x1b[2J\xff")
    with pytest.raises(AlreadyHeld, match="unknown"):
        hold(tmp_path / "lock")
    os.close(held)


def test_a_killed_holder_holds_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    code = f"import sys; from pathlib import Path; from flora_common.lock import hold; hold(Path({str(path)!r}))\n"
    code += "print('held', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(AlreadyHeld, match=str(holder.pid)):
            hold(path)
        holder.send_signal(signal.SIGKILL)
        holder.wait()
    os.close(hold(path))


@pytest.mark.parametrize("refusal", [errno.EROFS, errno.EACCES])
def test_on_a_disk_that_became_read_only_and_left_to_root_it_is_held_all_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusal: int
) -> None:
    path = tmp_path / "lock"
    path.write_text("an older holder\n")
    really = os.open

    def read_only(name: Path, flags: int, mode: int = 0o777) -> int:
        if flags & (os.O_RDWR | os.O_CREAT):
            raise OSError(refusal, os.strerror(refusal))
        return really(name, flags, mode)

    monkeypatch.setattr(os, "open", read_only)
    first = hold(path)
    with pytest.raises(AlreadyHeld):
        hold(path)
    os.close(first)
    with pytest.raises(OSError, match=os.strerror(refusal)):
        hold(tmp_path / "another")


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        hold(tmp_path / "none" / "lock")
