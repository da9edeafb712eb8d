"""flora-uploader: files of record to the target, verified."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from flora_common.app import App, Timer
from flora_common.errors import DiskFull
from flora_common.messages import Frame, Stored
from flora_common.messages.envelope import as_sentence
from flora_common.service import Action, run_service
from flora_uploader.actions import make_uploader, percent_free, show_status, upload_once
from flora_uploader.conditions import Conditions
from flora_uploader.config import SWITCHED_OFF, UploaderSection, check
from flora_uploader.ledger import Ledger
from flora_uploader.ledger_damage import LedgerDamaged, LedgerProblem
from flora_uploader.model import Event
from flora_uploader.uploader import DISK_EVERY_S, Uploader

LEDGER_AGAIN_S: Final = 10.0
RESERVE_EVERY_S: Final = 60.0


def build(app: App[UploaderSection]) -> None:
    config = app.config
    if not config.target:
        watch_disk(app)
        return
    ledger: Ledger | None = None
    uploader: Uploader | None = None
    timer: Timer | None = None
    replaced = ""

    def begin() -> None:
        nonlocal ledger, uploader, replaced
        try:
            ledger = Ledger(app.state_dir, config.target, replaced)
        except (LedgerProblem, LedgerDamaged, DiskFull) as problem:
            # A full disk: whoever ended here would be given up by systemd, and be missing when there is room again.
            app.trouble("ledger", str(problem))
            app.after(LEDGER_AGAIN_S, begin)
            return
        replaced = ""
        app.trouble("ledger", "")
        if ledger.gave_reserve:
            app.log.warning("reserve_given_up", path=ledger.reserve.path, reason="no room to open the ledger")
        keep_reserve()
        uploader = make_uploader(app.rig, config, ledger, say, may_free=True)
        arm(0.0)  # without the bus too: pictures do not wait for it

    def begin_anew(problem: LedgerDamaged) -> None:
        """In a while: a disk that damages every ledger is not to be filled with them."""
        nonlocal ledger, uploader, replaced
        if uploader is None or ledger is None:
            return
        if timer is not None:
            timer.cancel()
        uploader.abandon()
        replaced = ledger.close_damaged(problem)
        ledger = uploader = None
        app.log.warning("ledger_damaged", reason=str(problem))
        app.trouble("ledger", f"{problem}; a new one is begun from what is at the target")
        app.after(LEDGER_AGAIN_S, begin)

    def close() -> None:
        if ledger is not None:
            ledger.close()

    def keep_reserve() -> None:
        if ledger is not None:
            ledger.reserve.make()

    def say(event: Event) -> None:
        if uploader is None:
            return
        app.publish(
            Stored(
                stage=event.stage,
                path=event.path[:255],
                sha256=event.sha256,
                bytes=event.bytes,
                destination=as_sentence(event.destination),
                waiting=uploader.waiting,
                stored=uploader.stored,
                reason=as_sentence(event.reason),
            )
        )
        if event.stage == "refused":
            app.log.warning("refused", path=f"{event.run}/{event.path}", reason=event.reason)
        else:
            app.log.debug(event.stage, path=f"{event.run}/{event.path}", bytes=event.bytes)

    def work() -> None:
        if uploader is None:
            return
        try:
            arm(uploader.step())
        except LedgerDamaged as problem:
            begin_anew(problem)
            return
        conditions = uploader.conditions
        app.state("degraded" if conditions.is_serious else "ready", conditions.sentence())

    def arm(wait_s: float) -> None:
        nonlocal timer
        if timer is not None:
            timer.cancel()
        timer = app.after(wait_s, work)

    def heard(frame: Frame) -> None:
        if uploader is not None:
            arm(0.0)
            try:
                uploader.hear(frame.run, frame.path, frame.sha256)
            except LedgerDamaged as problem:  # the scan finds the file
                begin_anew(problem)

    def finish() -> None:
        if uploader is None:
            return
        end_s = time.monotonic() + config.stop_within_s
        uploader.begin_closing()
        try:
            while time.monotonic() < end_s and not uploader.is_idle:
                uploader.step()
                app.notifier.alive()
        except LedgerDamaged as problem:  # replaced at the next start
            app.log.warning("ledger_damaged", reason=str(problem))
        uploader.abandon()
        app.log.event("stopped", waiting=uploader.waiting, stored=uploader.stored)

    app.on(Frame, heard)
    app.every(RESERVE_EVERY_S, keep_reserve)
    app.on_exit(close)
    app.on_exit(finish)  # called first
    begin()


def watch_disk(app: App[UploaderSection]) -> None:
    """While uploading is switched off: the disk fills all the sooner where nothing is brought away."""
    conditions = Conditions()
    conditions.set("target", SWITCHED_OFF, serious=False)  # said first, whatever else is

    def look() -> None:
        conditions.disk_is(percent_free(app.rig, app.config))
        app.state("degraded" if conditions.is_serious else "ready", conditions.sentence())

    look()
    app.every(DISK_EVERY_S, look)


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-uploader",
        UploaderSection,
        build,
        argv=argv,
        check=check,
        description="Bring every file of record to a folder, local or mounted, and prove that it is there.",
        actions=(
            Action("--once", "upload what is there, without a bus, print a summary and end", upload_once),
            Action("--status", "print what the ledger knows and end", show_status),
        ),
    )
