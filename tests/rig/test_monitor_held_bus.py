"""flora-monitor beside a bus that stands still for some seconds, as on a busy machine: there, and answering later."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from flora_common.bus_connection import NO_BUS_AFTER_S, STILL_AFTER_S
from flora_common.messages import Tick, encode

HELD_S = NO_BUS_AFTER_S + 1.5


@pytest.fixture
def held(bus: Any) -> Any:
    """A bus that has heard a tick, and stands still."""
    bus.sections["rig"]["health_every_s"] = 60.0
    bus.sections["monitor"] = {"services": ["flora-bus"]}
    bus.broker = bus.start_service("flora-bus")
    me = bus.client(source="flora-flash")
    me.publish(Tick(tick=3, time_s=900.0))
    bus.hear(me, lambda heard: any(isinstance(a.message, Tick) for a in heard))
    bus.broker.send_signal(signal.SIGSTOP)
    return bus


def let_go_after(bus: Any, process: subprocess.Popen[str], held_s: float) -> tuple[str, str]:
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=held_s)
    bus.broker.send_signal(signal.SIGCONT)
    out, err = process.communicate(timeout=60)
    return out, err


@pytest.mark.parametrize(
    "command",
    [["tail", "tick", "--count", "1"], ["tail", "tick", "--seconds", "0.5"], ["topics", "tick"], ["health"]],
)
def test_it_is_waited_for_without_a_word(held: Any, command: list[str]) -> None:
    process = held.start("flora-monitor", *command, "--config", str(held.config))
    out, err = let_go_after(held, process, HELD_S)
    assert process.returncode == 0, err
    assert "answer" not in err
    assert out


def test_a_recording_is_played_when_it_answers(held: Any, tmp_path: Path) -> None:
    from flora_common.recording import RecordingWriter

    file = RecordingWriter(tmp_path / "x.mcap").close()
    replay = held.start("flora-monitor", "replay", str(file), "--rig", "new", "--config", str(held.config))
    _, err = let_go_after(held, replay, HELD_S)
    assert replay.returncode == 0, err


def test_one_that_hangs_is_told_apart_from_none(held: Any) -> None:
    began_s = time.monotonic()
    health = held.start("flora-monitor", "health", "--config", str(held.config))
    _, err = health.communicate(timeout=60)
    assert time.monotonic() - began_s >= STILL_AFTER_S
    assert health.returncode == 1
    assert err == (
        f"flora-monitor: the bus at {held.address.publish} does not answer: it hangs, or its machine is too busy; "
        "look again in a minute\n"
    )


def test_a_door_of_which_nobody_is_left_is_not_waited_for(bus: Any) -> None:
    for endpoint in (bus.address.publish, bus.address.subscribe):
        with socket.socket(socket.AF_UNIX) as door:
            door.bind(endpoint.removeprefix("ipc://"))  # what a bus that was killed leaves behind
    health = bus.start("flora-monitor", "health", "--config", str(bus.config))
    _, err = health.communicate(timeout=60)
    assert err == f"flora-monitor: no bus answers at {bus.address.subscribe}; is flora-bus running?\n"


def test_the_doctor_tells_apart_too(held: Any) -> None:
    doctor = held.start("flora-monitor", "doctor", "--json", "--config", str(held.config))
    out, _ = doctor.communicate(timeout=300)
    found = {line["part"]: line for line in map(json.loads, out.splitlines())}
    assert found["bus"]["verdict"] == "wrong"
    assert "does not answer: it hangs" in found["bus"]["text"]


class KeepsBeforeItAnswers:
    """A bus that has said all it keeps, and is then too busy to say that it is there."""

    def __init__(self, address: Any) -> None:
        context = zmq.Context.instance()
        self.incoming, self.outgoing = context.socket(zmq.XSUB), context.socket(zmq.XPUB)
        self.incoming.bind(address.publish)
        self.incoming.send(b"\x01")
        self.outgoing.bind(address.subscribe)

    def serve(self, process: subprocess.Popen[str]) -> tuple[str, str]:
        tick = Tick(tick=3, time_s=900.0, source="flora-flash", seq=1)
        end_s = time.monotonic() + 20
        while process.poll() is None:
            assert time.monotonic() < end_s, "it has not ended"
            if self.outgoing.poll(50) and self.outgoing.recv() == b"\x01":
                self.outgoing.send_multipart(encode("test", tick))
        return process.communicate()

    def close(self) -> None:
        self.incoming.close(linger=0)
        self.outgoing.close(linger=0)


@pytest.fixture
def slow(bus: Any) -> Iterator[KeepsBeforeItAnswers]:
    keeps = KeepsBeforeItAnswers(bus.address)
    yield keeps
    keeps.close()


def test_what_it_keeps_is_heard_before_it_says_that_it_is_there(bus: Any, slow: KeepsBeforeItAnswers) -> None:
    tail = bus.start("flora-monitor", "tail", "tick", "--count", "1", "--config", str(bus.config))
    out, err = slow.serve(tail)
    assert json.loads(out)["time_s"] == 900.0
    assert err.startswith("flora-monitor: 1 message, 0 lost, 0 bad")
    assert tail.returncode == 0


def test_a_recording_of_it_is_kept(bus: Any, slow: KeepsBeforeItAnswers, tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    record = bus.start("flora-monitor", "record", str(file), "--count", "1", "--config", str(bus.config))
    _, err = slow.serve(record)
    assert (record.returncode, file.is_file()) == (0, True), err
