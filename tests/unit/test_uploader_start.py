"""The uploader starts where its ledger cannot be opened yet, and begins when it can."""

from __future__ import annotations

import errno
import os
import resource
import sqlite3
import time
from pathlib import Path
from typing import Literal

import pytest
from uploader_fakes import rot

from announced_frames import announced
from device_fakes import FakeApp
from flora_common.config import RigSection
from flora_common.errors import ConfigError, StoreError
from flora_common.files import write_bytes
from flora_common.messages import Stored
from flora_common.notify import Notifier
from flora_uploader import actions, reserve
from flora_uploader.config import SWITCHED_OFF, UploaderSection
from flora_uploader.ledger import FILE_NAME, RESERVE_NAME, Ledger, _lock
from flora_uploader.ledger_damage import LedgerProblem
from flora_uploader.main import build
from flora_uploader.service import LEDGER_AGAIN_S, RESERVE_EVERY_S
from flora_uploader.uploader import DISK_EVERY_S


class App(FakeApp):
    """With what the uploader uses besides."""

    def __init__(
        self, folder: Path, target: Path | Literal[""], *, runs_dir: str = "", stop_within_s: float = 0.0
    ) -> None:
        section = UploaderSection(
            target=str(target), marker="", stop_within_s=stop_within_s, runs_dir=runs_dir, scan_every_s=0.1
        )
        super().__init__(folder, section)
        self.notifier = Notifier({})
        self.rig = RigSection(run_dir=str(self.run.path), state_dir=str(self.state_dir))
        self.states: list[tuple[str, str]] = []

    def state(self, state: str, reason: str = "") -> None:
        self.states.append((state, reason))


