"""What a person does by hand: upload now and say what came of it; look at the ledger."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from flora_common.config import RigSection
from flora_common.counted import counted
from flora_common.errors import ConfigError, StoreError
from flora_common.files import make_folder
from flora_uploader.config import SWITCHED_OFF, UploaderSection, make_target, runs_dir
from flora_uploader.ledger import Ledger, read_only
from flora_uploader.ledger_damage import LedgerDamaged
from flora_uploader.model import Event, World
from flora_uploader.owner import Owners
from flora_uploader.retention import disk_percent_free
from flora_uploader.uploader import Uploader

SHOWN: Final = 20
PROGRESS_EVERY_S: Final = 0.2


def percent_free(rig: RigSection, config: UploaderSection) -> float:
    """Of the spool's disk; all of it where there is no spool yet."""
    try:
        return disk_percent_free(runs_dir(rig, config))
    except OSError:
        return 100.0  # nothing to make room in; the scan tells what is wrong


def make_uploader(
    rig: RigSection, config: UploaderSection, ledger: Ledger, say: Callable[[Event], None], *, may_free: bool
) -> Uploader:
    """The uploader of a configuration, on the machine's clocks."""

    def room() -> float:
        return percent_free(rig, config) if may_free else 100.0

    spool, target = runs_dir(rig, config), make_target(rig, config)
    world = World(time.monotonic, time.time_ns, room, say)
    owners = Owners(target, ledger.id, rig=rig.name, machine=platform.node())
    return Uploader(spool, Path(rig.run_dir), target, owners, ledger, config, world, may_free=may_free)


def upload_once(rig: RigSection, config: UploaderSection) -> int:
    """``--once``: upload what is there, without a bus. Status 0 when all is verified at the target."""
    if not config.target:
        raise ConfigError(f"nothing to upload to, {SWITCHED_OFF}")
    target = make_target(rig, config)
    make_folder(Path(rig.state_dir))
    ledger = Ledger(Path(rig.state_dir), config.target)
    refused: list[Event] = []

    def say(event: Event) -> None:
        if event.stage == "refused":
            refused.append(event)

    uploader = make_uploader(rig, config, ledger, say, may_free=False)
    shown_s = time.monotonic()
    try:
        uploader.begin_closing()
        while not uploader.is_idle:
            uploader.step()
            if sys.stderr.isatty() and time.monotonic() >= shown_s + PROGRESS_EVERY_S:
                shown_s = time.monotonic()
                print(f"\r{uploader.stored} stored, {uploader.waiting} waiting ", end="", file=sys.stderr, flush=True)
    except LedgerDamaged as problem:
        ledger.close_damaged(problem)
        raise StoreError(f"{problem}; start again, a new one is then begun from what is at the target") from problem
    finally:
        uploader.abandon()
        ledger.close()
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    totals = uploader.totals
    damaged = ledger.counts["damaged"]
    print(
        f"{target.name}: {counted(totals.files, 'file')} copied ({totals.bytes / 1e6:.1f} MB), "
        f"{totals.found_there} were there, {uploader.stored} stored in all, "
        f"{uploader.waiting - damaged} waiting, {damaged} damaged"
    )
    for event in refused[:SHOWN]:
        print(f"flora-uploader: {event.reason}", file=sys.stderr)
    if len(refused) > SHOWN:
        print(f"flora-uploader: and {len(refused) - SHOWN} more", file=sys.stderr)
    if uploader.waiting == 0 and not refused and not uploader.conditions.is_serious:
        return 0
    if not refused:
        raise StoreError(uploader.conditions.sentence() or "files are still waiting; try again")
    return 1


def show_status(rig: RigSection, _config: UploaderSection) -> int:
    """``--status``: the ledger as a table; status 1 when a file is damaged or vanished."""
    db = read_only(Path(rig.state_dir))
    try:
        rows = db.execute(
            "SELECT run, sum(state = 'waiting'), sum(state = 'stored'), sum(state = 'freed'), sum(state = 'damaged'),"
            " sum(state = 'vanished'), sum(CASE WHEN state IN ('stored', 'freed') THEN size ELSE 0 END),"
            " max(verified_ns) FROM files GROUP BY run ORDER BY run"
        ).fetchall()
        wrong = db.execute(
            "SELECT state, run, path, reason FROM files WHERE state IN ('damaged', 'vanished')"
            " ORDER BY run, path LIMIT ?",
            (SHOWN,),
        ).fetchall()
        target = db.execute("SELECT value FROM facts WHERE name = 'target'").fetchone()
    finally:
        db.close()
    print(f"target: {target[0] if target else 'none'}")
    width = max([len("run"), *(len(row[0]) for row in rows)])
    heads = ("waiting", "stored", "freed", "damaged", "vanished", "MB")
    print(f"{'run':<{width}}" + "".join(f"{head:>10}" for head in heads) + "  last verified")
    for run, *counts, size, verified_ns in rows:
        last = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(verified_ns / 1e9)) if verified_ns else "never"
        print(f"{run:<{width}}" + "".join(f"{count:>10}" for count in counts) + f"{size / 1e6:>10.1f}  {last}")
    for state, run, path, reason in wrong:
        print(f"{state}: {run}/{path}: {reason}")
    return 1 if wrong else 0
