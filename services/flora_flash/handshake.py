"""The hand-shake of a tick: light the lamp, wait for the photograph, dark again. Each step is an event, no sleep."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from flora_common.app import App, Timer
from flora_common.clock import NS, Clock
from flora_common.errors import DeviceError, DiskFull
from flora_common.files import write_text
from flora_common.messages import Flash, Frame, FrameMissed, Lamps, Setup, Tick
from flora_common.messages.envelope import as_sentence
from flora_common.setup_run import SETUP_LEASE_S
from flora_flash.backends import Lamp, NoLamp
from flora_flash.core import STATE_FILE, Beat, Photographed, Reading

DARK_AGAIN_S: Final = 5.0
BOX_AGAIN_S: Final = 1.0
TIME_OUTS_BEFORE_DARK: Final = 2
"""Ticks in a row without any word of flora-capture, after which plants are not lit for nobody at further ones."""

RealSeconds = Annotated[float, msgspec.Meta(ge=1.0, le=3600.0)]


class FlashSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[flash]``. Time-outs are in real seconds: they guard devices."""

    backend: Literal["gpio", "virtual", "none"] = "gpio"
    """``none`` is for a rig without a flash lamp."""

    chip: str = "/dev/gpiochip0"
    """GPIO chip of the lamp; ``gpiodetect`` lists them."""

    line: Annotated[int, msgspec.Meta(ge=0, le=1023)] = 17
    """GPIO line of the lamp on that chip; on a Pi the BCM number."""

    active_low: bool = False
    """Whether the lamp is on while the line is low."""

    twin: str = ""
    """For ``virtual``: where flora-twin answers; empty for that of ``[rig.clock]``."""

    frame_timeout_s: RealSeconds = 45.0
    """Real seconds after which the lamp goes dark without a photograph; longer than flora-capture's
    ``hang_timeout_s``."""

    answer_timeout_s: RealSeconds = 60.0
    """Real seconds for which lock-step waits for the lamps' answer to a tick."""

    wait_for_background: bool = False
    """Whether a run begins only when there are pictures of the empty setup."""


def read_clocks(clock: Clock, boot_id: str, utc_is_right: Callable[[], bool]) -> Reading:
    """The clocks now."""
    is_right = utc_is_right()  # before the clock is read: what is set in between is not taken for what it was before
    return Reading(clock.mono_ns(), clock.utc_ns(), boot_id, is_right)


