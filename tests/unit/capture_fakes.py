"""A capture service with a real camera process that does as the test says, and real time that the test moves."""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from device_fakes import GOOD_METADATA, FakeApp, tiny_jpeg
from flora_capture import process
from flora_capture.service import CaptureSection, CaptureService
from flora_capture.store import Store
from flora_common.messages import Flash
from flora_common.runs import CameraSection

CHILD = """
import os, pathlib, signal, sys
import msgspec
from flora_capture.wire import Answer, pack, read
folder = pathlib.Path(sys.argv[1])
out = sys.stdout.buffer
def say(answer):
    out.write(pack(answer)); out.flush()
read(sys.stdin.buffer)
(folder / "pid").write_text(str(os.getpid()))
with (folder / "starts").open("a") as starts: starts.write("x")
if (folder / "no_camera").exists():
    say(Answer(0, "camera_gone", "no camera at 0")); sys.exit()
say(Answer(0))
while (payload := read(sys.stdin.buffer)) is not None:
    number = msgspec.msgpack.decode(payload)["number"]
    with (folder / "asked").open("a") as asked: asked.write("x")
    what = (folder / "what").read_text()
    if what == "hang": signal.pause()
    if what == "die": sys.exit(3)
    if what == "nonsense": out.write(b"Hello, world!!!!"); out.flush(); signal.pause()
    if what == "ended": say(Answer(number, "film_ended", "old.avi: the film has ended after 3 pictures")); continue
    if what == "gone": say(Answer(number, "camera_gone", "cable pulled")); continue
    jpeg = (folder / "jpeg").read_bytes()
    if what == "torn" or what == "torn_once" and (folder / "asked").stat().st_size % 2 == 1: jpeg = jpeg[:-200]
    say(Answer(number, jpeg=jpeg, metadata=msgspec.json.decode((folder / "metadata").read_bytes())))
"""


class Rig:
    """A capture service over one folder, started as often as the test likes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.apps: list[FakeApp] = []
        (folder / "child.py").write_text(CHILD)
        (folder / "jpeg").write_bytes(tiny_jpeg())
        self.metadata(GOOD_METADATA)
        self.camera("fine")

    def camera(self, what: str) -> None:
        (self.folder / "what").write_text(what)

    def metadata(self, metadata: dict[str, Any]) -> None:
        import json

        (self.folder / "metadata").write_text(json.dumps(metadata))

    def count(self, what: str) -> int:
        return (self.folder / what).stat().st_size if (self.folder / what).exists() else 0

    def start(self, *kept: Any) -> FakeApp:
        app = FakeApp(self.folder, CaptureSection(backend="virtual"))
        self.apps.append(app)
        camera = CameraSection(anchor_px=(1.0, 1.0), px_per_cm=1.0)
        CaptureService(app, Store(app.run), app.config.settings(camera, "ipc:///x"))  # type: ignore[arg-type]
        app.hear(*kept)
        app.ready()
        return app


@contextmanager
def capture_rig(folder: Path, patch: pytest.MonkeyPatch) -> Iterator[Rig]:
    """A rig in a folder, whose services start its camera process and are gone afterwards."""
    command = (sys.executable, str(folder / "child.py"), str(folder))
    patch.setitem(process.CameraProcess.__init__.__kwdefaults__, "command", command)
    rig = Rig(folder)
    try:
        yield rig
    finally:
        for app in rig.apps:
            app.leave()


def until(app: FakeApp, condition: Callable[[], bool]) -> None:
    """Serve what the camera process says until a condition holds."""
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s, (app.said, app.troubles)
        for descriptor in select.select(list(app.readable), [], [], 0.05)[0]:
            if descriptor in app.readable:
                app.readable[descriptor]()


def lit(tick: int, **changes: Any) -> Flash:
    return Flash(**{"tick": tick, "lit": True, "confirmed": True, "time_s": 300.0 * (tick - 1), **changes})


def announced(app: FakeApp, tick: int) -> Any:
    """What is said of a tick, once it is."""

    def found() -> list[Any]:
        return [m for m in app.said if m.tick == tick]

    until(app, lambda: bool(found()))
    return found()[-1]
