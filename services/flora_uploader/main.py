"""flora-uploader: files of record to the target, verified."""

from __future__ import annotations

import time
from collections.abc import Sequence

from flora_common.app import App, Timer
from flora_common.messages import Frame, Stored
from flora_common.service import Action, run_service
from flora_uploader.actions import make_uploader, show_status, upload_once
from flora_uploader.config import SWITCHED_OFF, UploaderSection
from flora_uploader.ledger import Ledger
from flora_uploader.model import Event


def build(app: App[UploaderSection]) -> None:
    config = app.config
    if not config.target:
        app.state("ready", SWITCHED_OFF)
        return
    ledger = Ledger(app.state_dir, config.target)
    app.on_exit(ledger.close)

    def say(event: Event) -> None:
        app.publish(
            Stored(
                stage=event.stage,
                path=event.path[:255],
                sha256=event.sha256,
                bytes=event.bytes,
                destination=event.destination[:500],
                waiting=uploader.waiting,
                stored=uploader.stored,
                reason=event.reason[:500],
            )
        )
        if event.stage == "refused":
            app.log.warning("refused", path=f"{event.run}/{event.path}", reason=event.reason)
        else:
            app.log.debug(event.stage, path=f"{event.run}/{event.path}", bytes=event.bytes)

    uploader = make_uploader(app.rig, config, ledger, say, may_free=True)
    timer: Timer | None = None

    def work() -> None:
        arm(uploader.step())
        conditions = uploader.conditions
        app.state("degraded" if conditions.is_serious else "ready", conditions.sentence())

    def arm(wait_s: float) -> None:
        nonlocal timer
        if timer is not None:
            timer.cancel()
        timer = app.after(wait_s, work)

    def heard(frame: Frame) -> None:
        uploader.hear(frame.run, frame.path, frame.sha256)
        arm(0.0)

    def finish() -> None:
        end_s = time.monotonic() + config.stop_within_s
        uploader.begin_closing()
        while time.monotonic() < end_s and not uploader.is_idle:
            uploader.step()
            app.notifier.alive()
        uploader.abandon()
        app.log.event("stopped", waiting=uploader.waiting, stored=uploader.stored)

    app.on(Frame, heard)
    app.on_exit(finish)
    arm(0.0)  # without the bus too: pictures do not wait for it


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-uploader",
        UploaderSection,
        build,
        argv=argv,
        description="Bring every file of record to a folder, local or mounted, and prove that it is there.",
        actions=(
            Action("--once", "upload what is there, without a bus, print a summary and end", upload_once),
            Action("--status", "print what the ledger knows and end", show_status),
        ),
    )