@pytest.fixture
def roomy_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk of whoever runs these tests may be so full that the service is rightly degraded."""
    monkeypatch.setattr(actions, "disk_percent_free", lambda folder: 90.0)


def test_the_disk_is_watched_while_uploading_is_switched_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    percent_free = [20.5]
    monkeypatch.setattr(actions, "disk_percent_free", lambda folder: percent_free[-1])
    app = App(tmp_path, "")
    build(app)  # type: ignore[arg-type]
    app.ready()
    assert app.states == [("ready", f"{SWITCHED_OFF}; the spool's disk is more than 50 % full")]
    for free, state, said in (
        (20.0, "degraded", "; the spool's disk is more than 80 % full"),
        (5.0, "degraded", "; the spool's disk is more than 95 % full"),
        (80.0, "ready", ""),
    ):
        percent_free.append(free)
        app.pass_real_s(DISK_EVERY_S)
        assert app.states[-1] == (state, SWITCHED_OFF + said)
    app.leave()
    assert not app.state_dir.exists()  # nothing else is done


def test_a_spool_that_is_not_there_yet_fills_no_disk(tmp_path: Path) -> None:
    app = App(tmp_path, "", runs_dir=str(tmp_path / "nowhere"))
    build(app)  # type: ignore[arg-type]
    assert app.states == [("ready", SWITCHED_OFF)]


@pytest.mark.usefixtures("roomy_disk")
def test_a_ledger_that_cannot_be_opened_is_told_and_tried_again(tmp_path: Path) -> None:
    nas = tmp_path / "nas"
    nas.mkdir()
    app = App(tmp_path, nas)
    in_the_way = app.state_dir / FILE_NAME
    in_the_way.mkdir(parents=True)
    build(app)  # type: ignore[arg-type]
    app.ready()
    assert "cannot be opened" in app.troubles["ledger"]
    app.pass_real_s(LEDGER_AGAIN_S)
    assert "ledger" in app.troubles
    in_the_way.rmdir()
    app.pass_real_s(LEDGER_AGAIN_S)
    assert app.troubles == {}
    for _ in range(50):
        app.pass_real_s(0.1)
    assert "run.toml" in [message.path for message in app.heard(Stored)]
    assert app.states[-1][0] == "ready"
    app.leave()


def pass_in_pieces(app: App, seconds: float) -> None:
    """The service works between."""
    for _ in range(round(seconds / 0.1)):
        app.pass_real_s(0.1)


def work_until_trouble(app: App) -> None:
    """The uploader's own clock is the machine's: it scans in a moment."""
    end_s = time.monotonic() + 10.0
    while not app.troubles and time.monotonic() < end_s:
        app.pass_real_s(0.1)
        time.sleep(0.01)


def opened(monkeypatch: pytest.MonkeyPatch) -> list[Ledger]:
    """Every ledger that is opened from now on."""
    ledgers: list[Ledger] = []
    begin = Ledger._begin

    def watched(ledger: Ledger, target: str) -> None:
        begin(ledger, target)
        ledgers.append(ledger)

    monkeypatch.setattr(Ledger, "_begin", watched)
    return ledgers


def with_a_bad_ledger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[App, Path, list[Ledger]]:
    """A service whose ledger goes bad while it runs, its NAS, and the ledgers that it opens."""
    nas = tmp_path / "nas"
    nas.mkdir()
    ledgers = opened(monkeypatch)
    app = App(tmp_path, nas)
    build(app)  # type: ignore[arg-type]
    app.ready()
    pass_in_pieces(app, 2.0)
    rot(ledgers[0])
    return app, nas, ledgers


@pytest.mark.usefixtures("roomy_disk")
@pytest.mark.parametrize("noticed_by", ["the work", "an announcement"])
def test_a_ledger_that_goes_bad_while_running_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, noticed_by: str
) -> None:
    app, nas, ledgers = with_a_bad_ledger(tmp_path, monkeypatch)
    picture = b"picture"
    write_bytes(app.run.path / "frames" / "000001.jpg", picture)
    if noticed_by == "an announcement":
        app.hear(announced("frames/000001.jpg", picture, 1))
    else:
        work_until_trouble(app)
    assert "damaged" in app.troubles["ledger"]
    assert app.lines.count("ledger_damaged") == 1
    assert len(ledgers) == 1
    pass_in_pieces(app, LEDGER_AGAIN_S + 2.0)
    assert app.troubles == {}
    assert len(ledgers) == 2
    assert (nas / "run" / "frames" / "000001.jpg").read_bytes() == picture
    assert app.states[-1][0] == "ready"
    assert "a new ledger was begun" in app.states[-1][1]
    assert len(list(app.state_dir.glob(f"{FILE_NAME}.damaged-*"))) == 1
    said = len(app.heard(Stored))
    pass_in_pieces(app, LEDGER_AGAIN_S + 2.0)
    assert (len(ledgers), len(app.heard(Stored))) == (2, said)  # and all is quiet
    app.leave()
    assert app.lines.count("stopped") == 1
    Ledger(app.state_dir, str(nas)).close()  # nobody holds it any more


@pytest.mark.usefixtures("roomy_disk")
def test_a_ledger_that_is_replaced_while_somebody_uploads_by_hand_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    app, nas, ledgers = with_a_bad_ledger(tmp_path, monkeypatch)
    work_until_trouble(app)
    by_hand = Ledger(app.state_dir, str(nas))
    pass_in_pieces(app, LEDGER_AGAIN_S + 2.0)
    assert "works with this ledger already" in app.troubles["ledger"]
    by_hand.close()
    pass_in_pieces(app, LEDGER_AGAIN_S + 2.0)
    assert app.troubles == {}
    assert len(ledgers) == 3
    app.leave()


@pytest.mark.usefixtures("roomy_disk")
def test_leaving_while_a_damaged_ledger_waits_to_be_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ledgers = opened(monkeypatch)
    app = App(tmp_path, tmp_path / "nas")
    build(app)  # type: ignore[arg-type]
    app.ready()
    pass_in_pieces(app, 2.0)
    rot(ledgers[0])
    work_until_trouble(app)
    assert "ledger" in app.troubles
    app.leave()
    assert len(ledgers) == 1
    Ledger(app.state_dir, "/nas").close()


@pytest.mark.usefixtures("roomy_disk")
def test_a_ledger_found_damaged_at_the_end_does_not_keep_the_service_from_ending(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledgers = opened(monkeypatch)
    nas = tmp_path / "nas"
    nas.mkdir()
    app = App(tmp_path, nas, stop_within_s=60.0)
    build(app)  # type: ignore[arg-type]
    app.ready()
    pass_in_pieces(app, 2.0)
    rot(ledgers[0])
    app.leave()
    assert "ledger_damaged" in app.lines
    assert app.lines[-1] == "stopped"
    assert "a new ledger was begun" in Ledger(app.state_dir, str(nas)).replaced


def test_leaving_before_the_ledger_was_opened(tmp_path: Path) -> None:
    app = App(tmp_path, tmp_path / "nas")
    (app.state_dir / FILE_NAME).mkdir(parents=True)
    build(app)  # type: ignore[arg-type]
    app.leave()
    assert app.said == []


def test_a_target_that_cannot_be_used_ends_the_start(tmp_path: Path) -> None:
    app = App(tmp_path, tmp_path / "run" / "copies")
    with pytest.raises(ConfigError, match="inside the run folder"):
        build(app)  # type: ignore[arg-type]
    app.leave()


def test_the_ledger_is_locked_also_without_room_for_its_holders_number(tmp_path: Path) -> None:
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, most[1]))  # whatever is written finds no room
    try:
        first = _lock(tmp_path / "lock")
        with pytest.raises(StoreError, match=r"works with this ledger already \(pid unknown\)"):
            _lock(tmp_path / "lock")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    os.close(first)
    os.close(_lock(tmp_path / "lock"))


def test_the_service_keeps_a_reserve_and_makes_it_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reserve, "_room_bytes", lambda _: 1 << 30)
    app = App(tmp_path, tmp_path / "nas")
    build(app)  # type: ignore[arg-type]
    assert (app.state_dir / RESERVE_NAME).stat().st_size == reserve.RESERVE_BYTES
    assert "reserve_given_up" not in app.lines
    (app.state_dir / RESERVE_NAME).unlink()
    app.pass_real_s(RESERVE_EVERY_S + 1.0)
    assert (app.state_dir / RESERVE_NAME).exists()
    app.leave()


def test_a_reserve_that_was_given_up_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    app = App(tmp_path, tmp_path / "nas")
    app.state_dir.mkdir()
    (app.state_dir / RESERVE_NAME).write_bytes(b"\0" * reserve.RESERVE_BYTES)
    whole, tries = Ledger._open_or_replace, []

    def full_at_first(ledger: Ledger) -> sqlite3.Connection:
        tries.append(ledger)
        if len(tries) == 1:
            raise LedgerProblem("full") from OSError(errno.ENOSPC, "No space left on device")
        return whole(ledger)

    monkeypatch.setattr(Ledger, "_open_or_replace", full_at_first)
    build(app)  # type: ignore[arg-type]
    assert len(tries) == 2
    assert app.troubles == {}
    assert "reserve_given_up" in app.lines
    app.leave()
