"""What a person who looks after a rig should know now, in sentences, the worst first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final, Literal

import msgspec

from flora_common import setup_run
from flora_common.bus import Freshness, late_after_s
from flora_common.counted import counted
from flora_common.health import Line
from flora_common.messages import (
    ControllerState,
    Departure,
    DiagnosisFound,
    Frame,
    FrameMissed,
    JobProgress,
    Lamps,
    LightCommand,
    Stem,
    Stored,
    Tick,
)

Level = Literal["problem", "notice", "good"]
LEVELS: Final[tuple[Level, ...]] = ("problem", "notice", "good")


class Concern(msgspec.Struct, frozen=True):
    """One sentence, and how much it matters."""

    level: Level
    text: str


def concerns(
    inbox: Freshness, services: Iterable[Line], *, run: str, interval_s: float, is_connected: bool
) -> list[Concern]:
    """All that is worth a word.

    Args:
        inbox: the last message of each kind.
        services: how each service is.
        run: name of the run folder.
        interval_s: between two beats.
        is_connected: the bus answers.
    """
    lines = tuple(services)
    # A service that is not well says itself what is wrong: the same trouble is told once.
    told = frozenset(line.service for line in lines if not line.ok)
    found = [*_of_services(lines, is_connected=is_connected), *_of_tick(inbox, interval_s)]
    found += [*_of_pictures(inbox, told), *_of_light(inbox, told), *_of_plant(inbox), *_of_lab(inbox, run)]
    return sorted(found, key=lambda concern: LEVELS.index(concern.level))


def _of_services(services: Iterable[Line], *, is_connected: bool) -> Iterator[Concern]:
    if not is_connected:
        yield Concern("problem", "No bus answers: what is shown here is what was heard last.")
        return
    for line in services:
        if line.ok:
            continue
        level: Level = "notice" if line.state in ("starting", "never heard") else "problem"
        yield Concern(level, f"{line.service} is {line.state}" + (f": {line.reason}" if line.reason else "."))


def _of_tick(inbox: Freshness, interval_s: float) -> Iterator[Concern]:
    tick, setup, age_s = inbox.last(Tick), setup_run.running(inbox), inbox.age_s(Tick)
    if setup is not None:
        yield Concern("notice", f"The empty setup is photographed, step {setup.step} of {setup.steps}.")
    elif tick is None or age_s is None:
        yield Concern("notice", "No beat has been heard yet.")
    elif age_s > (late_after_s("tick", interval_s) or 0.0):
        yield Concern("problem", f"No beat for {_span(age_s)}; one is due every {_span(interval_s)}.")


def _of_pictures(inbox: Freshness, told: frozenset[str]) -> Iterator[Concern]:
    frame, missed, stem, stored = inbox.last(Frame), inbox.last(FrameMissed), inbox.last(Stem), inbox.last(Stored)
    is_missed = missed is not None and (frame is None or missed.tick > frame.tick)
    if missed is not None and is_missed and "flora-capture" not in told:
        yield Concern("problem", f"No photograph at tick {missed.tick} ({_plain(missed.because)}): {missed.reason}")
    if frame is not None and not frame.exposure_ok:
        yield Concern("problem", f"The last photograph was not exposed as it should be: {frame.exposure_note}")
    if frame is not None and not frame.flash_confirmed:
        yield Concern("problem", "The last photograph was taken without a confirmed flash.")
    if stem is not None and stem.outcome not in ("ok", "no_frame"):
        yield Concern("notice", f"The stem is not sure in the last photograph ({_plain(stem.outcome)}): {stem.reason}")
    if stored is not None and stored.stage == "refused" and "flora-uploader" not in told:
        yield Concern("problem", f"{stored.path} was refused by the NAS: {stored.reason}")


def _of_light(inbox: Freshness, told: frozenset[str]) -> Iterator[Concern]:
    lamps, light, state = inbox.last(Lamps), inbox.last(LightCommand), inbox.last(ControllerState)
    if lamps is not None and "flora-led" not in told:
        if lamps.fallback:
            yield Concern("problem", f"Nobody commands the lamps; by the fallback, {_lamp(lamps.lit)} shines.")
        elif lamps.lit != lamps.commanded:
            wanted, lit = _lamp(lamps.commanded).capitalize(), _lamp(lamps.lit)
            yield Concern("problem", f"{wanted} is commanded, {lit} shines. {lamps.reason}".rstrip())
    if light is not None and light.blind and "flora-controller" not in told:
        yield Concern("problem", f"The controller decides without a stem. {light.reason}".rstrip())
    if state is not None and state.shadow:
        yield Concern("notice", f"{state.shadow} runs in shadow, {counted(state.shadow_ticks_left, 'tick')} to go.")


def _of_plant(inbox: Freshness) -> Iterator[Concern]:
    state = inbox.last(ControllerState)
    if state is None:
        return
    if state.collided:
        when = "" if state.collided_at_s is None else f" at hour {state.collided_at_s / 3600.0:.1f}"
        yield Concern("problem", f"The stem touched the obstacle{when}.")
    if state.target_reached:
        best = "" if state.best_fitness is None else f" Best fitness {100.0 * state.best_fitness:.1f} %."
        yield Concern("good", f"The tip has reached the target.{best}")
    if state.run_over:
        yield Concern("notice", f"The run is over: {state.reason.removeprefix('run over: ')}")


def _of_lab(inbox: Freshness, run: str) -> Iterator[Concern]:
    departure, diagnosis = inbox.last(Departure), inbox.last(DiagnosisFound)
    if departure is not None and departure.run == run and departure.is_departed:
        yield Concern("problem", f"The plant departs from its simulation. {departure.sentence}".rstrip())
    job = inbox.last(JobProgress)
    if job is not None and job.stage == "failed":
        yield Concern("notice", f"The lab's last job ({job.work}) failed: {job.text}")
    if diagnosis is not None:
        yield Concern("notice", f"Diagnosis of {diagnosis.run}: {diagnosis.sentence or _plain(diagnosis.verdict)}")


def _span(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"


def _plain(word: Any) -> str:
    return str(word).replace("_", " ")


def _lamp(light: str) -> str:
    return {"left": "the left lamp", "right": "the right lamp", "both": "both lamps", "dark": "no lamp"}[light]
