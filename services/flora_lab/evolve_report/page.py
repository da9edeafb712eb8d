"""The page about an evolution: what was asked, what came of it, and the best controller at work."""

from __future__ import annotations

from pathlib import Path
from statistics import median

from flora_common import files
from flora_common.counted import counted
from flora_lab import html_page, judging
from flora_lab.evolve import evolution_folder
from flora_lab.evolve.evolution_folder import Evolution
from flora_lab.evolve_report import tables
from flora_lab.evolve_report.fitness_figures import FEWEST_RUNS
from flora_lab.evolve_report.paper_results import BEST_PERCENT
from flora_lab.evolve_report.pictures import Pictures, draw, write_pictures


def write_report(folder: Path) -> None:
    """Draw an evolution, and write its page and pictures into its folder.

    Raises:
        BadInput: see :func:`flora_lab.evolve.evolution_folder.read_evolution`.
        DiskFull: no room.
    """
    evolution = evolution_folder.read_evolution(folder)
    pictures = draw(evolution)
    write_pictures(pictures, folder / evolution_folder.PICTURES)
    files.write_text(folder / evolution_folder.REPORT_FILE, page(evolution, pictures))


def page(evolution: Evolution, pictures: Pictures) -> str:
    """The whole page as HTML text."""
    body = [
        html_page.heading(f"Evolution: task {evolution.task.name}", _lead(evolution)),
        html_page.tiles(_headline(evolution)),
        *_beside_the_paper(evolution),
        *_best_at_work(evolution, pictures),
        *_over_generations(evolution, pictures),
        html_page.section("Runs"),
        html_page.paragraph(
            f"The champion of each run, the best run first{_chosen_by(evolution)}; “generation” is where it came up."
        ),
        tables.runs(evolution),
        html_page.section("What was asked"),
        html_page.picture(
            pictures.task,
            "png",
            alt="Start, obstacle and target of each scenario",
            caption="The stem at the start (black), obstacle (grey), target (red), and the height at which a run ends.",
        ),
        tables.asked(evolution),
        html_page.section("Time"),
        tables.time_taken(evolution),
        html_page.section("Controller files"),
        tables.controller_files(evolution),
    ]
    return html_page.document(f"Evolution: {evolution.task.name}", body)


def _lead(evolution: Evolution) -> str:
    info = evolution.info
    return (
        f"{counted(info.runs, 'run')} of NEAT, {counted(info.generations, 'generation')} of "
        f"{counted(info.population, 'controller')} each, in the simulator {info.simulator.name}."
    )


def _headline(evolution: Evolution) -> list[tuple[str, str]]:
    """The figures that are looked for first."""
    runs = evolution.info.run
    best = runs[evolution.info.best_run - 1]
    middle = median(run.best_fitness for run in runs)
    word = "best" if best.held_out_fitness is None else "chosen"
    figures = [
        (judging.percent(best.best_fitness), f"fitness of the {word} controller, run {best.number}"),
        (judging.percent(middle), f"median over {counted(len(runs), 'run')}"),
    ]
    if best.held_out_fitness is not None:
        others = (
            f"the chosen one's on {counted(evolution.info.individuals.held_out, 'plant')} that nothing was evolved on"
        )
        figures.append((judging.percent(best.held_out_fitness), others))
    if not evolution.task.is_possible.all():
        figures.append((judging.percent(best.best_fitness_possible), f"the {word} one, without impossible scenarios"))
        middle = median(run.best_fitness_possible for run in runs)
        figures.append((judging.percent(middle), "median, without impossible scenarios"))
    return figures


def _beside_the_paper(evolution: Evolution) -> list[str]:
    """How it compares, for the tasks that the paper evolved for."""
    theirs = BEST_PERCENT.get(evolution.task.name)
    if theirs is None:
        return []
    runs = evolution.info.run
    best = judging.percent(max(run.best_fitness for run in runs))
    middle = judging.percent(median(run.best_fitness for run in runs))
    text = (
        f"Wahby et al. 2018 tell {theirs:g} % for one of the best controllers of their 20 runs of 1000 generations in "
        f"this task, with a simulator, a start of the plant and settings of NEAT of their own. Here the best run has "
        f"{best} and the median run {middle}."
    )
    return [html_page.paragraph(text)]


def _best_at_work(evolution: Evolution, pictures: Pictures) -> list[str]:
    plant = "with the simulator's typical plant"
    if evolution.info.individuals.count:
        plant += f", while fitness above is of {tables.plants_text(evolution)}"
    return [
        html_page.section("The best controller at work"),
        html_page.picture(
            pictures.film,
            "gif",
            alt="Film of the stem growing in each scenario",
            caption=f"Its episodes {plant}. Obstacle grey, target red; circles: the left and the right lamp, "
            "filled when lit.",
        ),
        tables.scenarios(evolution),
        html_page.picture(
            pictures.stems,
            "png",
            alt="Stems through time and lamps in each scenario",
            caption="Stems from the start (light) to the end (dark), the path of the tip (red), and under them which "
            "lamp shone; the dots mark when the stems were. Circles at the top: the lamps at the end.",
        ),
        html_page.section("Its network"),
        html_page.picture(
            pictures.network,
            "png",
            alt="Nodes and links of the best controller's network",
            caption="Inputs to the left, hidden nodes by depth, the output C to the right. The thicker a link, the "
            "greater its weight; inputs in grey are not read. Links that are disabled are left out.",
        ),
    ]


def _chosen_by(evolution: Evolution) -> str:
    others = evolution.info.individuals.held_out
    return f" on {counted(others, 'other plant')}, which nothing was evolved on" if others else ""


def _over_runs(runs: int, pictures: Pictures) -> list[str]:
    if runs < FEWEST_RUNS:
        caption = "Best fitness of a generation in each run, and their median."
        return [html_page.picture(pictures.boxes, "png", alt="Best fitness of each generation", caption=caption)]
    return [
        html_page.picture(
            pictures.boxes,
            "png",
            alt="Box plots of the best fitness of each generation",
            caption="Best fitness of a generation over runs: quartiles, whiskers to 1.5 times their "
            "distance, outliers.",
        ),
        html_page.picture(
            pictures.functional,
            "png",
            alt="Functional box plot of the best fitness of each generation",
            caption="The same as a functional box plot (Sun and Genton 2011): runs are ordered as whole curves.",
        ),
    ]


def _over_generations(evolution: Evolution, pictures: Pictures) -> list[str]:
    extinct = int(evolution.history.is_extinct.sum())
    times = "once" if extinct == 1 else f"{extinct} times"
    again = f" No species came further, and a new population began, {times}." if extinct else ""
    return [
        html_page.section("Fitness over generations"),
        *_over_runs(len(evolution.info.run), pictures),
        html_page.picture(
            pictures.scenarios,
            "png",
            alt="Fitness in each scenario over generations",
            caption="Where it comes from: fitness of the generation's best controller in each scenario.",
        ),
        html_page.section("Populations"),
        html_page.picture(
            pictures.population,
            "png",
            alt="Species, hidden nodes and links over generations",
            caption=f"Species, and the size of the generation's best network.{again}",
        ),
    ]
