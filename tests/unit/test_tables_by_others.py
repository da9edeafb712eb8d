"""Tracks that other programs wrote: what can be understood is, what cannot is told in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flora_common.errors import BadRunFolder
from flora_common.runs import TRACK_HEADER
from flora_common.tracks import read_track

NAMES = TRACK_HEADER.split(",")
ROWS = [
    [str(300 * k), light, *(f"{0.1 * i * (k if i % 2 == 0 else 5.0):.4f}" for i in range(20))]
    for k, light in enumerate(("dark", "left", "right"))
]


def table(rows: list[list[str]], separator: str = ",", names: list[str] = NAMES) -> str:
    return "".join(separator.join(row) + "\n" for row in (names, *rows))


def decimal_commas() -> str:
    return table([[field.replace(".", ",") for field in row] for row in ROWS], ";")


def in_another_order() -> str:
    order = [*range(2, 22), 1, 0]
    return table([[row[i] for i in order] for row in ROWS], names=[NAMES[i] for i in order])


def dated(form: str) -> str:
    return table([[form.format(5 * k), *row[1:]] for k, row in enumerate(ROWS)])


def with_numbers_of_rows() -> str:
    return table([[str(k), *row] for k, row in enumerate(ROWS)], names=["", *NAMES])


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(table(ROWS, ";"), id="semicolons"),
        pytest.param(table(ROWS, "\t"), id="tabs"),
        pytest.param(table(ROWS, ", "), id="spaces"),
        pytest.param(decimal_commas(), id="decimal-commas"),
        pytest.param(in_another_order(), id="order"),
        pytest.param("\ufeff" + table(ROWS).replace("\n", "\r\n"), id="windows"),
        pytest.param(table([[*row, ""] for row in ROWS]), id="separators-behind-rows"),
        pytest.param(table([[*row, "", ""] for row in ROWS], names=[*NAMES, "", ""]), id="columns-without-names"),
        pytest.param(with_numbers_of_rows(), id="numbers-of-rows"),
        pytest.param(table(ROWS) + "," * 21 + "\n\n", id="blank-lines"),
        pytest.param("# Saxa; 18,4 px per cm\n\n" + table(ROWS), id="notes-before"),
        pytest.param(table([[f'"{field}"' for field in row] for row in ROWS]), id="quotes"),
        pytest.param(
            table([[row[0], row[1].upper(), *row[2:]] for row in ROWS], names=TRACK_HEADER.title().split(",")),
            id="case",
        ),
        pytest.param(dated("2026-05-02T08:{:02d}:00"), id="dates"),
        pytest.param(dated("2026-05-02 08:{:02d}:00+02:00"), id="dates-of-a-zone"),
    ],
)
def test_a_track_is_read_however_another_program_writes_it(tmp_path: Path, text: str) -> None:
    plain, other = tmp_path / "plain.csv", tmp_path / "other.csv"
    plain.write_text(table(ROWS))
    other.write_bytes(text.encode())
    expected, track = read_track(plain), read_track(other)
    assert (track.time_s - track.time_s[0]).tolist() == [0.0, 300.0, 600.0]
    assert track.light == expected.light
    assert track.points_cm.tolist() == expected.points_cm.tolist()
    assert track.covariates == {}


@pytest.mark.parametrize("nothing", ["", " ", "NaN", "nan", "NA"])
def test_a_row_without_a_stem_tells_its_lamp_alone(tmp_path: Path, nothing: str) -> None:
    path = tmp_path / "track.csv"
    no_lamp = ["450", nothing, *[nothing] * 20]
    path.write_text(table([ROWS[0], [*ROWS[1][:2], "0", "0", *[nothing] * 18], no_lamp, ROWS[2]]))
    track = read_track(path)
    assert track.time_s.tolist() == [0.0, 600.0]
    assert track.light == ("dark", "right")
    assert track.lamps_alone == ((300.0, "left"),)
    assert track.lamp_course()[0].tolist() == [0.0, 300.0, 600.0]
    assert track.lamp_course()[1] == ("dark", "left", "right")


def in_unit(per_cm: float, mark: str, *, scale: str = "") -> str:
    rows = [[*row[:2], *(f"{per_cm * float(field):.6f}" for field in row[2:])] for row in ROWS]
    names = [*NAMES[:2], *(name + mark for name in NAMES[2:])]
    if scale:
        rows, names = [[*row, scale] for row in rows], [*names, "px_per_cm"]
    return table(rows, names=names)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(in_unit(10.0, "_mm"), id="mm"),
        pytest.param(in_unit(10.0, " (mm)").replace("x1", "X1"), id="mm-in-brackets"),
        pytest.param(in_unit(1.0, "_cm"), id="cm"),
        pytest.param(in_unit(18.4, "_px", scale="18.4"), id="px-with-their-scale"),
    ],
)
def test_stems_in_other_units_become_cm(tmp_path: Path, text: str) -> None:
    plain, other = tmp_path / "plain.csv", tmp_path / "other.csv"
    plain.write_text(table(ROWS))
    other.write_text(text)
    track = read_track(other)
    np.testing.assert_allclose(track.points_cm, read_track(plain).points_cm, rtol=0.0, atol=1e-6)
    assert track.covariates == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (in_unit(18.4, "_px"), "points are in px, of which nobody knows how long they are; add a column `px_per_cm`"),
        (in_unit(18.4, "_px", scale="0"), "line 2: px_per_cm is 0, it must be above 0"),
        (in_unit(10.0, "_mm").replace("5.000000", "9e6", 1), "line 2: y1_mm is 9e+06, beyond 5000; y1_mm is in mm"),
        (in_unit(10.0, "_mm").replace("y3_mm", "y3"), "no column `y3_mm`; did you mean `y"),
    ],
)
def test_stems_whose_unit_cannot_be_taken_are_told_with_what_to_do(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "track.csv"
    path.write_text(text)
    with pytest.raises(BadRunFolder) as caught:
        read_track(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_was_not_measured_besides_the_stem_is_not_known_and_remarks_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    further = (("21.5", ""), ("", "pot moved"), ("NaN", "NaN"))
    rows = [[*row, *more] for row, more in zip(ROWS, further, strict=True)]
    path.write_text(table(rows, names=[*NAMES, "temperature_c", "remark"]))
    covariates = read_track(path).covariates
    assert list(covariates) == ["temperature_c"]
    np.testing.assert_array_equal(covariates["temperature_c"], [21.5, np.nan, np.nan])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.encode("utf-16"), "not UTF-8 text (byte 0), hence not a CSV file; save it as CSV in UTF-8"),
        (
            lambda text: text.split("\n", 1)[1].encode(),
            "line 1: holds numbers where the columns must be named: time_s,",
        ),
        (
            lambda text: text.replace("time_s", "time", 1).encode(),
            "no column `time_s`; did you mean `time`? (seconds, or date and time such as 2026-05-02T08:00:00)",
        ),
        (lambda text: text.replace("light", "lamp_on", 1).encode(), "(the lamp that shone: left, right, dark or both)"),
        (lambda text: text.replace("300,", "2.5.2026 08:05,", 1).encode(), "time_s is `2.5.2026 08:05`, not a number"),
        (lambda text: text.replace("300,", "3_0_0,", 1).encode(), "time_s is `3_0_0`, not a number"),
        (lambda text: text.replace("300,", "٣٠٠,", 1).encode(), "time_s is `٣٠٠`, not a number"),
        (lambda text: text.replace("300,", "0x12c,", 1).encode(), "time_s is `0x12c`, not a number"),
        (lambda text: text.rsplit(",", 1)[0].encode() + b",\n", "line 4: y10 is empty, where a number is needed"),
        (lambda text: (text[:-1] + ",7\n").encode(), "line 4: 23 values under 22 columns"),
    ],
)
def test_what_cannot_be_understood_is_told_with_what_to_do(
    tmp_path: Path, change: Callable[[str], bytes], said: str
) -> None:
    path = tmp_path / "track.csv"
    path.write_bytes(change(table(ROWS)))
    with pytest.raises(BadRunFolder) as caught:
        read_track(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_line_after_notes_is_told_by_its_number_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_text("# one\n# two\n" + table(ROWS).replace("left", "lift"))
    with pytest.raises(BadRunFolder, match=r"line 5: light is `lift`; did you mean `left`\?"):
        read_track(path)
