"""A flash service with a lamp of ours, and time that the test moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from device_fakes import FakeApp
from fake_clock import FakeClock
from flora_common.clock import NS, LeaderClock
from flora_common.errors import FlashDead
from flora_common.messages import Frame
from flora_flash.core import Beat, BeatState
from flora_flash.handshake import FlashSection, FlashService, read_clocks
from flora_flash.main import read_state

SHA = "0" * 64


class FakeLamp:
    excuse = "the bulb stays dark"

    def __init__(self) -> None:
        self.on = False
        self.is_broken = self.is_gone = self.is_closed = False

    def switch(self, on: bool) -> bool:
        if self.is_gone:
            raise FlashDead("no answer")
        self.on = on and not self.is_broken
        return self.on

    def close(self) -> None:
        self.is_closed = True


class Rig:
    """A flash service, and starts of it one after the other over the same state."""

    def __init__(self, folder: Path, **config: Any) -> None:
        self.folder = folder
        self.config = FlashSection(**config)
        self.lamp: Any = FakeLamp()
        self.clock: Any = FakeClock(mono_ns=1000 * NS)
        self.boot, self.is_right = "boot", True

    def start(self, *kept: Any) -> FakeApp:
        app = FakeApp(self.folder, self.config, clock=self.clock)
        now = read_clocks(self.clock, self.boot, lambda: self.is_right)
        beat = Beat(300.0, run="run", state=read_state(app.state_dir / "flash.json", app.run), now=now)
        FlashService(app, self.lamp, beat, boot_id=self.boot, utc_is_right=lambda: self.is_right)  # type: ignore[arg-type]
        app.hear(*kept)
        app.ready()
        return app

    @property
    def number(self) -> int:
        return msgspec.json.decode((self.folder / "state" / "flash.json").read_bytes(), type=BeatState).tick


def lock_step() -> LeaderClock:
    return LeaderClock(0.0, lambda until_s: (round(until_s * NS), round((1e9 + until_s) * NS)), mono_ns=0, utc_ns=NS)


def frame(tick: int) -> Frame:
    return Frame(
        tick=tick, time_s=0.0, path=f"frames/{tick:06d}.jpg", run="run", sha256=SHA, bytes=1, width_px=1, height_px=1,
        light="dark", flash_confirmed=True, exposure_ok=True,
    )  # fmt: skip


def pass_in_steps(app: FakeApp, seconds: float) -> None:
    """Rig time and real time stay within a second of each other, also where timers set timers."""
    for _ in range(round(seconds)):
        app.pass_s(1.0)
