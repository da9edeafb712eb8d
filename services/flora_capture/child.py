"""The camera's own process, which may hang and be killed: ``python -m flora_capture.child``.

It reads settings, then requests, from stdin and writes answers to stdout. It imports one backend and little else.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
from importlib import import_module
from typing import IO, Final

import msgspec

from flora_capture.backends import Camera, FilmEnded
from flora_capture.wire import Answer, CameraSettings, Problem, Request, pack, read
from flora_common.errors import BadPicture, CameraTimeout, FloraError

PR_SET_PDEATHSIG: Final = 1


def die_with_parent() -> None:
    """A camera serves one process: a child left behind by a killed service would keep it from the next."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def is_orphan(answers: IO[bytes]) -> bool:
    """Whether the service had ended before that could be asked for: nobody is left to read the answers."""
    poller = select.poll()
    poller.register(answers, 0)  # that the other end is closed is told anyway
    return bool(poller.poll(0))


def open_camera(settings: CameraSettings) -> Camera:
    """The backend that the settings name."""
    camera: Camera = import_module(f"flora_capture.backends.{settings.backend}").open_camera(settings)
    return camera


def problem_of(error: FloraError) -> Problem:
    """The word for an error."""
    if isinstance(error, CameraTimeout):
        return "camera_hung"
    if isinstance(error, FilmEnded):
        return "film_ended"
    return "bad_picture" if isinstance(error, BadPicture) else "camera_gone"


def main() -> int:
    # Libraries print to stdout: theirs goes to stderr, and the answers through a descriptor that only we know.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    die_with_parent()
    if is_orphan(answers):
        return 0
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service ends us

    def say(answer: Answer) -> None:
        answers.write(pack(answer))
        answers.flush()

    payload = read(sys.stdin.buffer)
    if payload is None:
        return 0
    try:
        camera = open_camera(msgspec.msgpack.decode(payload, type=CameraSettings))
    except FloraError as problem:
        say(Answer(0, problem_of(problem), str(problem)))
        return 0
    say(Answer(0))
    decoder = msgspec.msgpack.Decoder(Request)
    try:
        while (payload := read(sys.stdin.buffer)) is not None:
            request = decoder.decode(payload)
            try:
                jpeg, metadata = camera.shoot(request)
                say(Answer(request.number, jpeg=jpeg, metadata=metadata))
            except FloraError as problem:
                say(Answer(request.number, problem_of(problem), str(problem)))
    finally:
        camera.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
