"""The room kept for the ledger: given up on a full disk, made again when there is room."""

from __future__ import annotations

import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from flora_common.errors import StoreError
from flora_uploader import reserve
from flora_uploader.ledger import RESERVE_NAME, Ledger
from flora_uploader.ledger_damage import LedgerProblem
from flora_uploader.ledger_model import Found
from flora_uploader.reserve import RESERVE_BYTES, ROOM_TO_MAKE, Reserve


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with room for the reserve and a little more."""
    path = tmp_path / "small"
    path.mkdir()
    size = f"size={(ROOM_TO_MAKE + 2) * RESERVE_BYTES}"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(path)], capture_output=True)
    if mounted.returncode != 0:
        pytest.skip(f"needs to mount a tmpfs: {mounted.stderr.decode().strip()}")
    try:
        yield path
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


def fill(path: Path) -> None:
    with pytest.raises(OSError, match="No space left"), path.open("wb", buffering=0) as file:  # noqa: PT012
        while True:
            file.write(b"\0" * 4096)


def test_a_ledger_on_a_full_disk_opens_by_giving_its_reserve_up(small_disk: Path) -> None:
    folder = small_disk / "state"
    first = Ledger(folder, "/nas")
    first.reserve.make()
    assert (folder / RESERVE_NAME).stat().st_blocks * 512 >= RESERVE_BYTES
    first.close()
    fill(small_disk / "filler")

    ledger = Ledger(folder, "/nas")
    assert (ledger.id, ledger.gave_reserve, ledger.reserve.is_there) == (first.id, True, False)
    assert ledger.see("bean", [Found("frames/000001.jpg", "once", 1, 1)]) == ["frames/000001.jpg"]
    ledger.reserve.make()
    assert not ledger.reserve.path.exists()  # no room yet
    (small_disk / "filler").unlink()
    ledger.reserve.make()
    assert ledger.reserve.is_there
    ledger.close()
    again = Ledger(folder, "/nas")
    assert (again.gave_reserve, again.reserve.is_there) == (False, True)
    again.close()


def test_without_a_reserve_a_full_disk_is_told(small_disk: Path) -> None:
    folder = small_disk / "state"
    Ledger(folder, "/nas").close()
    fill(small_disk / "filler")
    for _ in range(2):  # and it lets go of its lock
        with pytest.raises(LedgerProblem, match="cannot be opened"):
            Ledger(folder, "/nas")


def no_room(*_: object) -> None:
    raise LedgerProblem("the ledger cannot be opened") from OSError(errno.ENOSPC, "No space left on device")


def test_whatever_names_a_full_disk_costs_the_reserve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reserve, "_room_bytes", lambda _: 1 << 30)
    first = Ledger(tmp_path, "/nas")
    first.reserve.make()
    first.close()
    monkeypatch.setattr(Ledger, "_open_or_replace", no_room)
    with pytest.raises(LedgerProblem):
        Ledger(tmp_path, "/nas")
    assert not (tmp_path / RESERVE_NAME).exists()


def test_another_problem_does_not_cost_the_reserve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reserve, "_room_bytes", lambda _: 1 << 30)
    first = Ledger(tmp_path, "/nas")
    first.reserve.make()
    with pytest.raises(StoreError, match="works with this ledger already"):
        Ledger(tmp_path, "/nas")
    first.close()
    (tmp_path / "uploader.sqlite3").unlink()
    (tmp_path / "uploader.sqlite3").mkdir()
    with pytest.raises(LedgerProblem, match="cannot be opened"):
        Ledger(tmp_path, "/nas")
    assert (tmp_path / RESERVE_NAME).stat().st_size == RESERVE_BYTES


def test_a_reserve_cut_short_by_a_kill_is_made_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reserve, "_room_bytes", lambda _: 1 << 30)
    kept = Reserve(tmp_path / RESERVE_NAME)
    kept.path.write_bytes(b"\0" * 1000)
    assert not kept.is_there
    kept.make()
    assert kept.is_there


@pytest.mark.parametrize("call", ["posix_fallocate", "fsync", "open"])
def test_a_reserve_that_cannot_be_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(reserve, "_room_bytes", lambda _: 1 << 30)
    kept = Reserve(tmp_path / RESERVE_NAME)
    with monkeypatch.context() as patch:
        patch.setattr(reserve.os, call, refuse)
        kept.make()
    assert list(tmp_path.iterdir()) == []