class FlashService:
    """The hand-shake of one tick after the other.

    Args:
        app: the running service.
        lamp: the flash lamp.
        beat: numbers and due times.
        boot_id: names the boot that monotonic time counts from.
        utc_is_right: asks whether the wall clock has been set since that boot.
    """

    def __init__(
        self,
        app: App[FlashSection],
        lamp: Lamp,
        beat: Beat,
        *,
        boot_id: str,
        utc_is_right: Callable[[], bool] = lambda: True,
    ) -> None:
        self._app = app
        self._lamp = lamp
        self._beat = beat
        self._boot_id = boot_id
        self._utc_is_right = utc_is_right
        self._file = app.state_dir / STATE_FILE
        self._open: Tick | None = None
        """The tick whose photograph is awaited."""
        self._time_outs = 0
        """Ticks in a row, waited for in vain, since flora-capture was heard."""
        self._unanswered = 0
        """In lock-step: the tick whose lamps are awaited."""
        self._setup: Setup | None = None
        self._setup_lamps = 0
        """The step of the setup run whose lamps shine, until its picture is begun."""
        self._ready = False
        self._timers: dict[str, Timer] = {}
        app.on(Tick, lambda _: None)  # our own last words, kept by the bus: how far the last start had come
        app.on(Flash, lambda _: None)
        app.on(Frame, self._photographed)
        app.on(FrameMissed, self._missed)
        app.on(Lamps, self._lamps_shine)
        app.on(Setup, self._setup_said)
        app.on_ready(self._resume)
        app.on_exit(self._leave_dark)

    # the beat

    def _resume(self) -> None:
        """The bus has handed over what it kept: carry on where the last start was killed."""
        self._ready = True
        inbox, now = self._app.inbox, self._now()
        tick, asked, lamps = inbox.last(Tick), inbox.last(Flash), inbox.last(Lamps)
        written = self._beat.state
        if tick is not None:
            self._beat.heard(tick)
        for answer in (inbox.last(Frame), inbox.last(FrameMissed)):
            if answer is not None:  # a bus that was started again, too, has these, and no tick of ours
                self._beat.answered(Photographed(answer.tick, answer.time_s if answer.purpose == "run" else None))
        if self._beat.state.tick != written.tick or not self._beat.is_recent(now):
            self._proceed()
            return
        if self._in_lock_step() and written.purpose == "run" and (lamps is None or lamps.tick < written.tick):
            self._unanswered = written.tick
            self._await_answer()
        if any((said := inbox.last(kind)) and said.tick >= written.tick for kind in (Frame, FrameMissed, Lamps)):
            self._proceed()
        elif asked is not None and asked.tick >= written.tick:
            self._open = Tick(tick=asked.tick, time_s=asked.time_s, purpose=asked.purpose, shot=asked.shot)
            self._say(self._open, lit=False, reason="flora-flash was started again")
            self._await_frame()
        elif written.purpose == "background":
            # Who asked may be gone, and the plant inside by now: only a live setup run gets its picture, as a new tick.
            self._beat.give_up_setup()
            self._proceed()
        else:
            last = self._beat.again(now)
            if tick is None or tick.tick < written.tick:
                self._app.publish(last)
            self._light(last)

    def _proceed(self) -> None:
        """Do what is next, or arrange to be called when it is."""
        self._cancel("due")
        if not self._ready or self._open is not None:
            return
        if self._setup is not None:
            self._setup_shot(self._setup)
        elif self._unanswered:
            return
        elif self._must_wait_for_background():
            self._after("due", 1.0, self._proceed)
        else:
            self._after("due", self._app.clock.real_s_until(self._beat.due_ns), self._due)

    def _must_wait_for_background(self) -> bool:
        """Only a run that has not begun waits: pictures that are taken away later must not end the beat."""
        has_begun = self._beat.state.begun
        return self._app.config.wait_for_background and not has_begun and not self._app.run.background_pictures()

    def _due(self) -> None:
        clock, due_ns = self._app.clock, self._beat.due_ns
        if due_ns > clock.mono_ns():
            try:
                clock.move_to(due_ns)
            except DeviceError as problem:
                self._app.trouble("clock", str(problem))
                self._after("due", BOX_AGAIN_S, self._proceed)
                return
        self._app.trouble("clock", "")
        now = self._now()
        longer_s = self._beat.measure_absence(now)
        tick = self._beat.next(now)
        if longer_s:
            self._app.log.warning("absence_was_longer", tick=tick.tick, longer_s=round(longer_s))
        if self._in_lock_step():
            self._unanswered = tick.tick
        if tick.skipped:
            self._app.log.warning("beats_skipped", tick=tick.tick, skipped=tick.skipped)
        self._start(tick)

    def _start(self, tick: Tick) -> None:
        self._keep_state()
        self._app.publish(tick)
        self._light(tick)

    def _keep_state(self) -> None:
        try:
            write_text(self._file, msgspec.json.encode(self._beat.state).decode() + "\n")
            self._app.trouble("state", "")
        except (DiskFull, OSError) as problem:
            # Lamps and controller live by the beat, a full disk or not. Until there is room, the bus alone remembers.
            self._app.trouble("state", f"the tick's number cannot be kept: {problem}")

    # the lamp

    def _light(self, tick: Tick) -> None:
        if self._stays_dark():
            self._shot_failed(tick)
            self._dark(tick, "no word of flora-capture: the flash stays dark until it is heard")
            return
        self._open = tick
        self._say(tick, lit=True, reason="")
        self._await_frame()

    def _stays_dark(self) -> bool:
        return self._time_outs >= TIME_OUTS_BEFORE_DARK and not isinstance(self._lamp, NoLamp)

    def _await_frame(self) -> None:
        self._after("frame", self._app.config.frame_timeout_s, self._frame_timed_out)

    def _capture_heard(self) -> None:
        """It runs, whatever tick it speaks of: one that was left dark is answered with its frame_missed."""
        self._time_outs = 0
        self._app.trouble("frame", "")

    def _photographed(self, frame: Frame) -> None:
        self._capture_heard()
        if self._open is not None and self._open.tick == frame.tick:
            self._dark(self._open, "")
        # After the lamp is dark: the disk may take its time.
        if self._beat.state.is_blank and frame.purpose == "run" and frame.tick == self._beat.state.tick:
            self._note_photograph(self._app.run.path / frame.path)

    def _note_photograph(self, file: Path) -> None:
        if os.access(file, os.F_OK):  # who photographs may keep them elsewhere
            self._beat.photographed()
            self._keep_state()

    def _missed(self, missed: FrameMissed) -> None:
        self._capture_heard()
        if self._open is not None and self._open.tick == missed.tick:
            self._shot_failed(self._open)
            self._dark(self._open, f"no photograph: {missed.because}")

    def _frame_timed_out(self) -> None:
        if self._open is not None:
            waited = f"no word of a photograph for {self._app.config.frame_timeout_s:g} s"
            self._time_outs += 1
            until = "; the flash stays dark until it is heard" if self._stays_dark() else ""
            self._app.trouble("frame", f"{waited}: is flora-capture running?{until}")
            self._shot_failed(self._open)
            self._dark(self._open, waited)

    def _shot_failed(self, tick: Tick) -> None:
        if tick.purpose == "background":
            self._beat.give_up_setup()

    def _dark(self, tick: Tick, reason: str) -> None:
        self._cancel("frame")
        self._open = None
        self._say(tick, lit=False, reason=reason)
        self._await_answer()
        self._proceed()

    def _say(self, tick: Tick, *, lit: bool, reason: str) -> tuple[bool, str]:
        """Switch, and say so; returns as :meth:`_switch`."""
        confirmed, problem = self._switch(lit)
        self._app.publish(
            Flash(
                tick=tick.tick,
                lit=lit,
                confirmed=confirmed,
                time_s=tick.time_s,
                purpose=tick.purpose,
                shot=tick.shot,
                reason=as_sentence("; ".join(part for part in (reason, problem) if part)),
            )
        )
        return confirmed, problem

    def _switch(self, on: bool) -> tuple[bool, str]:
        """(whether the lamp says so too, what is wrong where it does not)."""
        self._cancel("dark")
        try:
            done, problem = self._lamp.switch(on) == on, self._lamp.excuse
        except DeviceError as failure:
            done, problem = False, str(failure)
        if not isinstance(self._lamp, NoLamp):
            self._app.trouble("lamp", "" if done else f"flash lamp: {problem}")
        if not done and not on:
            self._after("dark", DARK_AGAIN_S, self._dark_again)
        return done, "" if done else problem

    def _dark_again(self) -> None:
        self._switch(False)

    def _leave_dark(self) -> None:
        if self._open is None:
            done, problem = self._switch(False)
        else:  # who photographs just now must not take it for lit, nor who starts later and hears what the bus kept
            done, problem = self._say(self._open, lit=False, reason="flora-flash has been stopped")
        if not done:
            self._app.log.problem("flash_not_dark", problem)
        self._lamp.close()

    # the answer, in lock-step

    def _in_lock_step(self) -> bool:
        clock = self._app.clock
        return clock.real_s_until(clock.mono_ns() + NS) == 0.0

    def _await_answer(self) -> None:
        if self._unanswered:
            self._after("answer", self._app.config.answer_timeout_s, self._answer_timed_out)

    def _lamps_shine(self, lamps: Lamps) -> None:
        if lamps.setup_step:
            self._setup_lamps = lamps.setup_step
            self._proceed()
        elif lamps.tick == self._unanswered:
            self._answered()

    def _answered(self) -> None:
        self._app.trouble("answer", "")
        self._go_on()

    def _answer_timed_out(self) -> None:
        waited_s = self._app.config.answer_timeout_s
        tick = self._unanswered
        self._app.trouble("answer", f"tick {tick}: the lamps did not answer within {waited_s:g} s; going on")
        self._go_on()

    def _go_on(self) -> None:
        self._cancel("answer")
        self._unanswered = 0
        self._proceed()

    # setup runs

    def _setup_said(self, setup: Setup) -> None:
        if not setup.active:
            self._setup_over()
            return
        self._setup = setup
        self._after("setup", SETUP_LEASE_S, self._setup_over)
        self._proceed()

    def _setup_over(self) -> None:
        self._cancel("setup")
        self._setup, self._setup_lamps = None, 0
        self._proceed()

    def _setup_shot(self, setup: Setup) -> None:
        key = f"{setup.session}:{setup.step}:{setup.shot}"
        if setup.step == 0 or self._setup_lamps != setup.step or self._beat.state.setup == key:
            return
        self._setup_lamps = 0
        self._start(self._beat.background(self._now(), shot=setup.shot, setup=key))

    # small things

    def _now(self) -> Reading:
        return read_clocks(self._app.clock, self._boot_id, self._utc_is_right)

    def _after(self, key: str, real_s: float, call: Callable[[], None]) -> None:
        self._cancel(key)
        self._timers[key] = self._app.after(real_s, call)

    def _cancel(self, key: str) -> None:
        timer = self._timers.pop(key, None)
        if timer is not None:
            timer.cancel()
