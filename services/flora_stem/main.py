"""flora-stem: hear each frame, look for the stem, keep the track, say what was found."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Final

import cv2

from flora_common.app import App
from flora_common.errors import BadPicture, StoreError
from flora_common.files import sha256_of_bytes
from flora_common.messages import Frame, FrameMissed, Setup
from flora_common.runs import RunFile, RunFolder
from flora_common.service import run_service
from flora_common.vision.picture import Picture, read_picture
from flora_stem import calibrate
from flora_stem.background import CACHE_FILE, Background
from flora_stem.core import Answer, Row, StemCore
from flora_stem.record import RECORD_FILE, StemRecord, continued, last_track_row, read_record, write_record
from flora_stem.section import StemSection

WAITING_ROWS: Final = 10_000
"""Lines that wait in memory while the disk is full: more than a month of them."""


class FrameReader:
    """Pictures of this run's frames."""

    def __init__(self, run: RunFolder, run_file: RunFile, section: StemSection) -> None:
        self._run = run
        self._names = run.names
        self._size_px = (run_file.camera.width_px, run_file.camera.height_px)
        self._reduction = section.reduction(run_file.camera)

    def __call__(self, frame: Frame) -> Picture:
        """Decoded at the reduced size straight from the file, so that it never lies in memory at its full one.

        Raises:
            BadPicture: of another run, missing, torn, of the wrong size, or not what was announced.
        """
        if frame.run not in self._names:
            raise BadPicture(f"{frame.path} belongs to the run `{frame.run}`, this is `{self._run.path.name}`")
        return read_picture(
            self._run.path / frame.path,
            expected_size=self._size_px,
            reduction=self._reduction,
            sha256=frame.sha256,
        )


class Track:
    """``track.csv``: each time once, in order; lines that find no room wait."""

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        last = last_track_row(run.track_csv)
        self._last_s = last[0] if last else -1.0
        self._waiting: deque[Row] = deque(maxlen=WAITING_ROWS)

    def add(self, row: Row | None) -> None:
        """Add a line, and those that wait.

        Raises:
            StoreError, OSError: no room or no access; the line waits for the next call.
        """
        # The table has milliseconds: a time that reads the same is the same.
        if row is not None and round(row.time_s, 3) > self._last_s:
            self._last_s = round(row.time_s, 3)
            self._waiting.append(row)
        while self._waiting:
            first = self._waiting[0]
            self._run.append_track(first.time_s, first.light, first.points_cm, first.extras)
            self._waiting.popleft()


def build(app: App[StemSection]) -> None:
    cv2.setNumThreads(1)  # the pictures are small; a thread per core costs memory and wins nothing
    run_file = app.run.read_run_file()
    record_file = app.state_dir / RECORD_FILE
    background = Background(app.run, run_file.camera, app.config, app.state_dir / CACHE_FILE)
    track = Track(app.run)
    core = StemCore(
        app.config.method,
        resumed(read_record(record_file, run=run_identity(app.run, run_file)), app.run, run_file, app.config),
        read=FrameReader(app.run, run_file, app.config),
        now_ms=lambda: time.perf_counter() * 1000.0,
    )

    def look_at_background() -> None:
        if background.refresh():
            core.use(background.finder, background.reason)
            app.log.event(
                "setup",
                pictures=background.pictures,
                made_by=background.made_by,
                from_cache=background.from_cache,
                reason=core.why_not,
            )
        app.trouble("background", "; ".join(filter(None, (background.unreadable, core.why_not))))

    def say(answer: Answer | None) -> None:
        if answer is None:
            return
        try:
            # Both before it is said: after a kill the same frame must bring the same words and no second line.
            track.add(answer.row)
            write_record(record_file, core.record)
            app.trouble("disk", "")
        except (StoreError, OSError) as problem:
            app.trouble("disk", f"track and state cannot be kept: {problem}")
        app.publish(answer.stem)
        stem = answer.stem
        unseen = "" if stem.outcome == "ok" or core.why_not else f"{stem.outcome}: {stem.reason}"
        app.trouble("stem", unseen)

    def on_frame(frame: Frame) -> None:
        if frame.purpose == "run":
            look_at_background()
            say(core.on_frame(frame))
            background.saw(frame)

    def on_missed(missed: FrameMissed) -> None:
        if missed.purpose == "run":
            say(core.on_missed(missed))

    def on_setup(setup: Setup) -> None:
        if not setup.active:
            look_at_background()

    app.on(Frame, on_frame)
    app.on(FrameMissed, on_missed)
    app.on(Setup, on_setup)
    look_at_background()


def run_identity(run: RunFolder, run_file: RunFile) -> str:
    """Names the run that a stored state belongs to."""
    return sha256_of_bytes(f"{run.place} {run_file.start}".encode())[:16]


def resumed(record: StemRecord, run: RunFolder, run_file: RunFile, section: StemSection) -> StemRecord:
    """The record; where it remembers nothing, with the stem of the track's last line."""
    last = last_track_row(run.track_csv)
    if record.tip_px is not None or last is None:
        return record
    return continued(record, last, run_file.camera, section.path)


def main(argv: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["calibrate"]:
        return calibrate.main(arguments[1:])
    return run_service(
        "flora-stem",
        StemSection,
        build,
        argv=arguments,
        description="Finds the stem in each photograph. `flora-stem calibrate` takes the pictures of the empty setup.",
    )
