"""Once per tick, whole JPEGs, the exposure that was asked for, and a ledger that nothing falls out of."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device_fakes import GOOD_METADATA, tiny_jpeg
from flora_capture.core import LockedExposure, Sequence, exposure_note, exposure_of
from flora_capture.store import FrameRecord, Store
from flora_capture.wire import Answer, Assembler, pack
from flora_common.errors import BadPicture, BadRunFolder, CameraGone, DiskFull, StoreError
from flora_common.messages import Flash
from flora_common.runs import RunFolder
from flora_common.vision.header import picture_size

LOCKED = LockedExposure(20_000.0, 1.0, 1.9, 1.6, exposure_tolerance=0.02, gain_tolerance=0.05)


def lit(tick: int) -> Flash:
    return Flash(tick=tick, lit=True, confirmed=True)


def dark(tick: int) -> Flash:
    return Flash(tick=tick, lit=False, confirmed=True)


def test_a_tick_is_photographed_once() -> None:
    sequence = Sequence()
    assert sequence.hear(lit(3)) == "shoot"
    assert sequence.hear(lit(3)) == "nothing"
    sequence.finish(3)
    assert sequence.hear(lit(3)) == "again"
    assert sequence.hear(dark(3)) == "nothing"
    assert sequence.hear(lit(2)) == "nothing"
    assert sequence.hear(lit(4)) == "shoot"


def test_a_tick_that_belongs_to_none_is_ignored() -> None:
    assert Sequence().hear(lit(0)) == "nothing"


def test_a_flash_that_is_over_is_too_late() -> None:
    sequence = Sequence(done=3)
    assert sequence.hear(dark(4)) == "too_late"
    assert sequence.hear(dark(2)) == "nothing"


def test_a_flash_that_goes_dark_before_the_picture_is_there_is_not_confirmed() -> None:
    sequence = Sequence()
    sequence.hear(lit(1))
    assert sequence.hear(dark(1)) == "nothing"
    assert sequence.shot is not None
    assert not sequence.shot.flash_confirmed


def test_the_size_is_read_from_the_frame_header() -> None:
    assert picture_size(tiny_jpeg(), where="photograph") == (64, 48)
    assert picture_size(tiny_jpeg() + b"\0\0\0", where="photograph") == (64, 48)  # some cameras pad


@given(st.integers(0, len(tiny_jpeg()) - 1))
def test_every_torn_jpeg_is_refused(length: int) -> None:
    with pytest.raises(BadPicture):
        picture_size(tiny_jpeg()[:length], where="photograph")


@given(st.binary(max_size=200), st.booleans())
def test_nonsense_is_refused_and_never_loops(data: bytes, in_frame: bool) -> None:
    data = b"\xff\xd8" + data + b"\xff\xd9" if in_frame else data
    try:
        width_px, height_px = picture_size(data, where="photograph")
    except BadPicture:
        return
    assert 1 <= width_px <= 20_000
    assert 1 <= height_px <= 20_000


def test_the_locked_exposure_within_its_tolerance_is_good() -> None:
    assert exposure_note(exposure_of(GOOD_METADATA), LOCKED) == ""
    quantised = {**GOOD_METADATA, "ExposureTime": 19_985, "AnalogueGain": 1.004}
    assert exposure_note(exposure_of(quantised), LOCKED) == ""


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ({"ExposureTime": 16_000}, "exposure in us is 16000, locked at 20000"),
        ({"DigitalGain": 1.4}, "digital gain is 1.4, locked at 1"),
        ({"ColourGains": [2.4, 1.6]}, "red gain is 2.4, locked at 1.9"),
        ({"ColourGains": [1.9, float("nan")]}, "the camera does not tell blue gain"),
        ({"ColourGains": "x", "AnalogueGain": -1.0}, "the camera does not tell analogue gain, red gain, blue gain"),
        ({"ExposureTime": True}, "the camera does not tell exposure in us"),
    ],
)
def test_what_differs_is_told(change: dict[str, object], note: str) -> None:
    assert exposure_note(exposure_of({**GOOD_METADATA, **change}), LOCKED) == note


def test_a_camera_that_tells_nothing_is_told_of() -> None:
    assert exposure_note(exposure_of({}), LOCKED) == "the camera does not tell its exposure"


@given(st.lists(st.binary(max_size=300), max_size=4), st.integers(1, 50))
def test_answers_come_together_from_any_pieces(jpegs: list[bytes], piece: int) -> None:
    data = b"".join(pack(Answer(number, jpeg=jpeg)) for number, jpeg in enumerate(jpegs))
    assembler = Assembler()
    answers = [a for at in range(0, len(data), piece) for a in assembler.add(data[at : at + piece])]
    assert [(a.number, a.jpeg) for a in answers] == list(enumerate(jpegs))


@pytest.mark.parametrize("data", [b"\xff\xff\xff\xff", b"\0\0\0\x02{}", b"\0\0\0\x01\xc1"])
def test_a_child_that_sends_nonsense_is_gone(data: bytes) -> None:
    with pytest.raises(CameraGone):
        Assembler().add(data)


# the ledger


def record(tick: int, **changes: object) -> FrameRecord:
    fields = {
        "tick": tick, "file": f"frames/{tick:06d}.jpg", "sha256": "", "bytes": 0, "width_px": 64, "height_px": 48,
        "purpose": "run", "light": "left", "flash": True, "time_s": 300.0 * (tick - 1), "t_utc_ns": 1,
        "metadata": GOOD_METADATA, **changes,
    }  # fmt: skip
    return FrameRecord(**fields)  # type: ignore[arg-type]


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    (tmp_path / "bean-07").mkdir()
    (tmp_path / "bean-07" / "run.toml").touch()
    return RunFolder(tmp_path / "bean-07")


def test_the_ledger_outlasts_a_restart(run: RunFolder) -> None:
    store = Store(run)
    store.add(tiny_jpeg(), record(1))
    store.add(tiny_jpeg(), record(2, purpose="background", file="background/left.jpg"))
    store.complete_csv()
    again = Store(run)
    assert again.last is not None
    assert (again.last.tick, again.taken, again.whole(again.last)) == (2, 1, True)
    message = again.last.message("bean-07")
    assert (message.path, message.purpose, message.exposure_us) == ("background/left.jpg", "background", 20_000.0)
    assert [row.file for row in run.read_frames()] == ["frames/000001.jpg"]


def test_lines_that_the_csv_lacks_are_added_in_order_and_once(run: RunFolder) -> None:
    store = Store(run)
    store.add(tiny_jpeg(), record(1))
    store.complete_csv()
    store.add(tiny_jpeg(), record(2))
    store.add(tiny_jpeg(), record(3))
    for _ in range(2):
        Store(run).complete_csv()
    assert [(row.time_s, row.light) for row in run.read_frames()] == [(0.0, "left"), (300.0, "left"), (600.0, "left")]


def test_a_torn_last_line_is_passed_over_and_its_picture_keeps_its_name(run: RunFolder) -> None:
    store = Store(run)
    store.add(tiny_jpeg(), record(1))
    store.add(tiny_jpeg(), record(2))
    run.frames_log.write_bytes(run.frames_log.read_bytes()[:-30])
    again = Store(run)
    assert again.last is not None
    assert again.last.tick == 1
    assert again.name_for(2, "run", "") == "frames/000002-2.jpg"


def test_a_picture_that_is_not_what_was_listed_is_noticed(run: RunFolder) -> None:
    store = Store(run)
    listed = store.add(tiny_jpeg(), record(1))
    (run.path / listed.file).write_bytes(tiny_jpeg(7))
    assert not store.whole(listed)


@pytest.mark.parametrize("shot", ["", "../x.jpg", "a/b.jpg", "left.png", ".jpg", "Left.jpg", "left.jpg\n"])
def test_a_name_that_is_none_is_refused(run: RunFolder, shot: str) -> None:
    with pytest.raises(StoreError, match="not a name"):
        Store(run).name_for(1, "background", shot)


DAMAGE = [b"\n", b"\n\n", b"\0" * 30 + b"\n", b"frames/000002.jpg;600;left\n", b"frames/000002.jpg,nan,left\n"]


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_end_of_the_table_is_made_anew_and_kept_aside(run: RunFolder, damage: bytes) -> None:
    store = Store(run)
    for tick in (1, 2):
        store.add(tiny_jpeg(), record(tick))
    store.complete_csv()
    whole = run.frames_csv.read_bytes()
    damaged = b"".join(line + b"\n" for line in whole.split(b"\n")[:2]) + damage
    run.frames_csv.write_bytes(damaged)

    again = Store(run)
    again.complete_csv()

    (aside,) = run.path.glob("frames.csv.damaged-*")
    assert aside.read_bytes() == damaged
    assert run.frames_csv.read_bytes() == whole
    assert str(aside) in again.mended
    assert Store(run).mended == ""


@pytest.mark.parametrize("torn", [b"frames/0000", b"\0" * 5000])
def test_what_a_power_cut_has_torn_at_the_end_of_the_table_adds_no_line_twice(run: RunFolder, torn: bytes) -> None:
    store = Store(run)
    for tick in (1, 2):
        store.add(tiny_jpeg(), record(tick))
    store.complete_csv()
    whole = run.frames_csv.read_bytes()
    run.frames_csv.write_bytes(whole + torn)
    again = Store(run)
    again.add(tiny_jpeg(), record(3))
    again.complete_csv()
    assert [row.time_s for row in run.read_frames()] == [record(tick).time_s for tick in (1, 2, 3)]


def test_a_table_of_nothing_but_damage_is_made_anew(run: RunFolder) -> None:
    store = Store(run)
    store.add(tiny_jpeg(), record(1))
    store.complete_csv()
    whole = run.frames_csv.read_bytes()
    run.frames_csv.write_bytes(b"\n")
    Store(run).complete_csv()
    assert run.frames_csv.read_bytes() == whole


def test_a_damaged_table_that_cannot_be_mended_is_one_clear_line(
    run: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:
        raise DiskFull("no room on the disk")

    monkeypatch.setattr("flora_capture.store.write_bytes", no_room)
    run.frames_csv.write_text("file,time_s,light\nframes/000001.jpg;0;left\n")
    with pytest.raises(BadRunFolder, match=r"frames\.csv: the last line is damaged"):
        Store(run)


@pytest.mark.parametrize("table", ["frames.jsonl", "frames.csv"])
def test_a_table_that_cannot_be_read_is_told_in_a_line(run: RunFolder, table: str) -> None:
    (run.path / table).mkdir()
    with pytest.raises(BadRunFolder, match=rf"{table}: cannot be read \(Is a directory\); check its disk"):
        Store(run)
