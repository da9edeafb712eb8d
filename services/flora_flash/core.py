"""The beat: which tick is next, when it is due, and what time it is in the run. Pure: readings of the clock come in.

Due times are a grid: last due time plus the interval. A beat that comes late is late once; beats that can no longer be
made up for are counted and left out, so two photographs are never closer than half an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Final

import msgspec

from flora_common.clock import NS
from flora_common.messages import Tick
from flora_common.messages.catalogue import Purpose
from flora_common.messages.envelope import Count, Nanoseconds, Seconds

STATE_FILE: Final = "flash.json"

LONGEST_ABSENCE_S: Final = 30 * 86_400.0
"""After a restart of the machine the wall clock is believed where it says that less than this has passed."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The clocks at one moment; ``mono_ns`` counts from the start of the boot that ``boot_id`` names.

    Attributes:
        is_right: the wall clock has been set since that start; a Pi has none that goes on without power.
    """

    mono_ns: int
    utc_ns: int
    boot_id: str
    is_right: bool = True


@dataclass(frozen=True, slots=True)
class Photographed:
    """How far the photographs of a run have come, those that were missed included where flora-capture told of them.

    Attributes:
        tick: the highest number among them; 0 where none has one.
        time_s: run time of the last one; None where no table tells.
        of_run: whether any is of the run itself; False where all show the empty setup.
    """

    tick: int
    time_s: float | None
    of_run: bool = True


class Absence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Time without power that is still to be measured, for the wall clock has not been set since.

    Attributes:
        time_s: run time of the last tick before it.
        utc_ns: the wall clock at that tick.
        taken_s: what it was taken for meanwhile.
    """

    time_s: Seconds
    utc_ns: Nanoseconds
    taken_s: Seconds = 0.0


