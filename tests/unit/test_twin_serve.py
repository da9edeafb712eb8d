"""``flora-twin serve`` goes on after a kill, where it may start and listen, and what the other commands write."""

from __future__ import annotations

import contextlib
import json
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import msgpack
import pytest
import zmq
from served_world import FULL_WHITE, RIGHT, START_NS, make

from flora_common.errors import BadInput
from flora_twin import commands
from flora_twin.main import main
from flora_twin.server import CHECKPOINT, LATEST_START_NS, bound, only_one, parse_start
from flora_twin.strips import OFF, strip_bytes
from flora_twin.world import World


def test_a_snapshot_goes_on_byte_for_byte() -> None:
    world = World(8)
    world.set_strips(RIGHT)
    world.set_flash(True)
    world.advance_to(5000.0)
    world.switch_fault("torn_jpeg", on=True, times=2)
    other = World(8)
    other.restore(world.snapshot())
    for each in (world, other):
        each.advance_to(12_345.0)
        each.set_strips(strip_bytes(FULL_WHITE, OFF))
        each.advance_to(20_000.0)
    assert world.snapshot() == other.snapshot()
    with pytest.raises(BadInput, match="seed 8"):
        World(9).restore(world.snapshot())


def test_damaged_snapshots_are_refused_and_change_nothing() -> None:
    world = World(8)
    world.advance_to(1000.0)
    good = world.snapshot()
    rng = random.Random(1)
    for _ in range(60):
        bad = bytearray(good)
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        bad = bad[: rng.randrange(len(bad))] if rng.random() < 0.4 else bad
        with contextlib.suppress(BadInput):  # a flip in the archive's padding does no harm
            world.restore(bytes(bad))
        assert world.snapshot() == good


def test_a_damaged_checkpoint_is_told_with_its_path(tmp_path: Path) -> None:
    make(tmp_path)
    (tmp_path / CHECKPOINT).write_bytes(b"PK nothing")
    with pytest.raises(BadInput, match=CHECKPOINT):
        make(tmp_path)


def test_a_checkpoint_of_another_seed_is_refused(tmp_path: Path) -> None:
    make(tmp_path, seed=1)
    with pytest.raises(BadInput, match="seed 1"):
        make(tmp_path, seed=2)


def test_two_worlds_do_not_share_a_folder(tmp_path: Path) -> None:
    with only_one(tmp_path), pytest.raises(BadInput, match="another flora-twin"), only_one(tmp_path):
        pass


@pytest.mark.parametrize("text", ["yesterday", "2026-03-01T08:00:00"])
def test_starts_that_are_no_moment_are_refused(text: str) -> None:
    with pytest.raises(BadInput, match="start"):
        parse_start(text)
    assert parse_start("2026-03-01T08:00:00Z") == START_NS


@pytest.mark.parametrize(
    "text",
    ["9999-12-31T23:59:59Z", "2231-01-01T00:00:00Z", "0001-01-01T00:00:00+14:00", "1969-12-31T23:59:59Z"],
)
def test_starts_that_messages_cannot_tell_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    assert main(["serve", "--start", text, "--state-dir", str(tmp_path / "state")]) == 2
    assert capsys.readouterr().err == (
        f"flora-twin: start `{text}` lies outside of the years 1970 to 2230; choose a time within them\n"
    )
    assert not (tmp_path / "state").exists()


@pytest.mark.parametrize("kept", [-1, LATEST_START_NS + 1, 2**70])
def test_a_kept_start_that_messages_cannot_tell_is_refused(tmp_path: Path, kept: int) -> None:
    (tmp_path / "start.json").write_text(json.dumps({"start_utc_ns": kept}))
    with pytest.raises(BadInput, match=r"start\.json: damaged \(.* 1970 to 2230\); remove .* to start anew"):
        make(tmp_path)


def test_a_world_of_the_latest_start_answers_to_its_end_and_beyond_it_when_its_clock_jumps(tmp_path: Path) -> None:
    (tmp_path / "start.json").write_text(json.dumps({"start_utc_ns": LATEST_START_NS}))
    rig = make(tmp_path)
    assert rig.ask("now")["t_utc_ns"] == LATEST_START_NS
    rig.ask("fault", name="clock_jumps", on=True, seconds=1e10)
    assert rig.ask("now")["t_utc_ns"] == 2**63 - 1


