"""The comparison and its page: every quantity of the paper is there, with numbers that can be worked out."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import paper_fakes
import pytest
from html_reader import Reader

from flora_lab.paper import tables
from flora_lab.paper.page import NUMBERS_FILE, PICTURES, REPORT_FILE, page, write_report
from flora_lab.paper.published import PUBLISHED
from flora_lab.paper.results import Results
from flora_lab.paper.rows import Cell, Row, Values, rows

SCRIPT = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return paper_fakes.results(tmp_path_factory.mktemp("paper"), own_split=SCRIPT)


@pytest.fixture(scope="module")
def compared(results: Results) -> list[Row]:
    return rows(results)


@pytest.fixture(scope="module")
def folder(results: Results, compared: list[Row], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report")
    write_report(path, results, compared, tables.as_json(results, compared))
    return path


def cell(compared: list[Row], key: str) -> Cell:
    (found,) = [row.ours for row in compared if row.published.key == key]
    return found


def test_keys_of_the_papers_quantities_are_unique_and_none_is_left_out(compared: list[Row]) -> None:
    keys = [one.key for one in PUBLISHED]

    assert len(set(keys)) == len(keys)
    assert [row.published.key for row in compared] == keys


def test_a_quantity_without_an_equivalent_says_why(compared: list[Row]) -> None:
    silent = [
        row.published.key
        for row in compared
        if row.ours.by_paper is None and row.ours.by_own is None and not row.ours.note
    ]

    assert silent == []


@pytest.mark.parametrize(
    ("key", "by_paper", "by_own"),
    [
        ("growth_cm_per_day", (7.2,), (7.2,)),
        ("hours_to_stop", (64.0,), (64.0,)),
        ("open_loop_runs", (2.0,), (2.0,)),
        ("closed_loop_runs", (1.0,), (1.0,)),
        ("switching_h", (6.0,), (6.0,)),
        ("interval_min", (5.0,), (5.0,)),
        ("translations", (64.0,), None),
        ("vectors", (paper_fakes.VECTORS,), None),
        ("split_percent", (70.0, 20.0, 10.0), None),
        ("loss_train", (5e-4,), None),
        ("learning_rate", (0.001,), (0.008,)),
        ("epochs", (29.0,), (44.0,)),
        ("left_obstacles_cm", (-8.24, -5.57, -2.90, 2.43), (-8.24, -5.57, -2.90, 2.43)),
        ("evolution_runs", (6.0,), (6.0,)),
        ("reality_plants", (2.0,), (1.0,)),
        ("reality_fitness", (92.4, 80.0), (92.4,)),
        ("right_light_h", (37.0, 37.0), (0.0,)),
        ("left_light_h", (35.0, 35.0), (72.0,)),
    ],
)
def test_numbers_are_those_that_can_be_worked_out(
    compared: list[Row], key: str, by_paper: Values, by_own: Values | None
) -> None:
    found = cell(compared, key)

    assert found.by_paper == pytest.approx(by_paper)
    assert found.by_own == (None if by_own is None else pytest.approx(by_own))


def test_fitness_is_that_of_the_best_run(results: Results, compared: list[Row]) -> None:
    best = max(run.best_fitness for run in results.evolutions["own", "left"].info.run)

    assert cell(compared, "left_fitness").by_own == pytest.approx((100.0 * best,))


def test_the_page_shows_every_quantity_every_picture_and_stands_alone(folder: Path) -> None:
    text = (folder / REPORT_FILE).read_text()
    read = Reader(text)

    for one in PUBLISHED:
        assert one.what in read.text
        assert tables.published_text(one) in read.text
    strips = 3
    assert sum(tag == "img" for tag, _ in read.tags) == len(list((folder / PICTURES).iterdir())) + strips
    for tag, attributes in read.tags:
        for name in ("src", "href", "srcset", "data", "action"):
            assert (attributes.get(name) or "data:image/").startswith("data:image/"), tag
    assert "http" not in read.text
    assert "url(" not in text


def test_what_files_say_is_text_and_nothing_else(folder: Path) -> None:
    read = Reader((folder / REPORT_FILE).read_text())

    assert SCRIPT in read.text
    assert "script" not in {tag for tag, _ in read.tags}


def test_pictures_are_files_too_and_show_something(folder: Path) -> None:
    names = {path.name for path in (folder / PICTURES).iterdir()}

    assert {"boxes-left-paper.png", "functional-boxes-middle-own.png", "stems-left.png", "steering.png"} <= names
    for name in names:
        assert np.ptp(cv2.imread(str(folder / PICTURES / name))) > 100


def test_numbers_for_scripts_have_a_row_for_each_quantity(folder: Path) -> None:
    numbers = json.loads((folder / NUMBERS_FILE).read_text())

    assert [row["key"] for row in numbers["rows"]] == [one.key for one in PUBLISHED]
    by_key = {row["key"]: row for row in numbers["rows"]}
    assert by_key["reality_fitness"]["paper"] == pytest.approx([92.4, 92.0, 87.7])
    assert by_key["to_middle_h"]["own_recipe"] == [None]
    assert by_key["pot_l"]["paper_recipe"] is None
    assert numbers["dataset"]["jumps"] == {"stems": 4300, "vectors": paper_fakes.VECTORS}


def test_the_table_of_a_terminal_has_a_line_for_each_quantity(compared: list[Row]) -> None:
    text = tables.text(compared)

    assert "92.4, 92.0, 87.7 %" in text
    assert "about 3 cm/day" in text
    for row in compared:
        assert row.published.what.split()[0] in text


def test_the_same_results_give_the_same_page(results: Results, compared: list[Row]) -> None:
    assert page(results, compared, []) == page(results, compared, [])
