"""One photograph per tick: asked of the camera process, checked, stored, announced. No photograph is announced too."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

from flora_capture.core import LockedExposure, Sequence, Shot, exposure_note, exposure_of
from flora_capture.process import CameraProcess
from flora_capture.store import FrameRecord, Store
from flora_capture.wire import Answer, CameraSettings, ColourGain, Request
from flora_common.app import App, Timer
from flora_common.errors import BadPicture, DiskFull, StoreError
from flora_common.messages import Flash, Frame, FrameMissed, Lamps
from flora_common.messages.catalogue import MissedBecause
from flora_common.messages.envelope import as_sentence
from flora_common.runs import CameraSection
from flora_common.vision.header import picture_size

TRIES: Final = 2
"""A torn picture is taken once more."""
LONGER_THAN_HANG_S: Final = 60.0
"""Time-out of backends over the network; the service's own comes first and kills."""

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e7)]
Tolerance = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]


class CaptureSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[capture]``; the size of the pictures is that of the run's ``run.toml``."""

    backend: Literal["picamera2", "opencv", "replay", "virtual"] = "picamera2"
    """A Pi camera; a V4L2 camera or a film; an old run; the virtual grow box."""

    source: str = "0"
    """Camera number, device, film or run folder, as the backend wants; not used by ``virtual``."""

    twin: str = ""
    """For ``virtual``: where flora-twin answers; empty for that of ``[rig.clock]``."""

    exposure_us: Positive = 20_000.0
    """Exposure time in microseconds, the same for all pictures."""

    analogue_gain: Annotated[float, msgspec.Meta(ge=1.0, le=64.0)] = 1.0
    """The sensor's gain, the same for all pictures."""

    colour_gains: tuple[ColourGain, ColourGain] = (1.9, 1.6)
    """White balance: gains of red and blue, the same for all pictures."""

    exposure_tolerance: Tolerance = 0.02
    """Relative difference of the exposure time up to which a picture counts as taken as asked: sensors count in
    lines."""

    gain_tolerance: Tolerance = 0.05
    """The same for gains."""

    jpeg_quality: Annotated[int, msgspec.Meta(ge=30, le=100)] = 93
    """Of the pictures that ``picamera2`` and ``opencv`` take."""

    hang_timeout_s: Annotated[float, msgspec.Meta(ge=1.0, lt=30.0)] = 25.0
    """Real seconds after which a camera that gives no picture is killed and started anew."""

    def settings(self, camera: CameraSection, twin: str) -> CameraSettings:
        """What the camera process is told."""
        is_virtual = self.backend == "virtual"
        return CameraSettings(
            backend=self.backend,
            source=(self.twin or twin) if is_virtual else self.source,
            width_px=camera.width_px,
            height_px=camera.height_px,
            exposure_us=self.exposure_us,
            analogue_gain=self.analogue_gain,
            colour_gains=self.colour_gains,
            jpeg_quality=self.jpeg_quality,
            wait_s=LONGER_THAN_HANG_S if is_virtual else 0.9 * self.hang_timeout_s,
        )

    @property
    def locked(self) -> LockedExposure:
        """What the metadata are compared with."""
        red, blue = self.colour_gains
        return LockedExposure(
            self.exposure_us, self.analogue_gain, red, blue, self.exposure_tolerance, self.gain_tolerance
        )


