"""The guard of a bus over TCP by itself: what it answers, and that nobody gets in where it does not answer."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from flora_bus.guard import ASKED_AT, Guard
from flora_common.bus_keys import (
    AUTHORIZED,
    BUS,
    CLIENT,
    client_keys,
    make_authorized,
    make_pair,
    protect_client,
    read_pair,
)
from flora_common.errors import BusUnreachable

pytestmark = pytest.mark.skipif(not zmq.has("curve"), reason="this libzmq was built without CURVE")
SUBSCRIPTION = b"known"


@pytest.fixture
def context() -> Iterator[zmq.Context[Any]]:
    with zmq.Context() as context:
        yield context


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_pair(tmp_path, BUS)
    _, public = make_pair(tmp_path, CLIENT)
    shutil.copy(public, make_authorized(tmp_path) / "this.pub")
    return tmp_path


def asked(guard: Guard, context: zmq.Context[Any], question: list[bytes]) -> list[bytes]:
    with context.socket(zmq.DEALER) as asker:
        asker.connect(ASKED_AT)
        asker.send_multipart(question)
        assert guard.questions.poll(5000)
        guard.answer()
        return asker.recv_multipart() if asker.poll(200) else []


def question(mechanism: bytes, *credentials: bytes) -> list[bytes]:
    return [b"", b"1.0", b"7", b"flora-bus", b"10.0.0.3", b"", mechanism, *credentials]


def test_only_a_known_key_is_let_in(folder: Path, context: zmq.Context[Any]) -> None:
    guard = Guard(folder, context=context)
    known = read_pair(folder, CLIENT).public
    assert asked(guard, context, question(b"CURVE", known)) == [b"", b"1.0", b"7", b"200", b"OK", b"", b""]
    assert guard.refused.count == 0
    for wrong in (
        question(b"CURVE", bytes(32)),
        question(b"CURVE", known[:-1]),
        question(b"CURVE"),
        question(b"CURVE", known, known),
        question(b"NULL"),
        question(b"PLAIN", b"user", b"password"),
    ):
        assert asked(guard, context, wrong)[2:4] == [b"7", b"400"]
    assert asked(guard, context, [b"", b"1.0"]) == []  # not a question at all
    assert (guard.refused.count, guard.refused.address) == (6, "10.0.0.3")
    guard.close()


def test_there_is_one_guard_to_a_context(folder: Path, context: zmq.Context[Any]) -> None:
    guard = Guard(folder, context=context)
    with pytest.raises(BusUnreachable, match="another bus of this process"):
        Guard(folder, context=context)
    guard.close()


@pytest.mark.parametrize("is_guarded", [True, False])
def test_where_nobody_answers_nobody_gets_in(folder: Path, context: zmq.Context[Any], is_guarded: bool) -> None:
    """Without being told so, libzmq lets everyone in then."""
    guard = Guard(folder, context=context)
    with context.socket(zmq.XPUB) as bus, zmq.Context() as elsewhere, elsewhere.socket(zmq.SUB) as client:
        bus.linger = client.linger = 0
        guard.protect(bus)
        bus.bind("tcp://127.0.0.1:*")
        if not is_guarded:
            guard.close()
        protect_client(client, client_keys(folder))
        client.subscribe(SUBSCRIPTION)
        client.connect(bus.last_endpoint.decode())
        if is_guarded:
            assert guard.questions.poll(5000)
            guard.answer()
            assert bus.recv() == b"\x01" + SUBSCRIPTION
        else:
            assert not bus.poll(1000)
    guard.close()


def test_what_was_mended_is_read_again_without_anybody_coming(folder: Path, context: zmq.Context[Any]) -> None:
    guard = Guard(folder, context=context)
    torn = folder / AUTHORIZED / "half-copied.pub"
    torn.write_text("#")
    guard.read()
    assert "half-copied.pub" in guard.problem
    torn.unlink()
    guard.read()
    assert guard.problem == ""
    guard.close()
