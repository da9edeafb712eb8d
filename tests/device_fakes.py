"""A service's surroundings without processes: an app whose real time a test moves, and a grow box behind its wire."""

from __future__ import annotations

import heapq
import itertools
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import zmq

from fake_clock import FakeClock
from flora_common.app import Timer
from flora_common.bus import Freshness
from flora_common.clock import NS
from flora_common.log import Log
from flora_common.messages import Message, spec_of
from flora_common.runs import CameraSection, RunFile, RunFolder, run_file_text


def tiny_jpeg(level: int = 120) -> bytes:
    """A whole JPEG of 64 x 48 px."""
    import cv2
    import numpy as np

    return cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))[1].tobytes()


def grey_film(path: Path, pictures: int) -> Path:
    """A film of so many grey pictures of 64 x 48 px, each brighter than the one before."""
    import cv2
    import numpy as np

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5, (64, 48))
    for number in range(pictures):
        writer.write(np.full((48, 64, 3), 50 + 60 * number, np.uint8))
    writer.release()
    return path


def grey_run(path: Path, pictures: int) -> Path:
    """A run folder with the same pictures, 300 s apart, under the left lamp."""
    run = RunFolder(path)
    run.frames.mkdir(parents=True)
    for number in range(pictures):
        name = f"frames/{number}.jpg"
        (path / name).write_bytes(tiny_jpeg(50 + 60 * number))
        run.append_frame(name, 300.0 * number, "left")
    return path


GOOD_METADATA = {
    "ExposureTime": 20_000,
    "AnalogueGain": 1.0,
    "DigitalGain": 1.0,
    "ColourGains": [1.9, 1.6],
    "SensorTimestamp": 1,
}


class FakeApp:
    """What services use of :class:`flora_common.app.App`, with real time that only a test moves."""

    def __init__(self, folder: Path, config: Any, *, clock: Any = None, interval_s: float = 300.0) -> None:
        self.config = config
        self.clock = clock or FakeClock(mono_ns=1000 * NS)
        self.state_dir = folder / "state"
        self.run = RunFolder(folder / "run")
        if not self.run.run_toml.exists():
            self.run.path.mkdir(parents=True, exist_ok=True)
            camera = CameraSection(anchor_px=(32.0, 40.0), px_per_cm=4.0, width_px=64, height_px=48)
            self.run.run_toml.write_text(run_file_text(RunFile(camera=camera, interval_s=interval_s)))
        self.inbox = Freshness(self.clock, tick_s=interval_s)
        self.lines: list[str] = []
        self.log = Log("test", lambda level, service, text, fields: self.lines.append(text))
        self.said: list[Message] = []
        self.troubles: dict[str, str] = {}
        self.readable: dict[Any, Callable[[], None]] = {}
        self.exits: list[Callable[[], None]] = []
        self._ready_calls: list[Callable[[], None]] = []
        self._handlers: dict[type, list[Callable[[Any], None]]] = {}
        self._timers: list[tuple[float, int, Timer]] = []
        self._order = itertools.count()
        self._real_s = 0.0

    def on(self, kind: type, handler: Callable[[Any], None]) -> None:
        self._handlers.setdefault(kind, []).append(handler)

    def on_readable(self, source: Any, handler: Callable[[], None]) -> None:
        assert source not in self.readable
        self.readable[source] = handler

    def forget_readable(self, source: Any) -> None:
        self.readable.pop(source, None)

    def after(self, real_s: float, call: Callable[[], None]) -> Timer:
        timer = Timer(call)
        heapq.heappush(self._timers, (self._real_s + real_s, next(self._order), timer))
        return timer

    def every(self, real_s: float, call: Callable[[], object]) -> None:
        def again() -> None:
            self.after(real_s, again)
            call()

        self.after(real_s, again)

    def on_ready(self, call: Callable[[], None]) -> None:
        self._ready_calls.append(call)

    def on_exit(self, call: Callable[[], None]) -> None:
        self.exits.append(call)

    def publish(self, message: Message) -> None:
        msgspec.convert(msgspec.to_builtins(message), type(message))  # what others would refuse is a bug
        self.said.append(message)

    def trouble(self, key: str, reason: str) -> None:
        if reason:
            self.troubles[key] = reason
        else:
            self.troubles.pop(key, None)

    # the test's side

    def hear(self, *messages: Message) -> None:
        """These arrive, stamped with the present time unless they carry one."""
        for sent in messages:
            mono_ns = sent.t_mono_ns or self.clock.mono_ns()
            message = msgspec.structs.replace(sent, t_mono_ns=mono_ns)
            self.inbox.hear(spec_of(type(message)).kind, message)
            for handler in self._handlers.get(type(message), ()):
                handler(message)

    def ready(self) -> None:
        """The bus has answered; what it kept was heard before."""
        for call in self._ready_calls:
            call()
        self.pass_real_s(0.0)

    def pass_real_s(self, seconds: float) -> None:
        """Real time passes; timers that become due are called, those that they set too."""
        end_s = self._real_s + seconds
        while self._timers and self._timers[0][0] <= end_s:
            due_s, _, timer = heapq.heappop(self._timers)
            self._real_s = max(self._real_s, due_s)
            if timer.call is not None:
                timer.call()
        self._real_s = end_s

    def pass_s(self, seconds: float) -> None:
        """Rig time and real time pass together."""
        self.clock.advance(seconds)
        self.pass_real_s(seconds)

    def heard(self, kind: type) -> list[Any]:
        """What was said of one type so far."""
        return [message for message in self.said if isinstance(message, kind)]

    def leave(self) -> None:
        for call in reversed(self.exits):
            call()


