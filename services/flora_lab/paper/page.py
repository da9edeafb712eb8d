"""The report: one page that needs nothing else, all numbers for scripts, and the pictures as files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from flora_common import files
from flora_lab import html_page
from flora_lab.evolve.task import LEFT, MIDDLE
from flora_lab.judging import percent
from flora_lab.paper import tables
from flora_lab.paper.figures import Picture, draw_all
from flora_lab.paper.pipeline import SIDE_WORDS, SIDES, TASKS, steps_of
from flora_lab.paper.published import PUBLISHED, REALITY_PICTURES_H
from flora_lab.paper.results import Results
from flora_lab.paper.rows import Row
from flora_lab.paper.screen import duration

REPORT_FILE: Final = "report.html"
NUMBERS_FILE: Final = "numbers.json"
PICTURES: Final = "pictures"


def write_report(folder: Path, results: Results, compared: Sequence[Row], numbers: Mapping[str, Any]) -> Path:
    """Write page, numbers and pictures, each whole; returns where the page is.

    Raises:
        DiskFull: no room.
    """
    pictures = draw_all(results)
    with files.whole_folder(folder / PICTURES, replace=True) as inner:
        for picture in pictures:
            (inner / f"{picture.name}.png").write_bytes(picture.data)
    files.write_text(folder / NUMBERS_FILE, json.dumps(numbers, indent=1) + "\n")
    files.write_text(folder / REPORT_FILE, page(results, compared, pictures))
    return folder / REPORT_FILE


def page(results: Results, compared: Sequence[Row], pictures: Sequence[Picture]) -> str:
    """The whole page as HTML text."""
    scale = results.asked.scale
    asked = f"Scale {scale.name}, seed {results.asked.seed}."
    lead = f"Wahby et al. 2018, and what this project comes to. {asked} {scale.lead}"
    body = [
        html_page.heading("A robot to shape your natural plant: the paper's figures and numbers beside ours", lead),
        html_page.tiles(_tiles(results), threes=True),
        html_page.paragraph(
            "All plants here are virtual. The third column is the paper's recipe: its training set, its LSTM, its "
            "evolution. The fourth is ours: a simulator that learns the law of a growing stem from the same plants, "
            "and evolution in it. Where there is no equivalent there is a dash, and the reason."
        ),
        *_numbers(compared),
        html_page.section("The training set, step by step"),
        html_page.paragraph("The paper tells the last count only."),
        _counts(results),
        html_page.section("Evolved controllers"),
        html_page.paragraph(
            "The best of each evolution with its simulator's typical plant. A scenario in brackets is one that no "
            "plant can do; the paper's averages count it."
        ),
        _evolved(results),
        html_page.section("The experiment with real plants"),
        html_page.paragraph(
            "The best controllers for the left target, where each simulator foretells, and where it was."
        ),
        _tried(results),
        *_figures(results, pictures),
        html_page.section("Time"),
        html_page.pairs(_times(results)),
    ]
    return html_page.document("Wahby et al. 2018 beside flora", body)


def _tiles(results: Results) -> list[tuple[str, str]]:
    """The figures that are looked for first."""
    found = []
    for of in SIDES:
        for task in TASKS:
            info = results.evolutions[of, task.name].info
            best = percent(info.run[info.best_run - 1].best_fitness)
            found.append((best, f"{task.name} target, best in the simulator of {SIDE_WORDS[of]}"))
        plants = results.reality[of].plants
        mean = sum(plant.fitness for plant in plants) / len(plants)
        found.append((percent(mean), f"virtual plants, controller of {SIDE_WORDS[of]}, mean"))
    return [*_paper_tiles(), *found]


def _paper_tiles() -> list[tuple[str, str]]:
    by_key = {one.key: one for one in PUBLISHED}
    real = by_key["reality_fitness"]
    return [
        *(
            (tables.published_text(by_key[f"{task.name}_fitness"]), f"paper: {task.name} target")
            for task in (LEFT, MIDDLE)
        ),
        (f"{sum(real.values) / len(real.values):.1f} %", "paper: three real plants, mean"),
    ]


def _numbers(compared: Sequence[Row]) -> list[str]:
    """A table for each section of the paper."""
    body = []
    for section, own in groupby(compared, key=lambda row: row.published.section):
        body.append(html_page.section(section))
        lines = [[*tables.cells(row), row.ours.note] for row in own]
        body.append(html_page.table([*tables.HEAD, "remark"], lines))
    return body


def _counts(results: Results) -> str:
    lines = [[count.step, f"{count.stems:,}", f"{count.vectors:,}"] for count in results.data.count]
    return html_page.table(["after", "stems", "vectors"], lines)


def _evolved(results: Results) -> str:
    """The best controllers in each scenario."""
    head = ["simulator of", "target", "scenario", "fitness", "ended by", "after", "least distance"]
    lines = []
    for (of, task), evolution in results.evolutions.items():
        for scenario, entry in zip(evolution.task.scenarios, evolution.info.episode, strict=True):
            name = scenario.name if scenario.is_possible else f"({scenario.name})"
            clearance = f"{entry.clearance_cm:.1f} cm"
            lines.append([SIDE_WORDS[of], task, name, *_course(entry.fitness, entry.reason, entry.hours), clearance])
    return html_page.table(head, lines)


def _tried(results: Results) -> str:
    """The best left controllers in the experiment with real plants, simulated and on virtual plants."""
    head = ["controller of", "plant", "fitness", "ended by", "after", "best on the way"]
    lines = []
    for of in SIDES:
        one = results.reality[of]
        for place, trial in one.simulated.items():
            best = percent(trial.best_fitness)
            plant = f"typical one of {SIDE_WORDS[place]}"
            lines.append([SIDE_WORDS[of], plant, *_course(trial.fitness, trial.ended, trial.hours), best])
        for virtual in one.plants:
            said = virtual.outcome.measured
            best = percent(said.best_fitness)
            plant = f"virtual plant {virtual.outcome.seed}"
            lines.append([SIDE_WORDS[of], plant, *_course(virtual.fitness, said.ended, said.ended_h), best])
    return html_page.table(head, lines)


def _course(fitness: float, ended: str, hours: float) -> list[str]:
    return [percent(fitness), ended, f"{hours:.1f} h"]


def _figures(results: Results, pictures: Sequence[Picture]) -> list[str]:
    """The paper's figures, under the words that tell which."""
    body = [html_page.section("The paper's figures")]
    for paper, same in groupby(pictures, key=lambda picture: picture.paper):
        body.append(html_page.paragraph(f"{paper[:1].upper()}{paper[1:]}:"))
        body += [html_page.picture(one.data, "png", alt=one.alt, caption=one.caption) for one in same]
    hours = ", ".join(f"{hour:g}" for hour in REALITY_PICTURES_H)
    body.append(
        html_page.paragraph(f"Photographs of an experiment; the paper's at {hours} h, these at even times to the end:")
    )
    for of in SIDES:
        for plant in results.reality[of].plants:
            words = f"Controller of {SIDE_WORDS[of]}, virtual plant {plant.outcome.seed}"
            caption = f"{words}: {percent(plant.fitness)}."
            body.append(html_page.picture(plant.strip_jpeg, "jpeg", alt=words, caption=caption))
    return body


def _times(results: Results) -> list[tuple[str, str]]:
    titles = {step.name: step.title for step in steps_of(results.asked, is_silent=True)}
    return [(titles[name], duration(seconds)) for name, seconds in results.took_s.items()]
