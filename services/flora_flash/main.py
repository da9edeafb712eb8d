"""flora-flash: choose the lamp, find where the beat was left, and hand both to the hand-shake."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from flora_common.app import App
from flora_common.clock import Clock
from flora_common.clock_sync import is_right
from flora_common.config import RigSection
from flora_common.errors import BadInput
from flora_common.files import damaged_name
from flora_common.runs import RunFolder
from flora_common.service import Action, default_clock, run_service
from flora_common.twin_link import TwinLink, leader_clock
from flora_flash.backends import Lamp, NoLamp
from flora_flash.core import STATE_FILE, Beat, BeatState, caught_up, is_of_another_run, recovered
from flora_flash.handshake import FlashSection, FlashService, read_clocks
from flora_flash.photographs import last_photographed

BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


def open_lamp(rig: RigSection, config: FlashSection) -> Lamp:
    """The lamp that the configuration names."""
    if config.backend == "gpio":
        from flora_flash.backends.gpio import GpioLamp  # noqa: PLC0415 - only what is used is loaded

        return GpioLamp(config.chip, config.line, active_low=config.active_low)
    if config.backend == "virtual":
        from flora_flash.backends.virtual import VirtualLamp  # noqa: PLC0415

        return VirtualLamp(config.twin or rig.clock.twin)
    return NoLamp()


def boot_id() -> str:
    """Names this boot of the machine; empty where the kernel does not tell."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def read_state(file: Path, run: RunFolder) -> BeatState | None:
    """Where the beat was left: by its file, or by the run's photographs where these have come further.

    The file may be older than they are, for it could not be written while its disk was full. A file of another run
    gives its tick number alone: one of another name, or one of the same name that had photographs where this has none.

    Raises:
        BadInput: the file is damaged or cannot be read, or the photographs cannot be looked at.
    """
    state, seen, name = _read_file(file), last_photographed(run), run.name
    if state is not None and state.run == name and is_of_another_run(state, seen):
        state = BeatState(tick=state.tick, run=name)
    if seen is None:
        return state
    if state is None or state.run != name:
        tick = max(seen.tick, state.tick if state else 0)
        return recovered(name, last_tick=tick, last_time_s=seen.time_s)
    return caught_up(state, seen, interval_s=run.read_run_file().interval_s)


def _read_file(file: Path) -> BeatState | None:
    try:
        return msgspec.json.decode(file.read_bytes(), type=BeatState)
    except FileNotFoundError:
        return None
    except (ValueError, RecursionError, OSError) as problem:
        raise BadInput(
            f"{file}: damaged ({problem}); remove it: numbers then go on after the last photograph"
        ) from problem


def keep_damaged(file: Path) -> str:
    """Put a damaged file aside, such as a power cut may leave: the beat needs no person to go on by the photographs.

    Returns:
        What was done, in one sentence; empty where the file is whole, is not there, or cannot be put aside.
    """
    try:
        _read_file(file)
    except BadInput as problem:
        why, aside = problem.__cause__, damaged_name(file)
        try:
            if not isinstance(why, OSError):  # it may be good
                file.rename(aside)
                return f"damaged ({why}); kept as {aside}, numbers go on after the last photograph"
        except OSError:
            pass  # whoever reads it tells
    return ""


def build(app: App[FlashSection]) -> None:
    interval_s = app.run.read_run_file().interval_s
    utc_is_right = functools.partial(is_right, app.rig.clock)
    now = read_clocks(app.clock, boot_id(), utc_is_right)
    state_file = app.state_dir / STATE_FILE
    if kept := keep_damaged(state_file):
        app.log.warning("state_damaged", file=state_file, reason=kept)
    state = read_state(state_file, app.run)
    beat = Beat(interval_s, run=app.run.name, state=state, now=now)
    lamp = open_lamp(app.rig, app.config)
    lamp.switch(False)
    FlashService(app, lamp, beat, boot_id=now.boot_id, utc_is_right=utc_is_right)


def make_clock(rig: RigSection) -> Clock:
    """The beat is what moves the virtual grow box's time on."""
    return leader_clock(TwinLink(rig.clock.twin)) if rig.clock.kind == "twin" else default_clock(rig)


def dark(rig: RigSection, config: FlashSection) -> None:
    """One shot: the lamp off, for systemd when the service has died."""
    lamp = open_lamp(rig, config)
    lamp.switch(False)
    lamp.close()


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-flash",
        FlashSection,
        build,
        argv=argv,
        description="The beat: starts a tick, lights the flash, goes dark after the photograph.",
        actions=[Action("--dark", "switch the flash lamp off and end", dark)],
        make_clock=make_clock,
    )
