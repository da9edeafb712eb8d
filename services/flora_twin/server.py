"""The world behind a ZeroMQ ROUTER socket.

Requests and replies are single frames, each a msgpack map: ``{"op": ..., ...}`` and ``{"ok": true, ...}`` or
``{"ok": false, "error": "one line"}``. What is malformed gets an answer where one can be sent, and never ends the
server.

:class:`WorldServer` knows neither sockets nor clocks; :func:`serve` wires both.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Final

import msgspec
import numpy as np
import zmq

from flora_common import files
from flora_common.bus_keys import check_port
from flora_common.errors import BadInput, FloraError
from flora_common.notify import Notifier
from flora_common.suggest import clipped
from flora_twin import faults as menu
from flora_twin.world import World

CHECKPOINT: Final = "world.npz"
START_FILE: Final = "start.json"
TRUTH: Final = "truth.jsonl"
LOCK_FILE: Final = "lock"
MAX_REQUEST_BYTES: Final = 1 << 16
MAX_RATE: Final = 10_000.0
_CATCH_UP_MS: Final = 1000
_NS: Final = 1_000_000_000
_LONGEST_S: Final = 10**9
"""Of a world, as far as a request may let it wait."""
_LARGEST_NS: Final = 2**63 - 1
"""Messages tell times as nanoseconds of 64 bits since 1970."""
LATEST_START_NS: Final = _LARGEST_NS - _LONGEST_S * _NS
"""In 2230: a world that starts then still ends at a time that messages can tell."""

log = logging.getLogger("flora-twin")

Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=_LONGEST_S)]


class _Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="op"):
    """One operation of :data:`flora_twin.faults.OPERATIONS`."""


class Now(_Request, frozen=True, tag="now"):
    pass


class Wait(_Request, frozen=True, tag="wait"):
    until_s: Seconds


class Flash(_Request, frozen=True, tag="flash"):
    on: bool


class Strips(_Request, frozen=True, tag="strips"):
    grb: bytes


class Shutter(_Request, frozen=True, tag="shutter"):
    exposure_us: Annotated[float, msgspec.Meta(gt=0.0, le=1e8)]
    analogue_gain: Annotated[float, msgspec.Meta(gt=0.0, le=1e3)]
    colour_gains: tuple[Annotated[float, msgspec.Meta(ge=0.0, le=1e3)], Annotated[float, msgspec.Meta(ge=0.0, le=1e3)]]
    name: Annotated[str, msgspec.Meta(max_length=200)] = ""


class Plant(_Request, frozen=True, tag="plant"):
    present: bool


class FaultSwitch(_Request, frozen=True, tag="fault"):
    name: Annotated[str, msgspec.Meta(max_length=60)]
    on: bool
    times: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] | None = None
    seconds: Annotated[float, msgspec.Meta(ge=-1e10, le=1e10)] | None = None


Request = Now | Wait | Flash | Strips | Shutter | Plant | FaultSwitch
_decoder = msgspec.msgpack.Decoder(Request)


class WorldServer:
    """Requests in, replies out; the state goes to the disk with every change.

    Args:
        world: a new world; it is replaced by the checkpoint in ``state_dir`` where there is one.
        state_dir: checkpoint and truth.
        start_utc_ns: UTC at time 0; a checkpoint's own start wins.
        rate: 0 is lock-step: time passes only by ``wait``. Else time runs ``rate`` times as fast as ``monotonic_s``.
        monotonic_s: a steady clock.

    Raises:
        BadInput: a rate below 0, or a checkpoint that is damaged or belongs to another seed.
    """

    def __init__(
        self, world: World, state_dir: Path, *, start_utc_ns: int, rate: float, monotonic_s: Callable[[], float]
    ) -> None:
        if not 0.0 <= rate <= MAX_RATE:
            raise BadInput(f"rate is {rate:g}; 0 is lock-step, else it must lie in (0, {MAX_RATE:g}]")
        self.world, self.rate = world, rate
        self._state_dir, self._monotonic_s = state_dir, monotonic_s
        self._checkpoint = state_dir / CHECKPOINT
        self._saved_time_s = -1.0
        files.make_folder(state_dir)
        self.start_utc_ns = _read_start(state_dir / START_FILE, start_utc_ns)
        if self._checkpoint.is_file():
            try:
                world.restore(self._checkpoint.read_bytes())
            except BadInput as problem:
                raise BadInput(f"{self._checkpoint}: {problem}; remove {state_dir} to start anew") from problem
        else:
            self.save()
        self._base_mono_s, self._base_time_s = monotonic_s(), world.time_s

    def catch_up(self) -> None:
        """Let the world's time follow the clock; nothing in lock-step."""
        if self.rate > 0.0:
            self.world.advance_to(self._base_time_s + (self._monotonic_s() - self._base_mono_s) * self.rate)

    def save(self) -> None:
        """Write the checkpoint, whole or not at all."""
        files.write_bytes(self._checkpoint, self.world.snapshot())
        self._saved_time_s = self.world.time_s

    def handle(self, payload: bytes) -> bytes | None:
        """Answer one request; none where the camera hangs."""
        try:
            if len(payload) > MAX_REQUEST_BYTES:
                raise BadInput(f"request of {len(payload)} bytes; at most {MAX_REQUEST_BYTES}")
            reply = self._answer(_decode(payload))
        except FloraError as problem:
            reply = {"ok": False, "error": " ".join(str(problem).split())}
        return None if reply is None else msgspec.msgpack.encode(reply)

    def _answer(self, request: Request) -> dict[str, Any] | None:
        self.catch_up()
        world = self.world
        match request:
            case Now():
                return self._now()
            case Wait(until_s=until_s):
                if self.rate == 0.0:
                    world.advance_to(until_s)
                if world.time_s > self._saved_time_s:
                    self.save()
                return self._now()
            case Flash(on=on):
                really = world.set_flash(on)
                self.save()
                return {"ok": True, "on": really}
            case Strips(grb=grb):
                world.set_strips(grb)
                self.save()
                return {"ok": True}
            case Plant(present=present):
                world.set_planted(present)
                self.save()
                return {"ok": True}
            case FaultSwitch():
                world.switch_fault(request.name, request.on, times=request.times, seconds=request.seconds)
                self.save()
                return {"ok": True}
            case Shutter():
                return self._shutter(request)

    def _now(self) -> dict[str, Any]:
        jumped = self.world.faults.is_on(menu.CLOCK_JUMPS)
        offset_s = self.world.faults.clock_offset_s if jumped else 0.0
        if self.world.faults.occurs(menu.CLOCK_JUMPS) and not self.world.faults.is_on(menu.CLOCK_JUMPS):
            self.save()
        return {
            "ok": True,
            "time_s": self.world.time_s,
            "t_utc_ns": self._utc_ns(offset_s),
            "rate": self.rate,
            "planted": self.world.planted,
        }

    def _utc_ns(self, offset_s: float) -> int:
        """What the rig's clock shows; one that jumps by centuries stops where 64 bits end."""
        utc_ns = self.start_utc_ns + round((self.world.time_s + offset_s) * _NS)
        return min(max(utc_ns, -_LARGEST_NS), _LARGEST_NS)

    def _shutter(self, request: Shutter) -> dict[str, Any] | None:
        world = self.world
        if world.faults.occurs(menu.CAMERA_HANGS):
            self.save()
            return None
        spoilt = any(world.faults.is_on(name) for name in menu.SPOIL_PICTURES)
        jpeg, metadata = world.photograph(request.exposure_us, request.analogue_gain, request.colour_gains)
        if spoilt:
            self.save()
        files.append_line(self._state_dir / TRUTH, json.dumps(self._truth(request.name, jpeg), allow_nan=False))
        return {"ok": True, "jpeg": jpeg, "metadata": metadata}

    def _truth(self, name: str, jpeg: bytes) -> dict[str, Any]:
        """The line of ``truth.jsonl`` that belongs to a photograph."""
        world, truth = self.world, self.world.truth()
        line: dict[str, Any] = {
            "time_s": world.time_s,
            "name": name,
            "sha256": files.sha256_of_bytes(jpeg),
            "seed": world.seed,
            "light": world.light,
            "lamps_rgb": [np.round(lamp.rgb, 4).tolist() for lamp in world.lamps],
            "flash": world.flash,
            "planted": world.planted,
        }
        if truth is not None:
            line |= {
                "points_cm": np.round(truth.points_cm, 4).tolist(),
                "tip_cm": np.round(truth.tip_cm, 4).tolist(),
                "length_cm": round(truth.length_cm, 4),
                "centreline_cm": np.round(truth.centreline_cm, 4).tolist(),
                "centreline_px": np.round(truth.centreline_px, 2).tolist(),
                "depth_cm": np.round(truth.centreline_3d_cm[:, 2], 4).tolist(),
                "leaves": [{key: round(value, 3) for key, value in leaf.items()} for leaf in truth.leaves],
            }
        return line


