"""All pictures of an evolution, drawn once for the page and for the folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from flora_common import files
from flora_common.controller_file import LoadedController, load_controller
from flora_common.errors import BadInput
from flora_lab.evolve.evolution_folder import Evolution
from flora_lab.evolve_report.film import episodes_film
from flora_lab.evolve_report.fitness_figures import fitness_boxes, functional_boxes, scenario_curves
from flora_lab.evolve_report.network_figure import network_figure
from flora_lab.evolve_report.paper_results import BEST_PERCENT
from flora_lab.evolve_report.population_figure import population_figure
from flora_lab.evolve_report.stems_figure import stems_figure, task_figure

FILM_FILE: Final = "episodes.gif"


@dataclass(frozen=True, slots=True)
class Pictures:
    """PNG bytes but for the film, which is a GIF.

    Attributes:
        task: what is asked.
        boxes, functional, scenarios: fitness over generations: box plots, functional box plot, each scenario.
        population: species and size over generations.
        stems: the best controller's episodes.
        network: of the best controller.
        film: its episodes.
    """

    task: bytes
    boxes: bytes
    functional: bytes
    scenarios: bytes
    population: bytes
    stems: bytes
    network: bytes
    film: bytes


def draw(evolution: Evolution) -> Pictures:
    """Draw them all.

    Raises:
        BadInput: the best controller's file is damaged, or is another than the one that was evolved.
    """
    best, history, task = _best(evolution), evolution.history, evolution.task
    return Pictures(
        task=task_figure(task),
        boxes=fitness_boxes(history, task, BEST_PERCENT.get(task.name)),
        functional=functional_boxes(history),
        scenarios=scenario_curves(history, task),
        population=population_figure(history),
        stems=stems_figure(evolution),
        network=network_figure(best),
        film=episodes_film(evolution.episodes, task),
    )


def _best(evolution: Evolution) -> LoadedController:
    loaded, run = load_controller(evolution.best), evolution.info.run[evolution.info.best_run - 1]
    if loaded.sha256 != run.sha256:
        raise BadInput(f"{evolution.best}: is not the controller of run {run.number}; its SHA-256 is another one")
    return loaded


def write_pictures(pictures: Pictures, folder: Path) -> None:
    """Write a file for each into a folder, each whole or not at all.

    Raises:
        DiskFull: no room.
    """
    named = {
        "task.png": pictures.task,
        "fitness-boxes.png": pictures.boxes,
        "fitness-functional-boxes.png": pictures.functional,
        "fitness-scenarios.png": pictures.scenarios,
        "population.png": pictures.population,
        "stems.png": pictures.stems,
        "network.png": pictures.network,
        FILM_FILE: pictures.film,
    }
    for name, data in named.items():
        files.write_bytes(folder / name, data)
