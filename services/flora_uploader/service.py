"""Photographs heard of on the bus, files found by the scan, and what has become of them said aloud."""

from __future__ import annotations

import time
from typing import Final

from flora_common.app import App, Timer
from flora_common.errors import DiskFull, StoreError
from flora_common.messages import Frame, Stored
from flora_common.messages.envelope import as_sentence
from flora_uploader.actions import make_uploader, percent_free
from flora_uploader.conditions import Conditions
from flora_uploader.config import SWITCHED_OFF, UploaderSection
from flora_uploader.ledger import Ledger
from flora_uploader.ledger_damage import LedgerDamaged, LedgerProblem
from flora_uploader.model import Event
from flora_uploader.uploader import DISK_EVERY_S, Uploader

LEDGER_AGAIN_S: Final = 10.0
RESERVE_EVERY_S: Final = 60.0


class UploaderService:
    """One file after the other, with a ledger that is opened again where it could not be, and replaced where damaged.

    Args:
        app: the running service, whose configuration names a target.
    """

    def __init__(self, app: App[UploaderSection]) -> None:
        self._app = app
        self._ledger: Ledger | None = None
        self._uploader: Uploader | None = None
        """None while there is no ledger."""
        self._timer: Timer | None = None
        self._replaced = ""
        app.on(Frame, self._heard)
        app.every(RESERVE_EVERY_S, self._keep_reserve)
        app.on_exit(self._close)
        app.on_exit(self._finish)  # called first
        self._begin()

    # the ledger

    def _begin(self) -> None:
        app = self._app
        try:
            self._ledger = Ledger(app.state_dir, app.config.target, self._replaced)
        except (LedgerProblem, LedgerDamaged, DiskFull) as problem:
            # A full disk: whoever ended here would be given up by systemd, and be missing when there is room again.
            self._wait_for_ledger(problem)
            return
        self._replaced = ""
        app.trouble("ledger", "")
        if self._ledger.gave_reserve:
            app.log.warning("reserve_given_up", path=self._ledger.reserve.path, reason="no room to open the ledger")
        self._keep_reserve()
        self._uploader = make_uploader(app.rig, app.config, self._ledger, self._say, may_free=True)
        self._arm(0.0)  # without the bus too: pictures do not wait for it

    def _wait_for_ledger(self, problem: StoreError) -> None:
        self._app.trouble("ledger", str(problem))
        self._app.after(LEDGER_AGAIN_S, self._begin_again)

    def _begin_again(self) -> None:
        try:
            self._begin()
        except StoreError as problem:  # somebody else has it just now, such as who uploads by hand
            self._wait_for_ledger(problem)

    def _begin_anew(self, problem: LedgerDamaged) -> None:
        """In a while: a disk that damages every ledger is not to be filled with them."""
        if self._uploader is None or self._ledger is None:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._uploader.abandon()
        self._replaced = self._ledger.close_damaged(problem)
        self._ledger = self._uploader = None
        self._app.log.warning("ledger_damaged", reason=str(problem))
        self._app.trouble("ledger", f"{problem}; a new one is begun from what is at the target")
        self._app.after(LEDGER_AGAIN_S, self._begin_again)

    def _keep_reserve(self) -> None:
        if self._ledger is not None:
            self._ledger.reserve.make()

    # the work

    def _heard(self, frame: Frame) -> None:
        if self._uploader is not None:
            self._arm(0.0)
            try:
                self._uploader.hear(frame.run, frame.path, frame.sha256)
            except LedgerDamaged as problem:  # the scan finds the file
                self._begin_anew(problem)

    def _arm(self, wait_s: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._app.after(wait_s, self._work)

    def _work(self) -> None:
        if self._uploader is None:
            return
        try:
            self._arm(self._uploader.step())
        except LedgerDamaged as problem:
            self._begin_anew(problem)
            return
        _tell(self._app, self._uploader.conditions)

    def _say(self, event: Event) -> None:
        if self._uploader is None:
            return
        self._app.publish(
            Stored(
                stage=event.stage,
                path=event.path[:255],
                sha256=event.sha256,
                bytes=event.bytes,
                destination=as_sentence(event.destination),
                waiting=self._uploader.waiting,
                stored=self._uploader.stored,
                reason=as_sentence(event.reason),
            )
        )
        if event.stage == "refused":
            self._app.log.warning("refused", path=f"{event.run}/{event.path}", reason=event.reason)
        else:
            self._app.log.debug(event.stage, path=f"{event.run}/{event.path}", bytes=event.bytes)

    # the end

    def _finish(self) -> None:
        app, uploader = self._app, self._uploader
        if uploader is None:
            return
        end_s = time.monotonic() + app.config.stop_within_s
        uploader.begin_closing()
        try:
            while time.monotonic() < end_s and not uploader.is_idle:
                uploader.step()
                app.notifier.alive()
        except LedgerDamaged as problem:  # replaced at the next start
            app.log.warning("ledger_damaged", reason=str(problem))
        uploader.abandon()
        app.log.event("stopped", waiting=uploader.waiting, stored=uploader.stored)

    def _close(self) -> None:
        if self._ledger is not None:
            self._ledger.close()


def watch_disk(app: App[UploaderSection]) -> None:
    """While uploading is switched off: the disk fills all the sooner where nothing is brought away."""
    conditions = Conditions()
    conditions.set("target", SWITCHED_OFF, serious=False)  # said first, whatever else is

    def look() -> None:
        conditions.disk_is(percent_free(app.rig, app.config))
        _tell(app, conditions)

    look()
    app.every(DISK_EVERY_S, look)


def _tell(app: App[UploaderSection], conditions: Conditions) -> None:
    app.state("degraded" if conditions.is_serious else "ready", conditions.sentence())
