"""flora-recorder: every message of its rig into MCAP files of the run folder."""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Callable, Sequence
from typing import Final

from flora_common import files
from flora_common.app import App
from flora_common.bus import Arrival
from flora_common.errors import StoreError
from flora_common.runs import RunFolder
from flora_common.service import run_service
from flora_recorder.core import Limits, Recorder, RecorderSection

LAST_BATCHES: Final = 8
LAST_QUIET_MS: Final = 100
"""What was published before the end may still be on its way."""


def place_check(run: RunFolder) -> Callable[[], None]:
    """Asks whether the run is still where it is now; of a folder that is no run's yet, nothing is asked."""
    if not files.is_file(run.run_toml):
        return lambda: None  # of one that is closed to us the first file tells
    return functools.partial(run.check_place, run.place)


def build(app: App[RecorderSection]) -> None:
    recorder = Recorder(
        app.run.bus,
        rig=app.rig.name,
        limits=Limits.of(app.config),
        clock=app.clock,
        say=app.publish,
        on_gone=lambda sentence: app.trouble("gone", sentence),
        check_place=place_check(app.run),
        metadata={"run": app.run.name, "version": importlib.metadata.version("flora")},
    )
    is_recovered = False
    lost_told = 0

    def recover_left_over() -> None:
        nonlocal is_recovered
        for found in recorder.recover_left_over():
            name = found.path.name if found.path else ""
            app.log.event("recovered", path=name, messages=found.messages, problem=found.problem)
        is_recovered = True

    def guarded(work: Callable[[], None]) -> None:
        try:
            work()
        except StoreError as problem:
            # The reason must not change with every message: each change is a message itself.
            app.trouble("disk", f"not recording: {problem}")

    def tell_lost() -> None:
        nonlocal lost_told
        if recorder.lost != lost_told:
            app.log.warning("messages_lost", new=recorder.lost - lost_told, all=recorder.lost)
            lost_told = recorder.lost

    def flush() -> None:
        app.trouble("gone", "")  # the last flush told it; this one tells whether the new file is there
        recorder.flush()
        if not is_recovered:
            recover_left_over()
        app.trouble("disk", "")
        tell_lost()

    def hear(arrival: Arrival) -> None:
        guarded(lambda: recorder.hear(arrival))

    def finish() -> None:
        for _ in range(LAST_BATCHES):
            if not app.bus.subscriber.poll(LAST_QUIET_MS):
                break
            for arrival in app.bus.receive_all():
                hear(arrival)
        try:
            recorder.close()
        except StoreError as problem:
            app.log.problem("not_finished", str(problem))
        tell_lost()

    # Before READY: files are read whole here, which may take longer than the watchdog allows.
    guarded(recover_left_over)
    app.on_raw(hear)
    app.on_ready(lambda: guarded(flush))
    app.every(app.config.flush_s, lambda: guarded(flush))
    app.on_exit(finish)


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-recorder",
        RecorderSection,
        build,
        argv=argv,
        description="Record every message of the rig to MCAP files in the run folder.",
    )