class BeatState(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What outlasts a restart.

    Defaults are not written, so that an older release can read the file while nothing in it is new.

    Attributes:
        tick: the last number given out.
        run: name of the run folder that ``time_s`` and ``due_s`` belong to.
        begun: the run has had its first tick.
        time_s: run time of its last tick (pictures of the empty setup do not count).
        due_s: run time at which that was due.
        mono_ns, utc_ns, boot_id: the clocks at ``time_s``.
        purpose, shot: what the last number was for.
        setup: the step of a setup run that the last picture of the empty setup answered.
        utc_is_right: the wall clock had been set by ``time_s``, in the boot of that time.
        absence: what is still to be measured; None for nothing.
        is_blank: no photograph of the run has been seen in its folder yet.
    """

    tick: Count = 0
    run: Annotated[str, msgspec.Meta(max_length=255)] = ""
    begun: bool = False
    time_s: Seconds = 0.0
    due_s: Seconds = 0.0
    mono_ns: Nanoseconds = 0
    utc_ns: Nanoseconds = 0
    boot_id: Annotated[str, msgspec.Meta(max_length=64)] = ""
    purpose: Purpose = "run"
    shot: Annotated[str, msgspec.Meta(max_length=64)] = ""
    setup: Annotated[str, msgspec.Meta(max_length=128)] = ""
    utc_is_right: bool = True
    absence: Absence | None = None
    is_blank: bool = False


class Beat:
    """Numbers and due times.

    Args:
        interval_s: seconds of run time between ticks.
        run: name of the run folder.
        state: as left by the last start; None for the very first.
        now: the clocks.
    """

    def __init__(self, interval_s: float, *, run: str, state: BeatState | None, now: Reading) -> None:
        self._interval_s = interval_s
        state = state or BeatState()
        if state.run != run:
            state = BeatState(tick=state.tick, run=run)
        self.state = state
        away_s = self._away_s(now)
        # Rig time at which the run's time was 0.
        self._zero_ns = now.mono_ns - round((state.time_s + away_s) * NS)
        self._absence = self._absence_after(away_s, now)

    def _is_same_boot(self, now: Reading) -> bool:
        state = self.state
        return bool(now.boot_id) and now.boot_id == state.boot_id and now.mono_ns >= state.mono_ns

    def _away_s(self, now: Reading) -> float:
        state, away_s = self.state, self._by_clocks_s(now)
        # Later photographs than the file knows of are ahead of its clocks: the run is not set back behind them.
        is_behind = state.time_s + away_s < state.due_s - self._interval_s / 2
        return state.due_s + self._interval_s - state.time_s if is_behind else away_s

    def _by_clocks_s(self, now: Reading) -> float:
        if self._is_same_boot(now):
            return (now.mono_ns - self.state.mono_ns) / NS
        by_wall_s = (now.utc_ns - self.state.utc_ns) / NS
        return by_wall_s if 0.0 < by_wall_s <= LONGEST_ABSENCE_S else self._interval_s

    def _absence_after(self, away_s: float, now: Reading) -> Absence | None:
        """What is to be measured once the wall clock is right, where the last tick's was.

        Several power cuts before that are one absence, from the last tick whose wall clock was right.
        """
        state = self.state
        if not state.begun or self._is_same_boot(now):
            return state.absence
        if state.absence is None and (now.is_right or not state.utc_is_right):
            return None
        last = state.absence or Absence(state.time_s, state.utc_ns)
        return msgspec.structs.replace(last, taken_s=last.taken_s + away_s)

    def measure_absence(self, now: Reading) -> float:
        """Once the wall clock is right: move the run's zero back by what an absence was taken too short.

        To be called where a tick is due, so that what this makes late is a beat's length after the last photograph.

        Returns:
            The seconds by which run time has moved on; 0 where it has not.
        """
        last = self._absence
        if last is None or not now.is_right:
            return 0.0
        self._absence = None
        longer_s = last.time_s + (now.utc_ns - last.utc_ns) / NS - self.time_s(now.mono_ns)
        if longer_s <= 0.0 or last.taken_s + longer_s > LONGEST_ABSENCE_S:
            return 0.0
        self._zero_ns -= round(longer_s * NS)
        return longer_s

    def time_s(self, mono_ns: int) -> float:
        """Run time; 0 before the run's first tick."""
        return (mono_ns - self._zero_ns) / NS if self.state.begun else 0.0

    @property
    def due_ns(self) -> int:
        """Rig time at which the next tick is due; 0 where it is due at once."""
        if not self.state.begun:
            return 0
        return self._zero_ns + round((self.state.due_s + self._interval_s) * NS)

    def heard(self, tick: Tick) -> None:
        """A tick of ours that the bus knows and the file does not, for the disk was full: it is not started again."""
        if tick.tick <= self.state.tick:
            return
        self.state = msgspec.structs.replace(self.state, tick=tick.tick)
        if self.state.begun and tick.purpose == "run":
            self.state = msgspec.structs.replace(self.state, due_s=max(self.state.due_s, tick.time_s - tick.late_s))
            if tick.t_mono_ns:  # an absence may have been measured since the file was written
                self._zero_ns = min(self._zero_ns, tick.t_mono_ns - round(tick.time_s * NS))

    def answered(self, seen: Photographed) -> None:
        """A tick that flora-capture has answered, and the file does not know of: others have counted it already.

        Before the run's first tick its time is that of the run before.
        """
        seen = seen if self.state.begun else replace(seen, time_s=None)
        self.state = caught_up(self.state, seen, interval_s=self._interval_s)

    def photographed(self) -> None:
        """A photograph of the run lies in its folder: from now on a folder without any is that of another run."""
        self.state = msgspec.structs.replace(self.state, is_blank=False)

    def is_recent(self, now: Reading) -> bool:
        """Whether the last number was given out so lately that it can still be photographed.

        A picture of the empty setup is outside the grid: it may be under way still, and is never lit a second time.
        """
        if self.state.purpose == "background":
            return True
        return self.state.begun and self.time_s(now.mono_ns) - self.state.due_s < self._interval_s / 2

    def next(self, now: Reading) -> Tick:
        """Start the tick that is due."""
        skipped, late_s = 0, 0.0
        if not self.state.begun:
            self._zero_ns = now.mono_ns
            time_s = due_s = 0.0
        else:
            time_s = self.time_s(now.mono_ns)
            beats = max(1, round((time_s - self.state.due_s) / self._interval_s))
            due_s = self.state.due_s + beats * self._interval_s
            skipped, late_s = beats - 1, max(0.0, time_s - due_s)
        self.state = BeatState(
            tick=self.state.tick + 1,
            run=self.state.run,
            begun=True,
            time_s=time_s,
            due_s=due_s,
            mono_ns=now.mono_ns,
            utc_ns=now.utc_ns,
            boot_id=now.boot_id,
            setup=self.state.setup,
            utc_is_right=now.is_right or (self._is_same_boot(now) and self.state.utc_is_right),
            absence=self._absence,
            is_blank=self.state.is_blank or not self.state.begun,
        )
        return Tick(tick=self.state.tick, time_s=time_s, late_s=late_s, skipped=skipped)

    def background(self, now: Reading, *, shot: str, setup: str) -> Tick:
        """Start a picture of the empty setup: a fresh number, outside the grid."""
        self.state = msgspec.structs.replace(
            self.state, tick=self.state.tick + 1, purpose="background", shot=shot, setup=setup
        )
        return self.again(now)

    def again(self, now: Reading) -> Tick:
        """The last tick once more, for one that was written down and never lit."""
        state, time_s = self.state, self.time_s(now.mono_ns)
        late_s = max(0.0, time_s - state.due_s) if state.purpose == "run" else 0.0
        return Tick(tick=state.tick, time_s=time_s, purpose=state.purpose, shot=state.shot, late_s=late_s)

    def give_up_setup(self) -> None:
        """The last picture of the empty setup failed: its step may be asked for again."""
        self.state = msgspec.structs.replace(self.state, setup="")


def recovered(run: str, *, last_tick: int, last_time_s: float | None) -> BeatState:
    """State for a run whose state file is gone: numbers and times go on after the photographs that are there."""
    begun = last_time_s is not None
    return BeatState(tick=last_tick, run=run, begun=begun, time_s=last_time_s or 0.0, due_s=last_time_s or 0.0)


def is_of_another_run(state: BeatState, seen: Photographed | None) -> bool:
    """Whether a run folder of the state's name is a new one: the state's run had photographs, and this has none.

    Photographs may be freed once they are stored, tables stay.
    """
    return state.begun and not state.is_blank and not (seen and seen.of_run)


def caught_up(state: BeatState, seen: Photographed, *, interval_s: float) -> BeatState:
    """State of a run whose file could not be written lately, as far as its photographs have come.

    The clocks stay those of the file, and so does the grid: the last photograph was due at its nearest beat.
    """
    if seen.tick <= state.tick:
        return state
    state = msgspec.structs.replace(state, tick=seen.tick, purpose="run", shot="")
    if seen.time_s is None:
        return state
    beats = max(0, round((seen.time_s - state.due_s) / interval_s))
    return msgspec.structs.replace(state, begun=True, due_s=state.due_s + beats * interval_s)