class Process:
    """``flora-twin serve`` as a process."""

    def __init__(self, folder: Path, context: zmq.Context[Any]) -> None:
        self.context = context
        self.address = f"ipc://{folder}/world.sock"
        command = [sys.executable, "-m", "flora_twin.main", "serve", "--address", self.address]
        command += ["--state-dir", str(folder / "state"), "--seed", "5", "--start", "2026-03-01T08:00:00Z"]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE)
        self.socket: zmq.Socket[bytes] = context.socket(zmq.REQ)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.REQ_RELAXED, 1)
        self.socket.setsockopt(zmq.REQ_CORRELATE, 1)
        self.socket.connect(self.address)

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        self.socket.send(msgpack.packb({"op": op, **arguments}))
        assert self.socket.poll(20_000), "no answer"
        answer = msgpack.unpackb(self.socket.recv())
        assert isinstance(answer, dict)
        return answer

    def end(self, number: signal.Signals) -> int:
        if self.process.returncode is None:
            self.process.send_signal(number)
            self.process.communicate(timeout=20)
        self.socket.close()
        return self.process.returncode


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[[], Process]]:
    started: list[Process] = []
    with zmq.Context() as context:

        def start() -> Process:
            started.append(Process(tmp_path, context))
            return started[-1]

        yield start
        for each in started:
            each.end(signal.SIGKILL)


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("nowhere", "address `nowhere` cannot be bound ("),
        ("tcp://203.0.113.1:5599", "address `tcp://203.0.113.1:5599` cannot be bound ("),
        ("ipc:///no/such/folder/world.sock", "address `ipc:///no/such/folder/world.sock` cannot be bound ("),
        ("tcp://127.0.0.1:99999", "--address is tcp://127.0.0.1:99999; ports go up to 65535"),
        ("tcp://127.0.0.1", "--address is tcp://127.0.0.1, without a port: tcp://HOST:PORT"),
    ],
)
def test_a_box_at_an_address_that_cannot_be_had_leaves_nothing_behind(
    tmp_path: Path, address: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--address", address, "--state-dir", str(tmp_path / "box" / "state")]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"flora-twin: {said}")
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_box_whose_folder_cannot_be_made_leaves_no_socket_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "state"
    assert main(["serve", "--address", f"ipc://{tmp_path}/world.sock", "--state-dir", str(folder)]) == 2
    said = f"{folder}: cannot be written, {tmp_path}/file is no folder; name another place with --state-dir\n"
    assert capsys.readouterr().err == f"flora-twin: {said}"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("there", [True, False])
def test_a_box_binds_its_address_once_so_that_nobody_who_waits_for_it_loses_a_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, there: bool
) -> None:
    addresses = []

    def counted(address: str) -> contextlib.AbstractContextManager[zmq.Socket[bytes]]:
        addresses.append(address)
        return bound(address)

    monkeypatch.setattr(commands, "bound", counted)
    monkeypatch.setattr(commands, "serve", lambda server, router: server.save())
    where = f"ipc://{tmp_path}/world.sock"
    if there:
        (tmp_path / "state").mkdir()
    assert main(["serve", "--address", where, "--state-dir", str(tmp_path / "state")]) == 0
    assert addresses == [where]
    assert (tmp_path / "state" / CHECKPOINT).is_file()


@pytest.mark.parametrize("there", [True, False])
def test_of_two_boxes_that_begin_at_once_only_the_one_that_has_the_folder_takes_the_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, there: bool
) -> None:
    folder, taken = tmp_path / "state", []

    def looked(address: str) -> contextlib.AbstractContextManager[zmq.Socket[bytes]]:
        with pytest.raises(BadInput, match="another flora-twin uses this folder"), only_one(folder):
            pass
        taken.append(address)
        return bound(address)

    monkeypatch.setattr(commands, "bound", looked)
    monkeypatch.setattr(commands, "serve", lambda server, router: server.save())
    if there:
        folder.mkdir()
    where = f"ipc://{tmp_path}/world.sock"
    assert main(["serve", "--address", where, "--state-dir", str(folder)]) == 0
    assert taken == [where]


def test_a_second_process_leaves_the_first_its_address(tmp_path: Path, serve: Callable[[], Process]) -> None:
    first = serve()
    now = first.ask("now")
    second = serve()
    _, told = second.process.communicate(timeout=20)
    assert (second.process.returncode, told.count(b"\n")) == (2, 1)
    assert first.ask("now") == now


def test_a_killed_process_goes_on_where_it_was(tmp_path: Path, serve: Callable[[], Process]) -> None:
    first = serve()
    first.ask("plant", present=True)
    first.ask("strips", grb=RIGHT)
    first.ask("flash", on=True)
    now = first.ask("wait", until_s=7_777.0)
    assert first.end(signal.SIGKILL) == -signal.SIGKILL

    second = serve()
    assert second.ask("now") == now
    second.ask("wait", until_s=20_000.0)
    hung = second.context.socket(zmq.DEALER)
    hung.setsockopt(zmq.LINGER, 0)
    hung.connect(second.address)
    for frames in ([b""], [b"", b"x", b"y"], [b"x"], [b"", b"\xc1"]):
        hung.send_multipart(frames)
    assert second.ask("now")["time_s"] == 20_000.0
    hung.close()
    assert second.end(signal.SIGTERM) == 0

    world = World(5)
    world.set_strips(RIGHT)
    world.set_flash(True)
    world.advance_to(7_777.0)
    world.advance_to(20_000.0)
    assert (tmp_path / "state" / CHECKPOINT).read_bytes() == world.snapshot()


def test_commands_write_what_they_promise_and_bad_input_ends_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*arguments: str) -> int:
        return main(list(arguments))

    assert run("grow", "--hours", "2", "--schedule", "right 1h, left", "-o", str(tmp_path / "track.csv")) == 0
    lines = (tmp_path / "track.csv").read_text().splitlines()
    assert lines[0].startswith("time_s,light,x1,y1")
    assert len(lines) == 26
    assert run("picture", "--hours", "1", "--light", "right", "-o", str(tmp_path / "a.jpg")) == 0
    assert cv2.imread(str(tmp_path / "a.jpg")).shape == (1232, 1640, 3)
    assert run("faults") == 0
    assert "camera_hangs" in capsys.readouterr().out
    assert run("picture", "-o", str(tmp_path / "a.gif")) == 2
    assert run("grow", "--schedule", "sometimes", "-o", str(tmp_path / "b.csv")) == 2
    assert run("grow", "--hours", "many", "-o", str(tmp_path / "b.csv")) == 2
    assert not (tmp_path / "b.csv").exists()
    errors = capsys.readouterr().err.splitlines()
    assert all(line.startswith("flora-twin: ") for line in errors)


def test_a_controller_file_that_is_not_there_removes_no_demo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "rig" / "runs" / "bean" / "track.csv"
    kept.parent.mkdir(parents=True)
    kept.write_text("measured")
    assert main(["demo", "--out", str(tmp_path), "--controller", "typo.controller.json", "--hours", "1"]) == 2
    assert "--controller typo.controller.json: no such file" in capsys.readouterr().err
    assert kept.read_text() == "measured"
