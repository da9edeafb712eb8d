"""The stem service's core on drawn pictures: one answer per tick, whatever happened."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from stem_fakes import HEIGHT, WIDTH, Box, empty, jpeg, with_stem

from flora_common.errors import DiskFull
from flora_common.messages import FrameMissed
from flora_common.tracks import read_track
from flora_common.vision.picture import Picture
from flora_common.vision.reading import StemReading
from flora_stem.background import NO_BACKGROUND
from flora_stem.record import RECORD_FILE, StemRecord, last_track_row, read_record


@pytest.fixture
def box(tmp_path: Path) -> Box:
    made = Box(tmp_path)
    made.calibrate()
    return made


def missed(tick: int) -> FrameMissed:
    return FrameMissed(tick=tick, time_s=tick * 300.0, because="camera_hung", reason="killed")


def test_a_picture_that_the_finder_fails_on_is_answered_and_the_next_is_read(
    box: Box, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(picture: Picture, time_s: float) -> StemReading:
        raise ZeroDivisionError("of two\nlines")

    with monkeypatch.context() as patched:
        patched.setattr(box.background.finder, "read", fails)
        stem = box.answer(box.frame(1, jpeg(with_stem(3.0, 12.0))))
    assert stem.outcome == "bad_picture"
    assert re.search(r"ZeroDivisionError at test_stem_core\.py:\d+: of two lines$", stem.reason)
    assert box.answer(box.frame(2, jpeg(with_stem(3.0, 12.0)))).outcome == "ok"


def test_a_stem_is_found_said_and_written(box: Box) -> None:
    stem = box.answer(box.frame(1, jpeg(with_stem(3.0, 12.0))))

    assert (stem.tick, stem.time_s, stem.outcome, stem.light) == (1, 300.0, "ok", "left")
    assert stem.run == "run"
    assert len(stem.points_cm) == 10
    assert stem.points_cm[0] == (0.0, 0.0)
    assert stem.points_cm[9] == pytest.approx((3.0, 12.0), abs=0.7)
    assert stem.quality > 0.9
    track = read_track(box.run.track_csv)
    assert track.points_cm[0] == pytest.approx(np.array(stem.points_cm), abs=1e-4)
    assert track.light == ("left",)


def test_without_background_pictures_there_is_no_stem_and_it_says_what_to_do(tmp_path: Path) -> None:
    box = Box(tmp_path)

    stem = box.answer(box.frame(1, jpeg(with_stem(3.0, 12.0))))

    assert (stem.outcome, stem.reason, stem.points_cm) == ("no_stem", NO_BACKGROUND, ())
    assert box.core.why_not == NO_BACKGROUND
    assert box.times() == []
    box.calibrate()
    assert box.core.why_not == ""
    assert box.answer(box.frame(2, jpeg(with_stem(3.0, 12.0)))).outcome == "ok"


def test_an_empty_box_holds_no_stem(box: Box) -> None:
    assert box.answer(box.frame(1, jpeg(empty()))).outcome == "no_stem"
    assert box.times() == []


GOOD = jpeg(with_stem(3.0, 12.0))


@pytest.mark.parametrize(
    ("data", "changes", "said"),
    [
        (GOOD[:3000], {}, "cut short"),
        (b"", {}, "is empty"),
        (GOOD, {"sha256": "0" * 64}, "not the picture that was taken"),
        (GOOD, {"path": "frames/gone.jpg"}, "cannot be read"),
        (GOOD, {"run": "other"}, "belongs to the run `other`, this is `run`"),
        (jpeg(np.zeros((100, 100, 3), dtype=np.uint8)), {}, "is 100x100 px, expected 320x240"),
    ],
)
def test_a_picture_that_cannot_be_believed_is_no_stem(
    box: Box, data: bytes, changes: dict[str, object], said: str
) -> None:
    stem = box.answer(box.frame(1, data, **changes))

    assert (stem.outcome, stem.points_cm) == ("bad_picture", ())
    assert said in stem.reason
    assert box.times() == []


def test_a_flipped_bit_is_found(box: Box) -> None:
    frame = box.frame(1, GOOD)
    torn = bytearray(GOOD)
    torn[len(torn) // 2] ^= 1
    (box.run.path / frame.path).write_bytes(bytes(torn))

    assert box.answer(frame).outcome == "bad_picture"


def test_a_picture_in_another_light_is_no_plant(box: Box) -> None:
    stem = box.answer(box.frame(1, jpeg(np.full((HEIGHT, WIDTH, 3), 200, dtype=np.uint8))))

    assert stem.outcome == "bad_picture"
    assert "of the picture differ from the empty setup" in stem.reason


def test_a_tip_that_jumps_is_named_and_not_written(box: Box) -> None:
    box.answer(box.frame(1, jpeg(with_stem(0.0, 8.0))))

    jumped = box.answer(box.frame(2, jpeg(with_stem(6.0, 14.0))))
    after = box.answer(box.frame(3, jpeg(with_stem(6.0, 14.2))))

    assert (jumped.outcome, after.outcome) == ("jumped", "ok")
    assert len(jumped.points_cm) == 10
    assert box.times() == [300.0, 900.0]


@pytest.mark.parametrize("is_missed", [False, True])
def test_a_plant_under_the_name_of_the_run_before_is_not_followed_from_the_one_before(
    box: Box, is_missed: bool
) -> None:
    box.answer(box.frame(1, jpeg(with_stem(6.0, 14.0)), time_s=90_000.0))
    box.run.track_csv.unlink()
    box.start()
    if is_missed:
        box.core.on_missed(msgspec.structs.replace(missed(2), time_s=0.0))

    found = box.answer(box.frame(3, jpeg(with_stem(0.0, 4.0)), time_s=300.0))

    assert found.outcome == "ok"
    assert box.times() == [300.0]


def test_what_was_odd_about_the_photograph_is_told(box: Box) -> None:
    frame = box.frame(1, GOOD, flash_confirmed=False, exposure_ok=False, exposure_note="gain is 2")

    stem = box.answer(frame)

    assert (stem.outcome, stem.reason) == ("ok", "the flash was not confirmed; exposure: gain is 2")


def test_a_missed_frame_is_answered(box: Box) -> None:
    answer = box.core.on_missed(missed(1))

    assert answer is not None
    assert (answer.stem.outcome, answer.stem.tick, answer.row) == ("no_frame", 1, None)
    assert answer.stem.reason == "no photograph (camera_hung): killed"


def test_the_time_it_took_is_told(box: Box) -> None:
    readings = iter([100.0, 142.0])
    box.core._now_ms = lambda: next(readings)

    assert box.answer(box.frame(1, GOOD)).took_ms == 42.0


# Once per tick, through kills


def test_the_same_frame_again_is_the_same_answer_and_one_line(box: Box) -> None:
    frame = box.frame(1, GOOD)
    first = box.answer(frame)

    assert box.answer(frame) == first
    assert box.times() == [300.0]


def test_a_tick_is_answered_once_even_where_two_stories_are_told_of_it(box: Box) -> None:
    first = box.answer(box.frame(2, GOOD))

    answer = box.core.on_missed(missed(2))

    assert answer is not None
    assert answer.stem == first
    assert box.core.on_missed(missed(1)) is None
    assert box.core.on_frame(box.frame(1, GOOD)) is None


def test_killed_between_track_and_word_the_same_comes_again(box: Box) -> None:
    box.answer(box.frame(1, jpeg(with_stem(2.0, 10.0))))
    frame = box.frame(2, jpeg(with_stem(2.2, 10.3)))
    answer = box.core.on_frame(frame)
    assert answer is not None
    box.track.add(answer.row)  # and killed before the record was written

    box.start()
    again = box.answer(frame)

    assert again == answer.stem
    assert box.times() == [300.0, 600.0]


def test_killed_anywhere_the_run_reads_the_same(box: Box, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    other = Box(tmp_path / "b")
    other.calibrate()
    for tick in range(1, 15):
        data = jpeg(with_stem(0.2 * tick, 8.0 + 0.3 * tick)) if tick % 5 else jpeg(empty())
        frame = box.frame(tick, data)
        other.frame(tick, data)
        expected = box.answer(frame)
        assert other.answer(frame) == expected
        other.start()
    assert box.run.track_csv.read_bytes() == other.run.track_csv.read_bytes()


def test_the_previous_tip_comes_from_the_track_where_the_state_is_gone(box: Box) -> None:
    box.answer(box.frame(1, jpeg(with_stem(0.0, 8.0))))
    (box.state / RECORD_FILE).unlink()

    box.start()

    assert box.core.record.tip_px == pytest.approx((160.0, 140.0), abs=7.0)
    assert box.answer(box.frame(2, jpeg(with_stem(6.0, 14.0)))).outcome == "jumped"


def test_an_older_time_is_never_added_to_the_track(box: Box) -> None:
    box.answer(box.frame(1, GOOD, time_s=900.0))
    box.answer(box.frame(2, GOOD, time_s=900.0002))
    box.answer(box.frame(3, GOOD, time_s=600.0))
    box.start()
    box.answer(box.frame(4, GOOD, time_s=899.0))
    box.answer(box.frame(5, GOOD, time_s=1200.0))

    assert box.times() == [900.0, 1200.0]


def test_a_torn_last_line_is_overlooked_and_mended(box: Box) -> None:
    box.answer(box.frame(1, GOOD))
    with box.run.track_csv.open("ab") as file:
        file.write(b"600.000,left,0.0,0.")

    box.start()
    box.answer(box.frame(2, GOOD))

    assert box.times() == [300.0, 600.0]


def test_a_full_disk_delays_the_lines_of_the_track(box: Box, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise DiskFull("no room")

    answers = [box.core.on_frame(box.frame(tick, GOOD)) for tick in (1, 2, 3)]
    with monkeypatch.context() as patch:
        patch.setattr(box.run, "append_track", full)
        for answer in answers[:2]:
            assert answer is not None
            with pytest.raises(DiskFull):
                box.track.add(answer.row)
    assert answers[2] is not None
    box.track.add(answers[2].row)

    assert box.times() == [300.0, 600.0, 900.0]


@pytest.mark.parametrize("damage", [b"", b"{", b"\x00\xff", b'{"run": 3}'])
def test_a_damaged_record_is_as_none(tmp_path: Path, damage: bytes) -> None:
    (tmp_path / RECORD_FILE).write_bytes(damage)

    assert read_record(tmp_path / RECORD_FILE, run="r") == StemRecord(run="r")


def test_the_last_row_of_a_track_with_damaged_lines(tmp_path: Path) -> None:
    file = tmp_path / "track.csv"
    assert last_track_row(file) is None
    row = ",".join(["300.000", "left", *(str(float(i)) for i in range(20))])
    file.write_text(f"header\n{row}\n\x00\x00\x00\n600.0,left\n")

    found = last_track_row(file)
    assert found is not None
    assert (found[0], found[1].ravel().tolist()) == (300.0, [float(i) for i in range(20)])


# Background pictures


def test_matrices_are_made_anew_when_the_folder_changes_and_kept_for_the_next_start(box: Box) -> None:
    assert box.background.finder is not None
    assert (box.background.pictures, box.background.from_cache) == (3, False)
    assert not box.background.refresh()

    (box.run.background / "both-1.jpg").write_bytes(jpeg(empty()))
    assert box.background.refresh()
    assert box.background.pictures == 4

    box.start()
    assert box.background.from_cache
    assert box.answer(box.frame(1, GOOD)).outcome == "ok"


def test_a_kept_file_of_other_pictures_or_damaged_is_not_used(box: Box) -> None:
    (box.run.background / "left-1.jpg").write_bytes(jpeg(with_stem(3.0, 12.0)))
    box.start()
    assert not box.background.from_cache

    (box.state / "setup.npz").write_bytes(b"x")
    box.start()
    assert not box.background.from_cache
    assert box.core.why_not == ""


def test_a_bad_background_picture_is_named(box: Box) -> None:
    (box.run.background / "left-1.jpg").write_bytes(GOOD[:1000])
    box.look()

    stem = box.answer(box.frame(1, GOOD))

    assert stem.outcome == "no_stem"
    assert "left-1.jpg: JPEG is cut short" in stem.reason
