"""Files that are there whole or not at all: killed in between, on a full disk, after a torn line."""

from __future__ import annotations

import errno
import hashlib
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from flora_common import files
from flora_common.errors import DiskFull
from flora_common.files import append_line, atomic_writer, make_folder, sha256_of_file, write_bytes, write_text


def test_written_whole_with_its_folders(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "frame.jpg"
    write_bytes(path, b"x" * 100_000)
    assert path.read_bytes() == b"x" * 100_000
    assert path.stat().st_mode & 0o777 == 0o644
    assert list(path.parent.iterdir()) == [path]


def test_an_error_in_between_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "state"
    write_text(path, "old")
    with pytest.raises(ValueError, match="stop"), atomic_writer(path) as file:  # noqa: PT012
        file.write(b"new, half")
        raise ValueError("stop")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_killed_before_the_rename_leaves_the_old_file(tmp_path: Path, call: str) -> None:
    path = tmp_path / "state"
    write_text(path, "old")
    where = {"fsync": "os.fsync", "replace": "pathlib.Path.replace"}[call]
    module, _, name = where.rpartition(".")
    script = (
        f"import os, signal, pathlib\n"
        f"{module}.{name} = lambda *a, **k: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"from flora_common.files import write_text\n"
        f"write_text(pathlib.Path({str(path)!r}), 'new')\n"
    )
    done = subprocess.run([sys.executable, "-c", script])
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == "old"


def test_flushed_before_the_rename_and_the_folder_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    real_fsync, real_replace = os.fsync, Path.replace

    def fsync(descriptor: int) -> None:
        done.append("fsync folder" if os.path.isdir(f"/proc/self/fd/{descriptor}") else "fsync file")  # noqa: PTH112
        real_fsync(descriptor)

    def replace(self: Path, target: Any) -> Path:
        done.append("rename")
        return real_replace(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    write_text(tmp_path / "a", "x")
    assert done == ["fsync file", "rename", "fsync folder"]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_full_disk_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    path = tmp_path / "frame.jpg"
    write_text(path, "old")

    def full(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DiskFull, match=r"frame\.jpg: no room on the disk; free some space, nothing was overwritten"):
        write_text(path, "new")
    with pytest.raises(DiskFull, match=r"log\.csv: no room on the disk; the line was not added"):
        append_line(tmp_path / "log.csv", "1")
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert not list(tmp_path.glob(".*"))


def test_full_disk_is_told_even_where_no_name_can_be_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.tempfile, "mkstemp", full)
    with pytest.raises(DiskFull, match=r"frame\.jpg: no room on the disk"):
        write_text(tmp_path / "frame.jpg", "x")


def test_full_disk_for_real(tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(small)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"needs to mount a tmpfs: {mounted.stderr.decode().strip()}")
    try:
        write_bytes(small / "frame.jpg", b"old")
        with pytest.raises(DiskFull):
            write_bytes(small / "frame.jpg", b"x" * 200_000)
        assert [p.name for p in small.iterdir()] == ["frame.jpg"]
        assert (small / "frame.jpg").read_bytes() == b"old"
        write_bytes(small / "frame.jpg", b"new")
    finally:
        subprocess.run(["umount", str(small)], check=True)


def test_other_errors_stay_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OSError, match="File exists"):
        write_text(tmp_path / "file" / "inside", "x")


def test_what_was_asked_for_is_told_and_not_the_temporary_name() -> None:
    with pytest.raises(OSError, match=r"'/proc/flora\.txt'"):
        write_text(Path("/proc/flora.txt"), "x")


def test_lines_are_appended_under_one_header(tmp_path: Path) -> None:
    path = tmp_path / "new" / "frames.csv"
    for number in range(3):
        append_line(path, f"{number}", header="n")
    assert path.read_text() == "n\n0\n1\n2\n"


@pytest.mark.parametrize("torn", ["3,le", "x" * 10_000, "\0" * 5000])
def test_a_torn_last_line_is_cut_off(tmp_path: Path, torn: str) -> None:
    path = tmp_path / "track.csv"
    path.write_text("header\n1,left\n2,right\n" + torn)
    append_line(path, "3,left", header="header")
    assert path.read_text() == "header\n1,left\n2,right\n3,left\n"


def test_a_file_that_is_one_torn_line_starts_anew(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_text("hea")
    append_line(path, "1", header="header")
    assert path.read_text() == "header\n1\n"


@pytest.mark.parametrize("taken", [0, 4])
def test_a_line_for_which_there_is_no_room_leaves_nothing_of_itself(tmp_path: Path, taken: int) -> None:
    path = tmp_path / "frames.csv"
    append_line(path, "a,1,dark", header="file,time_s,light")
    before = path.read_bytes()
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + taken, most[1]))  # some of its bytes find room
    try:
        with pytest.raises(OSError, match="File too large"):
            append_line(path, "b,2,left")
        assert path.read_bytes() == before
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    append_line(path, "c,3,left")
    assert path.read_bytes() == before + b"c,3,left\n"


def test_a_line_that_may_not_be_on_the_disk_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    append_line(tmp_path / "log.csv", "1")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DiskFull, match="the line was not added"):
        append_line(tmp_path / "log.csv", "2")
    assert (tmp_path / "log.csv").read_text() == "1\n"


def test_hash_and_folder(tmp_path: Path) -> None:
    data = os.urandom(3 * files.CHUNK_BYTES + 5)
    (tmp_path / "x").write_bytes(data)
    assert sha256_of_file(tmp_path / "x") == hashlib.sha256(data).hexdigest()
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