@contextlib.contextmanager
def bound(address: str) -> Iterator[zmq.Socket[bytes]]:
    """The socket for :func:`serve`. Whoever had an ``ipc`` address loses it: hold the state folder first.

    Raises:
        BadInput: the address cannot be bound.
    """
    check_port("--address", address)
    with zmq.Context() as context, context.socket(zmq.ROUTER) as router:
        router.setsockopt(zmq.LINGER, 0)
        router.setsockopt(zmq.MAXMSGSIZE, 4 * MAX_REQUEST_BYTES)
        try:
            router.bind(address)
        except zmq.ZMQError as problem:
            raise BadInput(f"address `{address}` cannot be bound ({problem.strerror})") from problem
        yield router


def serve(server: WorldServer, router: zmq.Socket[bytes]) -> None:
    """Answer requests until SIGTERM or SIGINT."""
    address = router.getsockopt_string(zmq.LAST_ENDPOINT)
    with _stop_signals() as stop:
        log.info("world of seed %d at %s, time %.0f s", server.world.seed, address, server.world.time_s)
        notifier = Notifier()
        notifier.ready(f"serving seed {server.world.seed} at {address}")
        sign_of_life_ms = None if notifier.watchdog_s is None else round(250 * notifier.watchdog_s)
        poller = zmq.Poller()
        poller.register(router, zmq.POLLIN)
        poller.register(stop, zmq.POLLIN)
        while True:
            ready = dict(poller.poll(sign_of_life_ms if server.rate == 0.0 else _CATCH_UP_MS))
            notifier.alive()
            if stop.fileno() in ready:
                break
            if router in ready:
                _one_request(server, router)
            else:
                server.catch_up()
        notifier.stopping("saving the world")
        server.save()
        log.info("world ends at time %.0f s", server.world.time_s)


