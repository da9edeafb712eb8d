"""The page of an evaluation: tables, photographs and tracks in one HTML file that needs nothing else."""

from __future__ import annotations

from typing import Final

from flora_lab import html_page
from flora_lab.evaluate import tables
from flora_lab.evaluate.evaluation import Evaluation
from flora_lab.evaluate.figures import tracks_figure
from flora_lab.evaluate.gap import REAL_PLANTS, gaps
from flora_lab.evaluate.on_twin import STRIP_FILE
from flora_lab.evaluate.trial import TWIN, Trial

MOST_STRIPS: Final = 12


def page(one: Evaluation) -> str:
    """The whole page as HTML text."""
    names = ", ".join(controller.name for controller in one.plan.controllers)
    title = f"Controllers in task {one.plan.task.name}"
    body = [html_page.heading(title, f"{names}; {tables.places_text(one)}."), html_page.tiles(_tiles(one))]
    for place in one.places:
        body += [html_page.section(_capital(tables.place_words(one, place)))]
        body += [html_page.table(*tables.summary_table(one, place))]
    if gaps(one.rows):
        body += [html_page.section("The reality gap"), html_page.paragraph(tables.GAP_WORDS.capitalize() + ".")]
        body += [html_page.table(*tables.gap_table(one))]
    if one.on_twin:
        body += [html_page.section("Each virtual plant"), html_page.table(*tables.trials_table(one)), *_strips(one)]
    if one.trials:
        caption = "Thick: the stem at the end (of simulators the typical plant's); thin lines lead to the tips."
        body += [html_page.section("Tracks")]
        body += [html_page.picture(tracks_figure(one), "png", alt="Stems at the end and ways of tips", caption=caption)]
    body += [html_page.section("How to read this"), *(html_page.paragraph(note) for note in tables.notes(one))]
    body += [html_page.section("What was asked"), html_page.pairs(_asked(one))]
    return html_page.document(title, body)


def _tiles(one: Evaluation) -> list[tuple[str, str]]:
    """The largest figures: of an evaluation of a few rows, all of them."""
    found = []
    for row in one.rows[:4]:
        value = row.mean("fitness") if row.typical is None else row.of_typical("fitness")
        where = "virtual plants, mean" if row.place == TWIN else f"{row.place}, typical plant"
        found.append((f"{tables.percent(value)} %", f"{row.controller} in {row.scenario.name}: {where}"))
    if one.has_real_plants:
        mean = sum(REAL_PLANTS) / len(REAL_PLANTS)
        found.append((f"{tables.percent(mean)} %", "the paper's three real plants, mean"))
    return found


def _strips(one: Evaluation) -> list[str]:
    runs = [trial for trial in one.trials if trial.folder is not None]
    shown = [_strip(trial) for trial in runs[:MOST_STRIPS]]
    if len(shown) < len(runs):
        shown.append(html_page.paragraph(f"The first {len(shown)} of {len(runs)}; the others are in their folders."))
    return shown


def _strip(trial: Trial) -> str:
    assert trial.folder is not None
    words = f"{trial.controller} in {trial.scenario.name}, plant {trial.seed}"
    reached = "target not reached" if trial.reached_h is None else f"target reached at {trial.reached_h:.1f} h"
    caption = f"{words}: fitness {tables.percent(trial.fitness)} %, {reached}"
    return html_page.picture((trial.folder / STRIP_FILE).read_bytes(), "jpeg", alt=words, caption=caption)


def _asked(one: Evaluation) -> list[tuple[str, str]]:
    plan = one.plan
    found = [
        (f"controller {c.name}", f"{c.path.name}, sha256 {c.sha256}, evolved for {c.loaded.file.task.name}")
        for c in plan.controllers
    ]
    for scenario in plan.task.scenarios:
        target, obstacle = scenario.target, scenario.obstacle
        words = f"target ({target.x_cm:g}, {target.y_cm:g}) cm, radius {target.radius_cm:g} cm; obstacle "
        words += f"{obstacle.width_cm:g} x {obstacle.height_cm:g} cm, centre ({obstacle.x_cm:g}, {obstacle.y_cm:g}) cm"
        found.append((f"scenario {scenario.name}", words))
    for name, info in one.simulators.items():
        found.append((f"simulator {name}", f"kind {info.kind}, weights {info.weights_sha256}"))
    return [*found, ("plants", f"{plan.repeat} from seed {plan.seed}")]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
