"""Recordings on disk: whole, cut, damaged, on a full disk; with no bus."""

from __future__ import annotations

import errno
import os
import random
import struct
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from fake_clock import FakeClock
from flora_common import recording
from flora_common.bus import Arrival
from flora_common.errors import BadInput, DiskFull, StoreError
from flora_common.messages import Message, Recording, Stem, Tick, encode
from flora_common.recording import OPEN_SUFFIX, UNREADABLE, RecordingWriter
from flora_common.recording_reader import Recorded, RecordingReader, recover
from flora_common.runs import RunFolder
from flora_recorder.core import Limits, Recorder
from flora_recorder.main import place_check


def arrival(message: Message, *, seq: int, rig: str = "box1") -> Arrival:
    stamped = msgspec.structs.replace(message, seq=seq, t_utc_ns=1_700_000_000_000_000_000 + seq, source="test")
    return Arrival(encode(rig, stamped), "good", rig, stamped)


def stem(seq: int) -> Arrival:
    points = tuple((random.Random(seq + i).uniform(-5, 5), 2.0 * i) for i in range(10))
    return arrival(Stem(tick=seq, time_s=300.0 * seq, outcome="ok", points_cm=points), seq=seq)


def read(path: Path) -> tuple[list[Recorded], str]:
    reader = RecordingReader(path)
    return list(reader), reader.problem


def written(path: Path, count: int, *, flush_every: int = 100) -> Path:
    """An open recording of ``count`` stems as a crash would leave it: flushed, not finished."""
    writer = RecordingWriter(path)
    for seq in range(1, count + 1):
        writer.add(stem(seq), utc_ns=0)
        if seq % flush_every == 0:
            writer.flush()
    writer.flush()
    writer._file.close()
    return writer.open_path


def test_what_is_recorded_is_read_back(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", metadata={"run": "bean-07"})
    sent = [stem(seq) for seq in range(1, 50)]
    for one in sent:
        writer.add(one, utc_ns=0)
    writer.add(Arrival([b"box1/tick", b"\xc1", b"0"], "bad", reason="tick: not msgpack"), utc_ns=77, rig="box1")
    writer.add(Arrival(sent[0].parts, "repeated", "box1", sent[0].message), utc_ns=0)
    assert not (tmp_path / "a.mcap").exists()
    path = writer.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    recorded, problem = read(path)
    assert problem == ""
    assert [r.payload for r in recorded[:-1]] == [a.parts[1] for a in sent]
    assert [r.sequence for r in recorded[:-1]] == list(range(1, 50))
    assert recorded[-1].topic == f"box1/{UNREADABLE}"
    assert recorded[-1].log_time_ns == 77
    assert not recorded[-1].is_readable
    assert (writer.messages, writer.bad) == (50, 1)


def test_other_readers_find_schema_channel_and_index(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.add(stem(1), utc_ns=0)
    writer.add(Arrival([b"x", b"y"], "bad", reason="2 frames"), utc_ns=5)
    path = writer.close()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        channels = {c.topic: c for c in summary.channels.values()}
        assert set(channels) == {"box1/stem", UNREADABLE}
        for channel in channels.values():  # PlotJuggler looks each schema up without asking whether there is one
            schema = summary.schemas[channel.schema_id]
            assert schema.encoding == "jsonschema"
            assert "$defs" in msgspec.json.decode(schema.data)
            assert channel.message_encoding == "msgpack"
        assert channels["box1/stem"].metadata == {"owner": "flora-stem", "version": "3"}
        messages = list(reader.iter_messages(topics=["box1/stem"]))
    assert len(messages) == 1
    assert msgspec.msgpack.decode(messages[0][2].data)["outcome"] == "ok"


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9, 0.99])
def test_cut_file_gives_back_what_was_whole(tmp_path: Path, share: float) -> None:
    count = 2000
    open_path = written(tmp_path / "a.mcap", count)
    size = open_path.stat().st_size
    with open_path.open("r+b") as file:
        file.truncate(int(size * share))
    found = recover(open_path)
    assert found.path == tmp_path / "a.mcap"
    assert found.problem.startswith("not readable after byte")
    recorded, problem = read(found.path)
    assert problem == ""
    assert len(recorded) == found.messages
    # Chunks of 100: at most one is torn, and what comes before it is complete and in order.
    assert share * count - 200 < len(recorded) <= share * count + 100
    assert [r.sequence for r in recorded] == list(range(1, len(recorded) + 1))
    assert not open_path.exists()


