"""The folder target on a real file system, the ledger on a real disk, the small rules, and the commands."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path

import pytest
from uploader_fakes import rot

from flora_common.errors import ConfigError, DiskFull, NasRefused, NasUnreachable, StoreError
from flora_uploader.ledger import Ledger
from flora_uploader.ledger_damage import LedgerDamaged, LedgerProblem
from flora_uploader.ledger_model import Found
from flora_uploader.main import main
from flora_uploader.policy import Backoff, Waits, disk_alert, is_of_record, is_photograph, kind_of
from flora_uploader.target import FolderTarget, store_error
from flora_uploader.transfer import Order, SourceDamaged, SourceUnreadable, is_temporary_name, temporary_path, transfer


@pytest.fixture
def nas(tmp_path: Path) -> Path:
    folder = tmp_path / "nas"
    folder.mkdir()
    (folder / ".flora-nas").touch()
    return folder


def send(nas: Path, source: Path, destination: str, *, expected: str = "") -> None:
    target = FolderTarget(nas, ".flora-nas")
    target.connect()
    try:
        for _ in transfer(Order(source, destination, "once", expected, "0badcafe"), target):
            pass
    finally:
        target.disconnect()


def test_a_file_arrives_whole(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x" * 3_000_000)
    send(nas, tmp_path / "a.jpg", "run/frames/a.jpg")
    assert (nas / "run/frames/a.jpg").read_bytes() == b"x" * 3_000_000
    assert [path.name for path in (nas / "run/frames").iterdir()] == ["a.jpg"]


def test_nothing_is_left_of_a_file_that_must_not_go(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x")
    with pytest.raises(SourceDamaged, match="not what the camera wrote"):
        send(nas, tmp_path / "a.jpg", "run/a.jpg", expected="0" * 64)
    assert not list((nas / "run").iterdir())


def test_an_empty_mount_point_is_not_written_to(nas: Path) -> None:
    (nas / ".flora-nas").unlink()
    with pytest.raises(NasUnreachable, match=r"marker file \.flora-nas is missing"):
        FolderTarget(nas, ".flora-nas").connect()
    FolderTarget(nas, "").connect()


def test_a_target_that_is_no_folder_is_unreachable(nas: Path) -> None:
    for path in (nas / "nowhere", nas / ".flora-nas"):
        with pytest.raises(NasUnreachable, match="not reachable"):
            FolderTarget(path, "").connect()


def test_a_target_swapped_while_connected_is_never_half_written(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x" * 3_000_000)
    target = FolderTarget(nas, ".flora-nas")
    target.connect()
    steps = transfer(Order(tmp_path / "a.jpg", "run/a.jpg", "once", "", "0badcafe"), target)
    next(steps)
    nas.rename(tmp_path / "away")
    nas.mkdir()
    for _ in steps:
        pass
    target.disconnect()
    assert not list(nas.iterdir())
    assert (tmp_path / "away/run/a.jpg").stat().st_size == 3_000_000


def test_an_abandoned_transfer_leaves_nothing(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x" * 3_000_000)
    target = FolderTarget(nas, ".flora-nas")
    target.connect()
    steps = transfer(Order(tmp_path / "a.jpg", "run/a.jpg", "once", "", "0badcafe"), target)
    next(steps)
    assert (nas / temporary_path("run/a.jpg", "0badcafe")).exists()
    steps.close()
    target.disconnect()
    assert not list((nas / "run").iterdir())


@pytest.mark.parametrize("name", ["n" * 251 + ".txt", "ä" * 125 + ".txt"])
def test_a_file_with_the_longest_name_that_there_is_arrives(nas: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    temporary = Path(temporary_path(f"run/{name}", "0badcafe")).name
    assert is_temporary_name(temporary, "0badcafe")
    send(nas, tmp_path / name, f"run/{name}")
    assert [path.name for path in (nas / "run").iterdir()] == [name]


def test_something_else_under_the_name_is_told(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x")
    (nas / "run/a.jpg").mkdir(parents=True)
    with pytest.raises(StoreError, match="no plain file"):
        send(nas, tmp_path / "a.jpg", "run/a.jpg")


def test_a_link_of_the_target_to_the_spool_is_no_copy(nas: Path, tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x")
    (nas / "run").mkdir()
    os.link(tmp_path / "a.jpg", nas / "run/a.jpg")
    with pytest.raises(StoreError, match="not a copy"):
        send(nas, tmp_path / "a.jpg", "run/a.jpg")


@pytest.mark.parametrize("call", [1, 2])
def test_a_disk_that_does_not_tell_of_an_open_file_is_the_files_own_problem(
    nas: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x")
    real, asked = os.fstat, []

    def stale(descriptor: int) -> os.stat_result:
        asked.append(descriptor)
        if len(asked) == call:
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        return real(descriptor)

    open_before = len(list(Path("/proc/self/fd").iterdir()))
    monkeypatch.setattr(os, "fstat", stale)
    with pytest.raises(SourceUnreadable, match="Stale file handle"):
        send(nas, tmp_path / "a.jpg", "run/a.jpg")
    monkeypatch.undo()
    assert len(list(Path("/proc/self/fd").iterdir())) == open_before


def test_a_dead_target_beside_the_runs_does_not_end_the_start(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nas = config.parent / "runs" / "nas"
    nas.mkdir()
    config.write_text(config.read_text().replace(f'target = "{config.parent}/nas"', f'target = "{nas}"'))
    real = os.stat

    def dead(path: object, *arguments: object, **keywords: object) -> os.stat_result:
        if str(path).startswith(str(nas)):
            raise OSError(errno.ENOTCONN, os.strerror(errno.ENOTCONN))
        return real(path, *arguments, **keywords)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "stat", dead)
    assert main(["--config", str(config), "--check-config"]) == 0
    assert "good" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("number", "kind", "words"),
    [
        (errno.ENOSPC, DiskFull, "is full"),
        (errno.EDQUOT, DiskFull, "is full"),
        (errno.EROFS, NasRefused, "refuses"),
        (errno.EACCES, NasRefused, "refuses"),
        (errno.EPERM, NasRefused, "refuses"),
        (errno.ENOENT, NasUnreachable, "not reachable"),
        (errno.ENOTDIR, NasUnreachable, "not reachable"),
        (errno.ESTALE, NasUnreachable, "not reachable"),
        (errno.EIO, NasUnreachable, "not reachable"),
        (errno.ENAMETOOLONG, StoreError, "/nas/run/a.jpg"),
    ],
)
@pytest.mark.parametrize("call", ["open", "write", "fsync", "rename", "mkdir"])
def test_what_the_system_says_becomes_one_sentence(
    nas: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    call: str,
    number: int,
    kind: type[StoreError],
    words: str,
) -> None:
    (tmp_path / "a.jpg").write_bytes(b"x")
    real = getattr(os, call)

    def failing(*arguments: object, **keywords: object) -> object:
        # The spool is opened without, the target relative to its folder.
        if call != "open" or (keywords.get("dir_fd") is not None and arguments[0] != "."):
            raise OSError(number, os.strerror(number))
        return real(*arguments, **keywords)

    monkeypatch.setattr(os, call, failing)
    with pytest.raises(kind) as caught:
        send(nas, tmp_path / "a.jpg", "run/a.jpg")
    monkeypatch.undo()
    assert words in str(store_error(OSError(number, "why"), "/nas", "run/a.jpg"))
    assert "\n" not in str(caught.value)
    assert not [path for path in nas.rglob("*") if path.name == "a.jpg"]


def test_rules_of_names() -> None:
    assert is_of_record("000001.jpg")
    assert not any(is_of_record(name) for name in (".x", "x.part", "x.open", "x.lock"))
    assert [kind_of(path) for path in ("frames/1.jpg", "bus/1.mcap", "report.png", "background/x")] == ["once"] * 4
    assert [kind_of(path) for path in ("run.toml", "frames.csv", "truth/1.json", "frames")] == ["table"] * 4
    assert is_photograph("frames/1.jpg")
    assert not any(is_photograph(path) for path in ("frames/1.csv", "background/1.jpg", "frames.jpg", "x/frames/1.jpg"))


def test_waits_double_up_to_ten_minutes_and_start_again() -> None:
    backoff = Backoff(lambda low, high: high)
    assert [backoff.failed() for _ in range(12)] == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 600, 600]
    backoff.worked()
    assert backoff.failed() == 1
    for _ in range(5000):
        assert 0.05 <= Backoff().failed() <= 1.0
    waits = Waits(lambda low, high: high)
    waits.begin(("run", "a"), 10.0)
    assert not waits.is_over(("run", "a"), 10.9)
    assert waits.is_over(("run", "a"), 11.0)
    assert waits.is_over(("run", "b"), 0.0)


def test_disk_alerts_do_not_flicker() -> None:
    alert = disk_alert(80.1, None)
    assert alert is not None
    assert alert.percent == 80
    assert disk_alert(79.5, alert) == alert
    lower = disk_alert(78.9, alert)
    assert lower is not None
    assert lower.percent == 50
    assert disk_alert(48.9, lower) is None


def test_a_damaged_ledger_is_kept_and_begun_anew(tmp_path: Path) -> None:
    Ledger(tmp_path, "/nas").close()
    (tmp_path / "uploader.sqlite3").write_bytes(b"this is no database" * 100)
    ledger = Ledger(tmp_path, "/nas")
    assert "a new ledger was begun" in ledger.replaced
    assert len(list(tmp_path.glob("uploader.sqlite3.damaged-*"))) == 1
    ledger.close()


def test_a_ledger_damaged_where_the_look_at_opening_does_not_see_it_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Ledger(tmp_path, "/nas")
    first.close()
    whole, tries = Ledger._fact, []

    def malformed_at_first(ledger: Ledger, name: str, value: str) -> str:
        tries.append(name)
        if len(tries) == 1:
            raise sqlite3.DatabaseError("database disk image is malformed")
        return whole(ledger, name, value)

    monkeypatch.setattr(Ledger, "_fact", malformed_at_first)
    ledger = Ledger(tmp_path, "/nas")
    assert "malformed" in ledger.replaced
    assert ledger.id != first.id
    assert len(list(tmp_path.glob("uploader.sqlite3.damaged-*"))) == 1
    ledger.close()


def test_a_damaged_ledger_that_cannot_be_put_aside_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    ledger = Ledger(tmp_path, "/nas")
    rot(ledger)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refuse)
        assert ledger.close_damaged(LedgerDamaged("damaged")) == ""
        with pytest.raises(LedgerProblem, match="cannot be put aside"):
            Ledger(tmp_path, "/nas")
    ledger = Ledger(tmp_path, "/nas")
    assert "a new ledger was begun" in ledger.replaced
    ledger.close()


def test_a_ledger_has_one_user_and_one_version(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, "/nas")
    with pytest.raises(StoreError, match=f"pid {os.getpid()}"):
        Ledger(tmp_path, "/nas")
    ledger.close()
    db = sqlite3.connect(tmp_path / "uploader.sqlite3")
    db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(StoreError, match="newer flora-uploader"):
        Ledger(tmp_path, "/nas")


def test_the_ledger_is_durable_and_counts_right(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, "/nas")
    assert ledger._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert ledger._db.execute("PRAGMA synchronous").fetchone() == (2,)
    ledger.see("run", [Found(f"frames/{i}.jpg", "once", i, i) for i in range(5)])
    for number, state in ((0, "stored"), (1, "damaged"), (2, "vanished"), (3, "freed")):
        entry = ledger.get("run", f"frames/{number}.jpg")
        assert entry is not None
        if state == "stored":
            ledger.stored(entry, "0" * 64, 0, 0, 7)
        else:
            ledger.mark(entry, state)  # type: ignore[arg-type]
    counts = {state: n for state, n in ledger.counts.items() if n}
    assert counts == {"waiting": 1, "stored": 1, "damaged": 1, "vanished": 1, "freed": 1}
    ledger.close()
    ledger = Ledger(tmp_path, "/nas")
    assert ledger.counts["waiting"] == 2  # what was damaged is looked at again
    ledger.close()


@pytest.fixture
def config(tmp_path: Path, nas: Path) -> Path:
    run = tmp_path / "runs/bean"
    (run / "frames").mkdir(parents=True)
    (run / "run.toml").write_text("[camera]\n")
    (run / "frames/000001.jpg").write_bytes(b"picture")
    path = tmp_path / "flora.toml"
    path.write_text(f'[rig]\nrun_dir = "{run}"\nstate_dir = "{tmp_path / "state"}"\n[uploader]\ntarget = "{nas}"\n')
    return path


def test_once_and_status(config: Path, nas: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--config", str(config), "--once"]) == 0
    assert (nas / "bean/frames/000001.jpg").read_bytes() == b"picture"
    assert "2 files copied" in capsys.readouterr().out
    assert main(["--config", str(config), "--status"]) == 0
    out = capsys.readouterr().out
    assert f"target: {nas}" in out
    assert "bean" in out
    (nas / ".flora-nas").unlink()
    assert main(["--config", str(config), "--once"]) == 1
    assert "marker file" in capsys.readouterr().err


def test_once_with_a_ledger_that_goes_bad_ends_with_one_line(
    config: Path, nas: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    see = Ledger.see

    def rotten(ledger: Ledger, run: str, found: list[Found]) -> list[str]:
        seen = see(ledger, run, found)
        rot(ledger)
        return seen

    with monkeypatch.context() as patch:
        patch.setattr(Ledger, "see", rotten)
        assert main(["--config", str(config), "--once"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "uploader.sqlite3: the ledger is damaged" in said
    assert main(["--config", str(config), "--once"]) == 0
    assert (nas / "bean/frames/000001.jpg").read_bytes() == b"picture"


def test_once_tells_of_a_damaged_picture(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = config.parent / "runs/bean/frames.jsonl"
    log.write_text('{"file": "frames/000001.jpg", "sha256": "' + "0" * 64 + '"}\n')
    assert main(["--config", str(config), "--once"]) == 1
    captured = capsys.readouterr()
    assert "1 damaged" in captured.out
    assert "not what the camera wrote" in captured.err
    assert main(["--config", str(config), "--status"]) == 1
    assert "damaged: bean/frames/000001.jpg" in capsys.readouterr().out


def test_status_without_a_ledger_is_one_line(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--config", str(config), "--status"]) == 1
    assert "no ledger yet" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("", "target is empty"),
        ("nas", "absolute path"),
        ("{root}/runs", "the folder of the runs itself"),
        ("{root}/runs/bean/nas", "inside the run folder"),
        ("{root}/runs/bean", "inside the run folder"),
    ],
)
def test_targets_that_cannot_be(config: Path, capsys: pytest.CaptureFixture[str], target: str, words: str) -> None:
    root = config.parent
    text = config.read_text()
    config.write_text(text[: text.index("[uploader]")] + f'[uploader]\ntarget = "{target.format(root=root)}"\n')
    assert main(["--config", str(config), "--once"]) == ConfigError.exit_status
    assert words in capsys.readouterr().err
