"""The wire to the virtual grow box outlives the box's death: a request that died with it is asked again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zmq

from flora_common.twin_link import TwinGone, TwinLink


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    context: zmq.Context[Any] = zmq.Context()
    yield context
    context.destroy(linger=0)


def router(context: zmq.Context[Any], address: str) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.ROUTER)
    socket.bind(address)
    return socket


def answer(socket: zmq.Socket[bytes]) -> str:
    """Answer one request; returns its operation."""
    *envelope, body = socket.recv_multipart()
    asked = msgspec.msgpack.decode(body)
    reply = {"ok": True, "op": asked["op"]}
    socket.send_multipart([*envelope, msgspec.msgpack.encode(reply)])
    return str(asked["op"])


def test_a_request_that_died_with_the_box_is_asked_again(context: zmq.Context[Any], tmp_path: Path) -> None:
    address = f"ipc://{tmp_path}/box"
    heard: list[str] = []
    told = threading.Event()

    def box_that_dies() -> None:
        first = router(context, address)
        heard.append(msgspec.msgpack.decode(first.recv_multipart()[-1])["op"])
        first.close(linger=0)
        second = router(context, address)
        # How often `wait` comes depends on which of the two sockets the link found first when it came back.
        while heard[-1] != "now":
            heard.append(answer(second))
        told.wait()  # a socket closed with an answer in it may take the answer with it
        second.close(linger=0)

    box = threading.Thread(target=box_that_dies, daemon=True)
    box.start()
    link = TwinLink(address, timeout_s=20.0, context=context)
    began_s = time.monotonic()
    assert link.ask("wait", until_s=1.0)["op"] == "wait"
    assert time.monotonic() - began_s < 10.0
    assert link.ask("now")["op"] == "now"
    told.set()
    box.join()
    link.close()
    assert heard[:2] == ["wait", "wait"]
    assert set(heard[2:-1]) <= {"wait"}


def test_a_box_that_is_silent_is_not_asked_twice(context: zmq.Context[Any], tmp_path: Path) -> None:
    address = f"ipc://{tmp_path}/box"
    box = router(context, address)
    link = TwinLink(address, timeout_s=0.3, context=context)
    with pytest.raises(TwinGone, match=r"did not answer `shutter` in 0\.3 s"):
        link.ask("shutter")
    assert box.recv_multipart()
    assert not box.poll(0)
    link.close()
    box.close()


def test_a_late_answer_is_not_waited_behind(context: zmq.Context[Any], tmp_path: Path) -> None:
    address = f"ipc://{tmp_path}/box"
    box = router(context, address)
    link = TwinLink(address, timeout_s=0.3, context=context)
    with pytest.raises(TwinGone):
        link.ask("shutter")

    def too_late() -> None:
        shutter = box.recv_multipart()
        assert box.poll(5000)  # the next request is out
        box.send_multipart([*shutter[:-1], msgspec.msgpack.encode({"ok": True})])

    late = threading.Thread(target=too_late, daemon=True)
    late.start()
    with pytest.raises(TwinGone, match="did not answer `now`"):
        link.ask("now")
    late.join()
    link.close()
    box.close(linger=0)


def test_a_box_that_dies_over_and_over_ends_in_the_time_out(context: zmq.Context[Any], tmp_path: Path) -> None:
    address = f"ipc://{tmp_path}/box"
    done = threading.Event()

    def box_that_keeps_dying() -> None:
        while not done.is_set():
            box = router(context, address)
            if box.poll(100):
                box.recv_multipart()
            box.close(linger=0)

    box = threading.Thread(target=box_that_keeps_dying, daemon=True)
    box.start()
    link = TwinLink(address, timeout_s=0.5, context=context)
    began_s = time.monotonic()
    with pytest.raises(TwinGone):
        link.ask("now")
    assert time.monotonic() - began_s < 5.0
    done.set()
    box.join()
    link.close()