def _one_request(server: WorldServer, router: zmq.Socket[bytes]) -> None:
    parts = router.recv_multipart()
    if b"" not in parts[1:]:
        log.warning("dropped a request of %d parts from a socket that is not REQ", len(parts))
        return
    # The envelope ends with the first empty frame; REQ sockets may put a number before it (REQ_CORRELATE).
    body = parts.index(b"", 1) + 1
    if len(parts) == body + 1:
        reply = server.handle(parts[body])
    else:
        reply = msgspec.msgpack.encode({"ok": False, "error": f"a request is one frame, not {len(parts) - body}"})
    if reply is not None:
        with contextlib.suppress(zmq.Again):  # the asker has gone; nobody waits for this
            router.send_multipart([*parts[:body], reply], flags=zmq.DONTWAIT)


def _decode(payload: bytes) -> Request:
    try:
        request: Request = _decoder.decode(payload)
    except (ValueError, RecursionError) as problem:  # covers every error of msgspec, text that is not UTF-8 included
        raise BadInput(f"request: {problem or type(problem).__name__}") from problem
    return request


@contextlib.contextmanager
def _stop_signals() -> Iterator[socket.socket]:
    """A socket that becomes readable when the process is asked to end."""
    wake, woken = socket.socketpair()
    for end in (wake, woken):
        end.setblocking(False)

    def note(_number: int, _frame: FrameType | None) -> None:
        """The interpreter writes to ``wake`` by itself; a handler of ours is what makes it do so."""

    with wake, woken:
        before = signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
        handlers = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield woken
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(before)


@contextlib.contextmanager
def only_one(state_dir: Path) -> Iterator[None]:
    """Hold the state folder: two worlds must not write one checkpoint.

    One that was made here goes again where bad input ends the block before anything is in it.

    Raises:
        BadInput: another process holds it.
    """
    made = [folder for folder in (state_dir, *state_dir.parents) if not folder.exists()]
    files.make_folder(state_dir)
    with (state_dir / LOCK_FILE).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as problem:
            raise BadInput(f"{state_dir}: another flora-twin uses this folder; end it or choose another") from problem
        try:
            yield
        except BadInput:
            if made:
                _unmake(made)
            raise


def _unmake(folders: Sequence[Path]) -> None:
    """Remove the state folder, and those that were made for it, unless there is more than the lock in them."""
    state_dir = folders[0]
    with contextlib.suppress(OSError):
        if [entry.name for entry in state_dir.iterdir()] == [LOCK_FILE]:
            (state_dir / LOCK_FILE).unlink()
            for folder in folders:
                folder.rmdir()


def _read_start(path: Path, start_utc_ns: int) -> int:
    """UTC at time 0: that of the first start, which later starts keep."""
    if not path.is_file():
        files.write_text(path, json.dumps({"start_utc_ns": start_utc_ns}) + "\n")
        return start_utc_ns
    try:
        kept = json.loads(path.read_bytes())["start_utc_ns"]
        if type(kept) is not int:
            raise ValueError("start_utc_ns is not a whole number")
        if not 0 <= kept <= LATEST_START_NS:
            raise ValueError("start_utc_ns lies outside of the years 1970 to 2230")
    except (ValueError, KeyError, TypeError) as problem:
        raise BadInput(f"{path}: damaged ({problem}); remove {path.parent} to start anew") from problem
    return kept


def parse_start(text: str) -> int:
    """Nanoseconds UTC from ISO 8601 with an offset.

    Raises:
        BadInput: not ISO 8601, without an offset from UTC, before 1970 or after :data:`LATEST_START_NS`.
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as problem:
        raise BadInput(f"start `{clipped(text)}` is not a time in ISO 8601, such as 2026-03-01T08:00:00Z") from problem
    if moment.tzinfo is None:
        raise BadInput(f"start `{text}` has no offset from UTC; add Z")
    start_utc_ns = round(moment.timestamp()) * _NS
    if not 0 <= start_utc_ns <= LATEST_START_NS:
        raise BadInput(f"start `{text}` lies outside of the years 1970 to 2230; choose a time within them")
    return start_utc_ns
