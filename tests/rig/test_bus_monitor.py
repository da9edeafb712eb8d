"""flora-monitor as it is typed: piped, on a terminal, with and without a bus, ended by Ctrl-C."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
import zmq

from flora_common.bus import Arrival, BusClient
from flora_common.bus_connection import NO_BUS_AFTER_S
from flora_common.clock import SystemClock
from flora_common.messages import Health, LightCommand, Stem, Tick, encode


def lines_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


@pytest.fixture
def live(bus: Any) -> Any:
    """A bus with one participant, `live.me`, that has said a few things."""
    bus.sections["rig"]["health_every_s"] = 60.0  # nobody falls silent while a slow machine starts the next command
    bus.start_service("flora-bus")
    bus.me = bus.client(source="flora-flash")
    for tick in (1, 2, 3):
        bus.me.publish(Tick(tick=tick, time_s=300.0 * tick))
    bus.me.publish(Health(state="degraded", reason="the flash lamp is dark"))
    bus.hear(bus.me, lambda heard: any(getattr(a.message, "reason", "") == "the flash lamp is dark" for a in heard))
    return bus


def monitor(bus: Any, *arguments: str) -> subprocess.Popen[str]:
    process: subprocess.Popen[str] = bus.start("flora-monitor", *arguments, "--config", str(bus.config))
    return process


def test_tail_piped_is_one_json_object_a_line_and_shows_kept_values_at_once(live: Any) -> None:
    tail = monitor(live, "tail", "tick", "--count", "1")
    out, err = tail.communicate(timeout=20)
    (line,) = lines_of(out)
    assert (line["topic"], line["tick"], line["time_s"], line["source"]) == ("test/tick", 3, 900.0, "flora-flash")
    assert tail.returncode == 0
    assert err.startswith("flora-monitor: 1 message, 0 lost, 0 bad, 0 repeated in ")


def test_tail_shows_bad_messages_and_goes_on(live: Any) -> None:
    tail = monitor(live, "tail", "test/[tn]*", "--count", "4")
    assert tail.stdout is not None
    first = json.loads(tail.stdout.readline())
    live.me.publisher.send_multipart([b"test/tick", b"\xc1", b"0"])
    live.me.publisher.send_multipart([b"test/nosuch", b"\x80", b"0"])
    live.me.publish(Tick(tick=4, time_s=1200.0))
    out, err = tail.communicate(timeout=20)
    bad, unknown, last = lines_of(out)
    assert first["tick"] == 3
    assert (bad["verdict"], unknown["verdict"], last["tick"]) == ("bad", "unknown", 4)
    assert "2 messages, 0 lost, 2 bad" in err


def test_tail_on_a_terminal_is_one_coloured_line_a_message(live: Any) -> None:
    main, terminal = pty.openpty()
    try:
        process = subprocess.Popen(
            [*live_command("tail"), "tick", "--count", "1", "--config", str(live.config)],
            stdout=terminal,
            stderr=subprocess.PIPE,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "60"},
        )
        live.processes.append(process)
        process.communicate(timeout=20)
        shown = ""
        while not shown.endswith("\n"):  # a terminal hands over what was written piece by piece
            shown += os.read(main, 65536).decode()
    finally:
        os.close(main)
        os.close(terminal)
    assert shown.count("\n") == 1
    assert "\x1b[" in shown
    assert "test/tick" in shown
    assert "#3" in shown


def live_command(command: str) -> list[str]:
    import sys

    return [str(Path(sys.executable).parent / "flora-monitor"), command]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_tail_ended_by_a_signal_sums_up(live: Any, number: signal.Signals) -> None:
    tail = monitor(live, "tail")
    assert tail.stdout is not None
    tail.stdout.readline()
    tail.send_signal(number)
    _, err = tail.communicate(timeout=20)
    assert tail.returncode == 0
    assert err.count("\n") == 1
    assert err.startswith("flora-monitor: ")


def test_a_rig_that_says_nothing_is_explained_while_it_is_waited_for(live: Any) -> None:
    other = BusClient(live.address, rig="box2", source="flora-flash", clock=SystemClock())
    live.clients.append(other)
    other.connect()
    live.hear(other, lambda _: other.connected)
    other.publish(Tick(tick=1, time_s=0.0))
    live.hear(live.me, lambda heard: any(a.rig == "box2" for a in heard))
    tail = monitor(live, "tail", "--rig", "nosuch", "--count", "1")
    assert tail.stderr is not None
    assert tail.stderr.readline() == "flora-monitor: nothing is heard of rig `nosuch`; on this bus are: box2, test\n"
    late = BusClient(live.address, rig="nosuch", source="flora-flash", clock=SystemClock())
    live.clients.append(late)
    late.connect()
    live.hear(late, lambda _: late.connected)
    late.publish(Tick(tick=4, time_s=0.0))
    out, err = tail.communicate(timeout=20)
    (line,) = lines_of(out)
    assert (line["topic"], line["tick"]) == ("nosuch/tick", 4)
    assert err.startswith("flora-monitor: 1 message, ")


@pytest.mark.parametrize(
    ("command", "status"),
    [(["tail", "--seconds", "0.5"], 0), (["rates", "--seconds", "0.5"], 0), (["topics"], 0), (["health"], 1)],
)
def test_commands_that_end_by_themselves_explain_the_silence_at_their_end(
    live: Any, command: list[str], status: int
) -> None:
    process = monitor(live, *command, "--rig", "nosuch")
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert err.count("nothing is heard of rig `nosuch`; on this bus are: test\n") == 1


def test_tail_survives_its_reader(live: Any) -> None:
    tail = monitor(live, "tail")
    assert tail.stdout is not None
    assert tail.stdout.readline()
    tail.stdout.close()
    for _ in range(3):
        live.me.publish(Tick(tick=9, time_s=1.0))
    assert tail.wait(timeout=20) == 0


def test_without_a_bus_tail_says_so_once_and_waits(bus: Any) -> None:
    tail = monitor(bus, "tail", "tick", "--count", "1")
    assert tail.stderr is not None
    assert tail.stderr.readline() == f"flora-monitor: no bus answers at {bus.address.subscribe}; waiting for it\n"
    bus.start_service("flora-bus")
    bus.client("flora-flash").publish(Tick(tick=5, time_s=1.0))
    out, _ = tail.communicate(timeout=20)
    assert json.loads(out)["tick"] == 5


@pytest.mark.parametrize(
    ("command", "status"),
    [
        (["health"], 1),
        (["replay", "x.mcap"], 1),
        (["topics"], 0),
        (["tail", "--seconds", "0.1"], 1),
        (["rates", "--seconds", "0.1"], 1),
    ],
)
def test_without_a_bus_the_others_say_so_and_end(bus: Any, command: list[str], status: int, tmp_path: Path) -> None:
    if "x.mcap" in command:
        command = ["replay", str(recording(tmp_path))]
    process = monitor(bus, *command)
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    assert "no bus answers at ipc://" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("ends", ["by itself", "by a signal"])
def test_without_a_bus_no_empty_recording_is_left(bus: Any, tmp_path: Path, ends: str) -> None:
    file = tmp_path / "a.mcap"
    record = monitor(bus, "record", str(file), *(["--seconds", "0.1"] if ends == "by itself" else []))
    assert record.stderr is not None
    assert "no bus answers at ipc://" in record.stderr.readline()
    if ends == "by a signal":
        record.send_signal(signal.SIGINT)
    _, err = record.communicate(timeout=20)
    assert record.returncode == (1 if ends == "by itself" else 0)
    assert err.startswith(f"flora-monitor: {file}: not written; 0 messages")
    assert list(tmp_path.glob("*.mcap*")) == []


def recording(folder: Path) -> Path:
    from flora_common.recording import RecordingWriter

    return RecordingWriter(folder / "x.mcap").close()


def test_rates_counts_and_finds_gaps(live: Any) -> None:
    rates = monitor(live, "rates", "light", "--count", "3")
    light = LightCommand(light="left", source="flora-controller")
    live.me.publish(light)
    live.me._out.seq["light"] += 2  # two are lost
    stopped = False
    while not stopped:
        live.me.publish(light)
        live.hear(live.me, lambda heard: len(heard) > 0)
        stopped = rates.poll() is not None
    out, _ = rates.communicate(timeout=20)
    (row,) = lines_of(out)
    assert row["topic"] == "test/light"
    assert row["count"] >= 3
    assert row["lost"] in (0, 2)  # 2 where it heard the one before, which the bus kept
    assert row["late"] is False


def test_topics_tells_what_is_there(live: Any) -> None:
    topics = monitor(live, "topics")
    out, _ = topics.communicate(timeout=20)
    by_kind = {line["kind"]: line for line in lines_of(out)}
    assert by_kind["tick"]["heard"] == ["test/tick"]
    assert by_kind["stem"]["heard"] == []
    assert by_kind["stem"]["owner"] == "flora-stem"


def test_health_is_red_for_what_is_missing_and_tells_scripts(live: Any) -> None:
    health = monitor(live, "health")
    out, _ = health.communicate(timeout=20)
    by_service = {line["service"]: line for line in lines_of(out)}
    assert by_service["flora-bus"]["ok"] is True
    assert (by_service["flora-flash"]["state"], by_service["flora-flash"]["reason"]) == (
        "degraded",
        "the flash lamp is dark",
    )
    assert by_service["flora-led"]["state"] == "never heard"
    assert health.returncode == 1
    only_bus = monitor(live, "health", "flora-bus")
    out, _ = only_bus.communicate(timeout=20)
    assert only_bus.returncode == 0
    assert [line["service"] for line in lines_of(out)] == ["flora-bus"]


def test_recorded_and_said_again_is_the_same(live: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    record = monitor(live, "record", str(file), "*/[ts]*", "--count", "4")
    stems = [
        Stem(tick=n, time_s=1.0, outcome="ok", points_cm=((0.0, 0.0), (float(n), 9.0)), source="flora-stem")
        for n in (1, 2, 3)
    ]
    assert record.stderr is not None
    assert record.stderr.readline() == f"flora-monitor: recording to {file}.open\n"
    for stem in stems:
        live.me.publish(stem)
    _, err = record.communicate(timeout=20)
    assert "4 recorded" in err
    check = monitor_without_config(live, "check", str(file))
    out, _ = check.communicate(timeout=20)
    checked = json.loads(out)
    assert checked["whole"] is True
    assert {t["topic"]: t["messages"] for t in checked["topics"]} == {"test/stem": 3, "test/tick": 1}

    live.hear(live.me, lambda _: True)
    replay = monitor(live, "replay", str(file), "--as-fast", "--only", "stem", "--rig", "other")
    heard = live.hear(live.me, lambda heard: sum(a.rig == "other" for a in heard) == 3)
    _, err = replay.communicate(timeout=20)
    assert replay.returncode == 0
    assert "3 messages said again, 1 left out" in err
    again = [a for a in heard if a.rig == "other"]
    assert [a.message.points_cm for a in again] == [s.points_cm for s in stems]
    assert all(a.message.session == live.me.session for a in again)


def monitor_without_config(bus: Any, *arguments: str) -> subprocess.Popen[str]:
    process: subprocess.Popen[str] = bus.start("flora-monitor", *arguments)
    return process


def test_replay_does_not_drive_a_living_rig_unasked(live: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    record = monitor(live, "record", str(file), "tick", "--count", "1")
    record.communicate(timeout=20)
    live.sections["rig"]["health_every_s"] = 10.0
    replay = monitor(live, "replay", str(file))
    assert replay.stderr is not None
    assert "waiting 25 s for a sign of life" in replay.stderr.readline()
    live.me.publish(Health(state="ready"))
    _, err = replay.communicate(timeout=20)
    assert replay.returncode == 2
    assert err == (
        "flora-monitor: flora-flash of rig `test` is on this bus and would take the recording for real; "
        "use --rig NEW, or --force\n"
    )


def test_replay_drives_no_rig_of_which_the_bus_does_not_say_whether_it_lives(bus: Any, tmp_path: Path) -> None:
    from flora_common.recording import RecordingWriter

    light = LightCommand(light="left", source="flora-controller", seq=1)
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.add(Arrival(encode("test", light), "good", "test", light), utc_ns=1, rig="test")
    file = writer.close()
    with zmq.Context() as context, context.socket(zmq.XSUB) as hears, context.socket(zmq.XPUB) as says:
        hears.bind(bus.address.publish)
        hears.send(b"\x01")
        says.bind(bus.address.subscribe)  # and stands still, as the bus of a busy machine may for some seconds
        replay = monitor(bus, "replay", str(file), "--as-fast")
        while replay.poll() is None:
            assert not hears.poll(50), "it was said for real"
        assert not hears.poll(500), "it was said for real"
    _, err = replay.communicate(timeout=20)
    assert replay.returncode == 1
    assert err == (
        f"flora-monitor: the bus at {bus.address.publish} does not answer: it hangs, or its machine is too busy; look "
        "again in a minute, and nobody else says whether rig `test` is alive; try again, use --rig NEW, or --force\n"
    )


def test_a_replay_that_stood_still_while_it_looked_for_the_bus_looks_on(bus: Any, tmp_path: Path) -> None:
    door_file = Path(bus.address.publish.removeprefix("ipc://"))
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(door_file))
        door.listen()
        door.settimeout(20.0)
        replay = monitor(bus, "replay", str(recording(tmp_path)), "--rig", "other")
        with door.accept()[0]:
            replay.send_signal(signal.SIGSTOP)  # as on a busy machine
    door_file.unlink()
    bus.start_service("flora-bus")
    bus.client()
    time.sleep(NO_BUS_AFTER_S)
    replay.send_signal(signal.SIGCONT)
    _, err = replay.communicate(timeout=20)
    assert replay.returncode == 0, err


def test_what_a_replay_left_at_the_bus_is_no_living_rig(live: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    record = monitor(live, "record", str(file), "*/[th]*", "--count", "2")
    record.communicate(timeout=20)
    live.sections["rig"]["health_every_s"] = 0.4
    for _ in range(2):
        replay = monitor(live, "replay", str(file), "--rig", "other", "--as-fast")
        _, err = replay.communicate(timeout=20)
        assert replay.returncode == 0, err
        assert "2 messages said again" in err


def test_a_service_that_nobody_knows_is_refused_and_one_that_need_not_be_there_is_missed(live: Any) -> None:
    for name, said in (
        ("flora-stam", "; did you mean `flora-stem`?"),
        ("typo*", "; known: flora-bus, flora-capture, "),
    ):
        unknown = monitor(live, "health", name)
        out, err = unknown.communicate(timeout=20)
        assert (unknown.returncode, out) == (2, "")
        assert err.startswith(f"flora-monitor: no service is called `{name}`{said}")
        assert err.count("\n") == 1
    lab = monitor(live, "health", "flora-lab")
    out, _ = lab.communicate(timeout=20)
    assert lab.returncode == 1
    assert [(line["service"], line["state"]) for line in lines_of(out)] == [("flora-lab", "never heard")]


def test_check_of_a_cut_file_says_where_and_fails(live: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    monitor(live, "record", str(file), "tick", "--count", "1").communicate(timeout=20)
    file.write_bytes(file.read_bytes()[:-40])
    check = monitor_without_config(live, "check", str(file))
    out, _ = check.communicate(timeout=20)
    checked = json.loads(out)
    assert check.returncode == 1
    assert checked["messages"] == 1
    assert "not readable after byte" in checked["problem"]


def test_check_takes_several_files_and_its_status_is_the_worst(tmp_path: Path) -> None:
    whole = recording(tmp_path)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-40])
    for files, status in (([whole, whole], 0), ([cut, whole], 1), ([cut, tmp_path / "none.mcap", whole], 2)):
        done = subprocess.run(
            [*live_command("check"), *map(str, files)], capture_output=True, text=True, check=False, timeout=20
        )
        assert done.returncode == status
        there = [file for file in files if file.exists()]
        checked = lines_of(done.stdout)
        assert [(c["file"], c["whole"]) for c in checked] == [(str(file), file == whole) for file in there]
        assert done.stderr.count("cannot be read (No such file or directory)") == len(files) - len(there)


def test_check_of_a_file_whose_name_is_no_text_tells_it_as_far_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"b\xff.mcap")
    recording(tmp_path).rename(file)
    done = subprocess.run([*live_command("check"), str(file)], capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["file"] == f"{tmp_path}/b\N{REPLACEMENT CHARACTER}.mcap"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tail", "--rig", "Box 1"], "--rig 'Box 1': a rig's name is small letters"),
        (["tail", "--subscribe", "nowhere"], "--subscribe: `bus_subscribe` "),
        (["tail", "--subscribe", "tcp://10.0.0.3:5572"], "bus_subscribe is tcp://10.0.0.3:5572, which other machines"),
        (["tail", "--publish", "tcp://127.0.0.1"], "bus_publish is tcp://127.0.0.1, without a port"),
        (["tail", "--publish", "tcp://127.0.0.1:*"], "tcp://127.0.0.1:*: nothing can be looked for there"),
        (["record", "a.txt"], "a.txt: a recording's name ends in .mcap"),
        (["tail", "test/[tick"], "pattern 'test/[tick': `[` without `]`; no topic fits it"),
        (["rates", "[!]"], "`[` without `]`"),
        (["topics", "[]"], "`[` without `]`"),
        (["health", "flora-[fl"], "`[` without `]`"),
        (["record", "a.mcap", "[t]*["], "`[` without `]`"),
        (["record", "/dev/null/a.mcap"], "/dev/null/a.mcap: cannot be written, /dev/null is no folder; name another"),
        (["record", "/proc/a.mcap"], "name another place with FILE"),  # in which not even root may make a file
        (["replay", "a.mcap", "--only", "["], "`[` without `]`"),
        (["replay", "a.mcap", "--as-fast", "--rate", "2"], "give either --as-fast or --rate"),
        (["check"], "check --help"),
        (["check", "none.mcap"], "none.mcap: cannot be read (No such file or directory)"),
        (["replay", "none.mcap"], "none.mcap: cannot be read (No such file or directory)"),
        (["tail", "--config", "none.toml"], "none.toml: cannot be read (No such file or directory)"),
        (["tail", "--count", "many"], "--count"),
    ],
)
def test_bad_arguments_are_one_line_and_status_two(arguments: list[str], said: str) -> None:
    done = subprocess.run([*live_command(arguments[0]), *arguments[1:]], capture_output=True, text=True, timeout=20)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