class CaptureService:
    """Wires flash, camera process and store.

    Args:
        app: the running service.
        store: the run's photographs.
        settings: for the camera process.
    """

    def __init__(self, app: App[CaptureSection], store: Store, settings: CameraSettings) -> None:
        self._app = app
        self._store = store
        self._sequence = Sequence()
        self._said: Frame | FrameMissed | None = None
        self._ready = False
        self._deadline: Timer | None = None
        self._ended = ""
        self._is_missing = False
        self._camera = CameraProcess(app, settings, on_answer=self._answered, on_gone=self._camera_gone)
        app.on(Frame, lambda _: None)  # our own last words, kept by the bus: what was announced before a restart
        app.on(FrameMissed, lambda _: None)
        app.on(Lamps, lambda _: None)
        app.on(Flash, self._flash)
        app.on_ready(self._resume)
        app.on_exit(self._camera.close)
        self._camera.start()
        self._complete_csv()

    def _resume(self) -> None:
        """The bus has handed over what it kept: announce what was stored and not said, then hear the flash."""
        self._ready = True
        inbox, last = self._app.inbox, self._store.last
        for said in (inbox.last(Frame), inbox.last(FrameMissed)):
            if said is not None and said.tick > self._sequence.done:
                self._sequence.finish(said.tick)
                self._said = said
        if last is not None and last.tick > self._sequence.done and self._store.whole(last):
            self._say(last.message(self._store.run_name))
        flash = inbox.last(Flash)
        # An old word that it is lit is that of a flora-flash that is gone, and it left the lamp dark.
        if flash is not None and (not flash.lit or inbox.fresh(Flash)):
            self._flash(flash)

    def _flash(self, flash: Flash) -> None:
        if not self._ready:
            return
        before = self._sequence.shot
        todo = self._sequence.hear(flash)
        if todo == "shoot":
            if before is not None:  # the beat did not wait for it
                self._camera.kill()
                self._no_deadline()
                self._miss(before.flash, "camera_hung", "the next tick began before the photograph came")
            self._shoot()
        elif todo == "again" and self._said is not None and self._said.tick == flash.tick:
            self._app.publish(self._said)
        elif todo == "too_late":
            self._miss(flash, "camera_gone", f"no flash any more when flora-capture heard of it: {flash.reason}")

    # the camera

    def _shoot(self) -> None:
        shot = self._sequence.shot
        if shot is None:
            return
        flash = shot.flash
        if self._ended:
            self._miss(flash, "camera_gone", self._ended)
            return
        try:
            name = self._store.name_for(flash.tick, flash.purpose, flash.shot)
        except (OSError, StoreError) as problem:
            self._miss(flash, "not_written", str(problem))
            return
        shot.tries += 1
        shot.lamps_told = self._app.inbox.fresh(Lamps)
        if self._deadline is None:
            self._deadline = self._app.after(self._app.config.hang_timeout_s, self._hung)
        self._camera.ask(Request(number=flash.tick, index=self._store.taken, name=name))

    def _hung(self) -> None:
        self._deadline = None
        if self._sequence.shot is not None:
            self._camera.kill()
            waited_s = self._app.config.hang_timeout_s
            self._miss(
                self._sequence.shot.flash, "camera_hung", f"no picture within {waited_s:g} s; camera process killed"
            )

    def _camera_gone(self, reason: str) -> None:
        if self._sequence.shot is not None:
            self._miss(self._sequence.shot.flash, "camera_gone", reason)
        else:
            self._app.trouble("camera", reason)

    def _answered(self, answer: Answer) -> None:
        shot = self._sequence.shot
        if answer.problem == "film_ended":
            # No new camera process would find more: this is how things are from now on, and each tick is told so.
            self._ended = answer.reason
            self._camera.retire()
            self._app.trouble("disk", "")
            if shot is not None:
                self._miss(shot.flash, "camera_gone", answer.reason)
        elif answer.problem and answer.problem != "bad_picture":
            self._camera.kill()
            if shot is not None:
                self._miss(shot.flash, answer.problem, answer.reason)
            else:
                self._app.trouble("camera", answer.reason)
        elif answer.number == 0:
            self._app.log.event("camera_open", pid=self._camera.pid)
            if shot is None and not self._is_missing:
                self._app.trouble("camera", "")
        elif shot is not None and shot.flash.tick == answer.number:
            try:
                if answer.problem:
                    raise BadPicture(answer.reason)
                size_px = picture_size(answer.jpeg, where="photograph")
            except BadPicture as problem:
                self._bad_picture(shot, problem)
            else:
                self._keep(shot, answer, size_px)

    def _bad_picture(self, shot: Shot, problem: BadPicture) -> None:
        if shot.tries < TRIES:
            self._app.log.warning("picture_taken_again", tick=shot.flash.tick, reason=str(problem))
            self._shoot()
        else:
            self._miss(shot.flash, "bad_picture", str(problem))

    # the disk

    def _keep(self, shot: Shot, answer: Answer, size_px: tuple[int, int]) -> None:
        flash, inbox = shot.flash, self._app.inbox
        # Old words of the lamps are those of a service that is gone, and it left them dark.
        lamps = inbox.last(Lamps) if shot.lamps_told or inbox.fresh(Lamps) else None
        note = exposure_note(exposure_of(answer.metadata), self._app.config.locked)
        try:
            record = self._store.add(
                answer.jpeg,
                FrameRecord(
                    tick=flash.tick,
                    file=self._store.name_for(flash.tick, flash.purpose, flash.shot),
                    sha256="",
                    bytes=0,
                    width_px=size_px[0],
                    height_px=size_px[1],
                    purpose=flash.purpose,
                    light=lamps.lit if lamps else "dark",
                    flash=shot.flash_confirmed,
                    time_s=flash.time_s,
                    t_utc_ns=self._app.clock.utc_ns(),
                    exposure_note=note,
                    metadata=answer.metadata,
                ),
            )
        except DiskFull as problem:
            self._miss(flash, "disk_full", str(problem))
            return
        except (OSError, StoreError) as problem:
            self._miss(flash, "not_written", str(problem))
            return
        self._complete_csv()
        if note:
            self._app.log.problem("exposure", note, kind="exposure", tick=flash.tick)
        else:
            self._app.log.solved("exposure")
        self._is_missing = False
        self._app.trouble("camera", "")
        self._app.trouble("disk", "")
        self._app.log.debug("frame_saved", tick=flash.tick, file=record.file, bytes=record.bytes)
        self._say(record.message(self._store.run_name))

    def _complete_csv(self) -> None:
        try:
            self._store.complete_csv()
            self._app.trouble("csv", "")
        except (DiskFull, OSError) as problem:
            self._app.trouble("csv", str(problem))

    # the word

    def _miss(self, flash: Flash, because: MissedBecause, reason: str) -> None:
        # A camera that opens and gives no picture is not well again each time that it is opened.
        self._is_missing = True
        key = "disk" if because in ("disk_full", "not_written") else "camera"
        self._app.trouble(key, self._ended or f"no photograph for tick {flash.tick}: {reason}")
        self._say(
            FrameMissed(
                tick=flash.tick,
                time_s=flash.time_s,
                because=because,
                reason=as_sentence(reason),
                purpose=flash.purpose,
                shot=flash.shot,
            )
        )

    def _say(self, message: Frame | FrameMissed) -> None:
        self._said = message
        self._sequence.finish(message.tick)
        if self._sequence.shot is None:
            self._no_deadline()
        self._app.publish(message)

    def _no_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