def test_recovering_twice_and_after_a_kill_in_between_is_the_same(tmp_path: Path) -> None:
    open_path = written(tmp_path / "a.mcap", 300)
    left = open_path.read_bytes()
    recover(open_path)
    first = (tmp_path / "a.mcap").read_bytes()
    open_path.write_bytes(left)  # as if killed after the rename, before the open file was removed
    found = recover(open_path)
    assert found.messages == 300
    assert (tmp_path / "a.mcap").read_bytes() == first


def test_every_flipped_byte_is_noticed_or_harmless(tmp_path: Path) -> None:
    open_path = written(tmp_path / "a.mcap", 60, flush_every=20)
    good = open_path.read_bytes()
    payloads = {r.payload for r in RecordingReader(open_path)}
    draw = random.Random(1)
    for place in range(8, len(good), len(good) // 2000 + 1):
        data = bytearray(good)
        data[place] ^= 1 << draw.randrange(8)
        open_path.write_bytes(data)
        recorded, problem = read(open_path)
        assert problem  # the end of file is missing in any case; what counts is that nothing else is raised
        assert {r.payload for r in recorded} <= payloads


def test_a_damaged_index_is_told_and_recovered(tmp_path: Path) -> None:
    path = recover(written(tmp_path / "a.mcap", 60)).path
    assert path is not None
    good = path.read_bytes()
    messages, problem = read(path)
    assert (len(messages), problem) == (60, "")
    index_at = struct.unpack("<Q", good[-28:-20])[0]  # as the footer tells it
    told: list[str] = []
    for place in (*range(index_at, len(good) - 8, 97), len(good) - 25):
        data = bytearray(good)
        data[place] ^= 1
        path.write_bytes(data)
        recorded, problem = read(path)
        assert recorded == messages
        assert problem.startswith(("damaged index: ", "not readable after byte"))
        told.append(problem)
        found = recover(path.rename(tmp_path / "a.mcap.open"))
        assert (found.path, found.messages, found.problem) == (path, 60, problem)
        assert read(path) == (messages, "")
    assert any("named a.mcap.open in a run's bus/ it is recovered" in problem for problem in told)


def test_an_index_without_a_check_sum_is_not_judged(tmp_path: Path) -> None:
    path = recover(written(tmp_path / "a.mcap", 60)).path
    assert path is not None
    path.write_bytes(path.read_bytes()[:-12] + bytes(4) + path.read_bytes()[-8:])
    assert read(path)[1] == ""


@pytest.mark.parametrize("kind", ["pipe", "folder"])
def test_what_is_no_regular_file_is_no_recording(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.mcap"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(BadInput, match=r"a\.mcap: not a regular file"):
        RecordingReader(path)


def test_empty_and_hopeless_left_overs(tmp_path: Path) -> None:
    empty = tmp_path / "a.mcap.open"
    empty.touch()
    assert recover(empty).path is None
    assert not empty.exists()
    nothing_said = written(tmp_path / "b.mcap", 0)
    assert recover(nothing_said).path is None
    assert not nothing_said.exists()
    rubbish = tmp_path / "c.mcap.open"
    rubbish.write_bytes(b"rubbish" * 1000)
    found = recover(rubbish)
    assert found.path == tmp_path / "c.mcap.damaged"
    torn_first_chunk = written(tmp_path / "d.mcap", 500, flush_every=1000)
    with torn_first_chunk.open("r+b") as file:
        file.truncate(torn_first_chunk.stat().st_size // 2)
    assert recover(torn_first_chunk).path == tmp_path / "d.mcap.damaged"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.mcap.damaged", "d.mcap.damaged"]


def test_length_bombs_are_refused_before_memory_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + b"\x06" + (2**40).to_bytes(8, "little") + b"x" * 100)
    recorded, problem = read(path)
    assert recorded == []
    assert "not readable after byte" in problem


def test_file_that_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("time_s,light\n")
    with pytest.raises(BadInput, match=r"a\.mcap: not an MCAP file"):
        RecordingReader(path)
    with pytest.raises(BadInput, match=r"none\.mcap: cannot be read \(No such file or directory\)"):
        RecordingReader(tmp_path / "none.mcap")
    with pytest.raises(BadInput, match=r"a\.mcap: exists already; choose another name"):
        RecordingWriter(path)


def full(times: int) -> Any:
    """A disk that takes half of what is written and then says that it is full, so many times."""
    real = recording.write_all
    left = times

    def write_all(file: Any, data: bytearray) -> None:
        nonlocal left
        if left > 0:
            left -= 1
            real(file, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file, data)

    return write_all


def test_full_disk_leaves_no_torn_bytes_and_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.add(stem(1), utc_ns=0)
    writer.flush()
    size = writer.open_path.stat().st_size
    monkeypatch.setattr(recording, "write_all", full(3))
    for seq in (2, 3, 4):
        writer.add(stem(seq), utc_ns=0)
        with pytest.raises(DiskFull, match=r"a\.mcap\.open: no room on the disk; free some space"):
            writer.flush()
        assert writer.open_path.stat().st_size == size
    writer.flush()
    recorded, problem = read(writer.close())
    assert ([r.sequence for r in recorded], problem) == ([1, 2, 3, 4], "")


def test_memory_is_bounded_while_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "MAX_PENDING_BYTES", 20_000)
    monkeypatch.setattr(recording, "CHUNK_BYTES", 4096)
    monkeypatch.setattr(recording, "write_all", full(10**9))
    writer = RecordingWriter(tmp_path / "a.mcap")
    for seq in range(1, 1000):
        writer.add(stem(seq), utc_ns=0)
    assert writer.lost > 0
    assert writer.messages + writer.lost == 999
    assert writer.bytes < 60_000
    with pytest.raises(DiskFull):
        writer.close()
    assert not list(tmp_path.iterdir())  # nothing had been flushed: an empty file would only be in the way


def test_what_was_flushed_before_the_disk_was_full_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.add(stem(1), utc_ns=0)
    writer.flush()
    monkeypatch.setattr(recording, "write_all", full(10**9))
    with pytest.raises(DiskFull):
        writer.close()
    assert writer.open_path.stat().st_size > 0


def make_recorder(
    folder: Path, clock: FakeClock, said: list[Recording], *, gone: list[str] | None = None, **limits: int
) -> Recorder:
    bounds = {"rotate_bytes": 1 << 20, "rotate_ns": 3600 * 10**9} | limits
    on_gone = ([] if gone is None else gone).append
    return Recorder(folder, rig="box1", limits=Limits(**bounds), clock=clock, say=said.append, on_gone=on_gone)


def hear_all(recorder: Recorder, numbers: range) -> None:
    for seq in numbers:
        recorder.hear(stem(seq))


def test_recorder_rotates_by_rig_time_and_never_takes_a_name_twice(tmp_path: Path) -> None:
    clock, said = FakeClock(), []
    recorder = make_recorder(tmp_path, clock, said)
    for seq in range(1, 7):
        recorder.hear(stem(seq))
        clock.advance(1800)
        clock.jump_utc(-1800)  # the wall clock stands still: names must differ all the same
    recorder.close()
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == [f"20231114T221320Z-{n:04d}.mcap" for n in range(1, len(names) + 1)]
    assert len(names) >= 3
    assert [r.sequence for name in names for r in read(tmp_path / name)[0]] == [1, 2, 3, 4, 5, 6]
    assert [s.path for s in said if s.closed] == [f"{tmp_path.name}/{name}" for name in names]


def test_recorder_leaves_a_full_disk_alone_until_the_next_flush(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, said = FakeClock(), []
    recorder = make_recorder(tmp_path, clock, said)
    recorder.hear(stem(1))
    monkeypatch.setattr(recording, "write_all", full(1))
    with pytest.raises(DiskFull):
        recorder.flush()
    recorder.hear(stem(2))
    recorder.flush()
    recorder.close()
    assert said[-1].messages == 2
    assert recorder.lost == 0


def test_recorder_counts_what_it_could_not_keep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "MAX_PENDING_BYTES", 20_000)
    monkeypatch.setattr(recording, "CHUNK_BYTES", 4096)
    clock, said = FakeClock(), []
    recorder = make_recorder(tmp_path, clock, said)
    recorder.flush()
    with monkeypatch.context() as patch:
        patch.setattr(recording, "write_all", full(10**9))
        with pytest.raises(DiskFull):
            hear_all(recorder, range(1, 1000))
        hear_all(recorder, range(1000, 2000))
    lost = recorder.lost
    assert lost > 0
    recorder.rotate()
    recorder.hear(stem(2000))
    assert recorder.lost == lost
    recorder.close()
    assert recorder.lost == lost


@pytest.mark.parametrize("call", ["scandir", "stat"])
def test_a_folder_that_its_disk_does_not_give_out_is_told_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    clock, said = FakeClock(), []
    recorder = make_recorder(tmp_path, clock, said)
    real = getattr(os, call)

    def bad(path: Any = ".", *arguments: Any, **keywords: Any) -> Any:
        if isinstance(path, str | Path) and Path(path).is_relative_to(tmp_path):
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return real(path, *arguments, **keywords)

    with monkeypatch.context() as patch:
        patch.setattr(os, call, bad)
        with pytest.raises(StoreError, match="Input/output error"):
            recorder.hear(stem(1))
        recorder.hear(stem(2))
    recorder.flush()
    recorder.hear(stem(3))
    recorder.close()
    assert (said[-1].messages, recorder.lost) == (1, 2)


@pytest.mark.parametrize("how", ["folder deleted", "file deleted", "another in its place", "folder is a file"])
def test_a_recording_that_is_deleted_is_noticed_at_the_next_flush(tmp_path: Path, how: str) -> None:
    clock, said, gone = FakeClock(), [], []
    folder = tmp_path / "bus"
    recorder = make_recorder(folder, clock, said, gone=gone)
    recorder.hear(stem(1))
    recorder.flush()
    assert gone == []
    (first,) = folder.iterdir()
    first.unlink()
    if how == "another in its place":
        first.write_bytes(b"of somebody else")
    elif how != "file deleted":
        folder.rmdir()
    if how == "folder is a file":
        folder.touch()
        with pytest.raises(StoreError, match="cannot be written"):
            recorder.flush()
        folder.unlink()
    recorder.flush()
    assert gone == [
        f"{first} was deleted or moved while it was written, with 1 message; the recording goes on in a new file"
    ]
    recorder.flush()
    assert len(gone) == 1
    recorder.hear(stem(2))
    recorder.close()
    (second,) = folder.glob("*.mcap")
    assert [r.sequence for r in read(second)[0]] == [2]
    assert said[-1].path == f"bus/{second.name}"
    assert second.name != first.name.removesuffix(".open")
    if how == "another in its place":
        assert first.read_bytes() == b"of somebody else"


@pytest.mark.parametrize("when", ["flush", "rotation"])
def test_a_recording_that_is_moved_is_whole_where_it_is_now(tmp_path: Path, when: str) -> None:
    clock, said, gone = FakeClock(), [], []
    folder = tmp_path / "bus"
    recorder = make_recorder(folder, clock, said, gone=gone)
    recorder.hear(stem(1))
    recorder.flush()
    recorder.hear(stem(2))  # waits in memory
    folder.rename(tmp_path / "aside")
    if when == "rotation":
        clock.advance(3601.0)
        recorder.hear(stem(3))
    else:
        recorder.flush()
        recorder.hear(stem(3))
    recorder.close()
    assert len(gone) == 1
    (moved,) = (tmp_path / "aside").iterdir()
    recorded, problem = read(moved)
    assert problem == ""
    there = [r.sequence for path in (moved, *sorted(folder.iterdir())) for r in read(path)[0]]
    assert [r.sequence for r in recorded][:2] == [1, 2]
    assert there == [1, 2, 3]


@pytest.mark.parametrize("how", ["moved", "another run"])
def test_a_run_folder_that_is_moved_away_is_not_begun_anew_in_its_place(tmp_path: Path, how: str) -> None:
    run, here, other = RunFolder(tmp_path / "current"), tmp_path / "bean-1", tmp_path / "bean-2"
    for folder in (here, other):
        folder.mkdir()
        (folder / "run.toml").touch()
    run.path.symlink_to(here)
    said: list[Recording] = []
    gone: list[str] = []
    recorder = Recorder(
        run.bus,
        rig="box1",
        limits=Limits(1 << 20, 3600 * 10**9),
        clock=FakeClock(),
        say=said.append,
        on_gone=gone.append,
        check_place=place_check(run),
    )
    recorder.hear(stem(1))
    recorder.flush()
    if how == "moved":
        here.rename(tmp_path / "elsewhere")
        reason = "the run folder was moved or removed"
    else:
        run.path.unlink()
        run.path.symlink_to(other)
        reason = "leads to another run than at the start"
    with pytest.raises(StoreError, match=reason):
        recorder.flush()
    recorder.hear(stem(2))
    with pytest.raises(StoreError, match=reason):
        recorder.flush()
    assert [sentence.partition("; ")[2] for sentence in gone] == [
        "the recording goes on in a new file once the run folder is back"
    ]
    assert not here.exists() or how == "another run"
    assert not (other / "bus").exists()
    if how == "moved":
        (tmp_path / "elsewhere").rename(here)
    else:
        run.path.unlink()
        run.path.symlink_to(here)
    recorder.flush()
    recorder.hear(stem(3))
    recorder.close()
    assert recorder.lost == 1
    assert [r.sequence for path in sorted((here / "bus").iterdir()) for r in read(path)[0]] == [1, 3]


def test_a_run_folder_that_its_disk_does_not_give_out_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = RunFolder(tmp_path)
    run.run_toml.touch()
    check = place_check(run)

    def bad(*_: object) -> bool:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "is_file", bad)
    with pytest.raises(StoreError, match=r"run\.toml: cannot be looked at \(Input/output error\)"):
        check()


def test_recorder_finishes_left_over_files_but_not_its_own(tmp_path: Path) -> None:
    written(tmp_path / "20231114T221320Z-0007.mcap", 10)
    (tmp_path / ".20231114T221320Z-0007.mcap.abc.part").write_bytes(b"of a killed recovery")
    clock, said = FakeClock(), []
    recorder = make_recorder(tmp_path, clock, said)
    recorder.hear(arrival(Tick(tick=1, time_s=0.0), seq=1))
    (found,) = recorder.recover_left_over()
    assert found.messages == 10
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "20231114T221320Z-0007.mcap",
        f"20231114T221320Z-0008.mcap{OPEN_SUFFIX}",
    ]
    recorder.close()


def test_recorder_leaves_alone_what_somebody_records_by_hand_in_its_folder(tmp_path: Path) -> None:
    by_hand = RecordingWriter(tmp_path / "by-hand.mcap")
    by_hand.add(stem(1), utc_ns=0)
    by_hand.flush()
    recorder = make_recorder(tmp_path, FakeClock(), [])
    assert recorder.recover_left_over() == []
    by_hand.add(stem(2), utc_ns=0)
    assert [r.sequence for r in read(by_hand.close())[0]] == [1, 2]