class FakeBox:
    """A grow box that only remembers: answers like ``flora-twin serve``, in a thread of its own.

    Attributes:
        requests: every request so far.
        flash: whether its lamp is on.
        grb: the bytes of its strips.
        refuse: operations that it refuses.
        silent: operations that it does not answer.
    """

    def __init__(self, address: str, *, rate: float = 0.0, time_s: float = 0.0) -> None:
        self.address = address
        self.requests: list[dict[str, Any]] = []
        self.rate, self.time_s = rate, time_s
        self.flash, self.flash_dead = False, False
        self.grb = b""
        self.jpeg, self.metadata = tiny_jpeg(), dict(GOOD_METADATA)
        self.refuse: set[str] = set()
        self.silent: set[str] = set()
        self._context = zmq.Context()
        self._router = self._context.socket(zmq.ROUTER)
        self._router.setsockopt(zmq.LINGER, 0)
        self._router.bind(address)
        self._stop, self._stopped = (self._context.socket(zmq.PAIR) for _ in range(2))
        self._stop.bind("inproc://stop")
        self._stopped.connect("inproc://stop")
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        poller = zmq.Poller()
        poller.register(self._router, zmq.POLLIN)
        poller.register(self._stopped, zmq.POLLIN)
        while self._stopped not in dict(poller.poll()):
            *envelope, payload = self._router.recv_multipart()
            answer = self._answer(msgspec.msgpack.decode(payload))
            if answer is not None:
                self._router.send_multipart([*envelope, msgspec.msgpack.encode(answer)])

    def _answer(self, request: dict[str, Any]) -> dict[str, Any] | None:
        self.requests.append(request)
        op = request["op"]
        if op in self.silent:
            return None
        if op in self.refuse:
            return {"ok": False, "error": f"{op} is broken"}
        answer: dict[str, Any] = {"ok": True}
        if op == "wait":
            self.time_s = max(self.time_s, request["until_s"])
        if op in ("now", "wait"):
            utc_ns = 1_700_000_000 * NS + round(self.time_s * NS)
            answer |= {"time_s": self.time_s, "t_utc_ns": utc_ns, "rate": self.rate, "planted": True}
        elif op == "flash":
            self.flash = request["on"] and not self.flash_dead
            answer["on"] = self.flash
        elif op == "strips":
            self.grb = request["grb"]
        elif op == "shutter":
            answer |= {"jpeg": self.jpeg, "metadata": self.metadata}
        return answer

    def close(self) -> None:
        self._stop.send(b"")
        self._thread.join()
        for socket in (self._router, self._stop, self._stopped):
            socket.close(linger=0)
        self._context.term()


@contextmanager
def fake_box(**options: Any) -> Iterator[FakeBox]:
    """A box at a private, short address."""
    with tempfile.TemporaryDirectory(prefix="flora-") as folder:
        box = FakeBox(f"ipc://{folder}/box", **options)
        try:
            yield box
        finally:
            box.close()
