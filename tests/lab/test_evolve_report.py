"""The page about an evolution: it stands alone, tells all that there is, and believes no name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from evolution_fakes import Fake, read_fake, renamed, write_fake
from html_reader import Reader
from msgspec import structs

from flora_common.errors import BadInput
from flora_lab.evolve.evolution_folder import BEST_FILE, PICTURES, REPORT_FILE, read_evolution
from flora_lab.evolve.task import LEFT, MIDDLE
from flora_lab.evolve_report.page import page, write_report
from flora_lab.evolve_report.pictures import FILM_FILE, Pictures, draw, write_pictures

BLANK = Pictures(*[b"\x89PNG"] * 8)
BAD_NAMES = ("<script>alert(1)</script>", '"><img src=x onerror=y>', "$\\frac{1}$ & <b>", "_豆 &lt;")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with its report, whose names are as bad as names can be."""
    task = renamed(LEFT, "<i>task</i>", BAD_NAMES)
    fake = Fake(task=task, runs=6, generations=20, simulator="<a href=x>s</a>")
    path = write_fake(tmp_path_factory.mktemp("evolution") / "e", fake)
    write_report(path)
    return path


def test_the_folder_gets_a_page_and_pictures(folder: Path) -> None:
    assert read_evolution(folder).info.runs == 6
    names = sorted(file.name for file in (folder / PICTURES).iterdir())
    assert FILM_FILE in names
    for name in names:
        if name.endswith(".png"):
            assert np.ptp(cv2.imread(str(folder / PICTURES / name))) > 100
    read = Reader((folder / REPORT_FILE).read_text())
    assert sum(tag == "img" for tag, _ in read.tags) == len(names)


def test_the_page_stands_alone(folder: Path) -> None:
    text = (folder / REPORT_FILE).read_text()

    read = Reader(text)

    for tag, attributes in read.tags:
        for name in ("src", "href", "srcset", "data", "action"):
            assert (attributes.get(name) or "data:image/").startswith("data:image/"), tag
    assert "http" not in read.text
    assert "`generation`" not in read.text
    assert "url(" not in text
    assert "@import" not in text


def test_names_are_text_and_nothing_else(folder: Path) -> None:
    read = Reader((folder / REPORT_FILE).read_text())

    assert {tag for tag, _ in read.tags} <= {
        *("html", "head", "meta", "title", "style", "body", "h1", "h2", "p", "div", "b", "span"),
        *("figure", "img", "figcaption", "table", "tr", "th", "td"),
    }
    for name in (*BAD_NAMES, "<i>task</i>", "<a href=x>s</a>"):
        assert name in read.text
    assert not any(attribute.startswith("on") for _, attributes in read.tags for attribute in attributes)


def test_the_same_evolution_gives_the_same_pictures(folder: Path, tmp_path: Path) -> None:
    write_pictures(draw(read_evolution(folder)), tmp_path)

    for file in (folder / PICTURES).iterdir():
        assert (tmp_path / file.name).read_bytes() == file.read_bytes(), file.name


def test_every_scenario_run_and_file_is_told(tmp_path: Path) -> None:
    evolution = read_fake(tmp_path / "e", Fake(runs=20, generations=8))

    read = Reader(page(evolution, BLANK))

    for run in evolution.info.run:
        for told in (run.controller, run.sha256, f"{100 * run.best_fitness:.1f} %", str(run.seed)):
            assert told in read.cells
    for scenario in evolution.task.scenarios:
        assert any(cell.startswith(scenario.name) for cell in read.cells)
    assert "third (impossible)" in read.cells
    assert {"a" * 64, "b" * 64} <= set(read.cells)
    assert "20.2 s (84 %)" in read.cells


def test_runs_are_told_the_best_first(tmp_path: Path) -> None:
    evolution = read_fake(tmp_path / "e", Fake(runs=12, generations=8))

    files = [cell for cell in Reader(page(evolution, BLANK)).cells if cell.endswith(".controller.json")]

    by_fitness = sorted(evolution.info.run, key=lambda run: -run.best_fitness)
    assert files == [BEST_FILE, *(run.controller for run in by_fitness)]


def test_runs_on_drawn_plants_are_ranked_by_other_plants(tmp_path: Path) -> None:
    evolution = read_fake(tmp_path / "e", Fake(runs=6, generations=8))
    assert "nothing was evolved on" not in Reader(page(evolution, BLANK)).text
    others = [0.3, 0.6, 0.2, 0.5, 0.4, 0.1]
    runs = [structs.replace(run, held_out_fitness=x) for run, x in zip(evolution.info.run, others, strict=True)]
    drawn = structs.replace(evolution.info.individuals, count=8, held_out=24)
    evolution = replace(evolution, info=structs.replace(evolution.info, run=runs, individuals=drawn))

    reader = Reader(page(evolution, BLANK))

    assert "the best run first on 24 other plants, which nothing was evolved on" in reader.text
    files = [cell for cell in reader.cells if cell.endswith(".controller.json")]
    assert files[1:] == [runs[number].controller for number in (1, 3, 4, 0, 2, 5)]
    assert {"60.0 %", "10.0 %"} <= set(reader.cells)
    assert "the chosen one, without impossible scenarios" in reader.text
    assert "the best, without" not in reader.text


def test_how_often_populations_began_anew_is_told(tmp_path: Path) -> None:
    evolution = read_fake(tmp_path / "e", Fake(runs=6, generations=50))

    times = int(evolution.history.is_extinct.sum())

    assert times > 0
    assert f"a new population began, {times} times" in Reader(page(evolution, BLANK)).text


@pytest.mark.parametrize(("task", "percent"), [(LEFT, "82.5 %"), (MIDDLE, "97.3 %")])
def test_the_papers_tasks_are_held_against_the_paper(tmp_path: Path, task: object, percent: str) -> None:
    known = LEFT if task is LEFT else MIDDLE
    evolution = read_fake(tmp_path / "a", Fake(task=known, runs=2, generations=3))
    own = renamed(known, "own", [scenario.name for scenario in known.scenarios])
    other = read_fake(tmp_path / "b", Fake(task=own, runs=2, generations=3))

    assert f"Wahby et al. 2018 tell {percent} for one of the best" in Reader(page(evolution, BLANK)).text
    assert "Wahby" not in Reader(page(other, BLANK)).text


def test_drawn_plants_are_told_apart_from_the_typical_one(tmp_path: Path) -> None:
    evolution = read_fake(tmp_path / "e", Fake(runs=1, generations=2, individuals=5))

    assert "fitness above is of 5 drawn from seed 1; the mean over them counts" in Reader(page(evolution, BLANK)).text


def test_another_controller_in_the_place_of_the_best_is_refused(tmp_path: Path) -> None:
    folder = write_fake(tmp_path / "e", Fake(runs=3, generations=2))
    best = read_evolution(folder).info.best_run
    other = folder / f"controllers/run-{best % 3 + 1:02d}.controller.json"
    (folder / BEST_FILE).write_bytes(other.read_bytes())

    with pytest.raises(BadInput, match=rf"{BEST_FILE}: is not the controller of run {best}"):
        write_report(folder)
    assert not (folder / REPORT_FILE).exists()
    assert not (folder / PICTURES).exists()
