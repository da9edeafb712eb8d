"""Figures of an evolution: they can be drawn of any that there is, and show what they are given."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from evolution_fakes import FAST, Fake, history, layered, read_fake, renamed
from evolve_reference import controller_of
from PIL import Image

from flora_common.arrays import FloatArray
from flora_common.controller_file import LoadedController, load_controller
from flora_lab.evolve.episode import run_episode
from flora_lab.evolve.evolution_folder import EpisodeTrack
from flora_lab.evolve.task import LEFT, MIDDLE, Scenario, Task
from flora_lab.evolve_report.film import FRAMES, episodes_film
from flora_lab.evolve_report.fitness_figures import (
    BOXES,
    box_generations,
    fitness_boxes,
    functional_boxes,
    scenario_curves,
)
from flora_lab.evolve_report.network_figure import network_figure
from flora_lab.evolve_report.network_layout import MOST_HIDDEN, depths, layout_of
from flora_lab.evolve_report.population_figure import population_figure
from flora_lab.evolve_report.scene import LAMP_PLACES, window_of
from flora_lab.evolve_report.stems_figure import lamp_spans, stems_figure, task_figure
from flora_lab.figure_style import LAMP_COLOURS, drawable
from flora_lab.simulator.measured import STEP_S

GOOD = Path(__file__).parents[1] / "golden/controllers/good"
MANY = Task("many", tuple(replace(LEFT.scenarios[k % 4], name=f"{k}") for k in range(14)))


class Rule:
    """A controller that says the same whatever it sees."""

    def __init__(self, answer: float) -> None:
        self.answer = answer

    def output(self, points_cm: FloatArray, target: object, obstacle: object) -> float:
        return self.answer


def seen(png: bytes) -> FloatArray:
    """The picture of a PNG file; it shows something."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert np.ptp(picture) > 100
    return np.asarray(picture, dtype=np.float64)


def episode(answer: float = 1.0, scenario: Scenario = LEFT.scenarios[0]) -> EpisodeTrack:
    """What happens to a plant under one lamp."""
    course = run_episode(Rule(answer), FAST, LEFT, scenario)
    time_s = STEP_S * np.arange(len(course.stems_cm))
    return EpisodeTrack(
        scenario, course.reason, course.fitness, course.clearance_cm, time_s, course.is_right, course.stems_cm
    )


@pytest.mark.parametrize(
    "fake",
    [
        Fake(runs=1, generations=1),
        Fake(runs=1, generations=40),
        Fake(runs=2, generations=2),
        Fake(runs=20, generations=40),
        Fake(runs=20, generations=40, alike=True),
        Fake(runs=7, generations=30, task=MIDDLE),
        Fake(runs=5, generations=3, task=MANY),
    ],
    ids=lambda fake: f"{fake.runs} runs, {fake.generations} generations, {fake.task.name}, {fake.alike}",
)
def test_fitness_and_populations_of_any_evolution_are_drawn(fake: Fake) -> None:
    told = history(fake)

    for drawn in (
        fitness_boxes(told, fake.task, 82.5),
        functional_boxes(told),
        scenario_curves(told, fake.task),
        population_figure(told),
    ):
        seen(drawn)


def test_a_task_with_impossible_scenarios_has_a_second_panel() -> None:
    wide = [seen(fitness_boxes(history(Fake(task=task)), task)).shape[1] for task in (LEFT, MIDDLE)]

    assert wide[0] > wide[1]


def test_the_papers_value_is_drawn_where_there_is_one() -> None:
    told = history(Fake())

    assert fitness_boxes(told, LEFT, 82.5) != fitness_boxes(told, LEFT)


def test_what_runs_have_kept_is_drawn_where_populations_were_left() -> None:
    told = history(Fake())
    stayed = replace(told, is_extinct=np.zeros_like(told.is_extinct))

    assert told.is_extinct.any()
    assert fitness_boxes(told, LEFT) != fitness_boxes(stayed, LEFT)


@pytest.mark.parametrize("count", [1, 2, 3, 21, 22, 23, 40, 400, 1000, 1001])
def test_boxes_stand_at_even_distances_from_the_first_generation_to_the_last(count: int) -> None:
    places = box_generations(count)

    steps = np.diff(places)
    assert (places[0], places[-1]) == (0, count - 1)
    assert len(places) <= BOXES
    assert len(places) >= min(count, BOXES // 2)
    assert (steps > 0).all()
    assert (steps[:-1] == steps[:1]).all()
    if count == 1000:
        assert places == [*range(0, 951, 50), 999]


def test_a_lamp_shines_from_when_to_when() -> None:
    is_right = np.array([True, True, False, True])

    spans = lamp_spans(is_right, 600.0 + 1800.0 * np.arange(5.0))

    assert spans == [(True, 0.0, 1.0), (False, 1.0, 0.5), (True, 1.5, 0.5)]
    assert lamp_spans(is_right[:0], np.zeros(1)) == []


def test_all_obstacles_targets_and_stems_are_in_the_window() -> None:
    stem = np.array([[[0.0, 0.0], [17.0, 24.0]]])

    window = window_of(LEFT, [stem])

    assert window.left_cm < min(s.obstacle.left_cm for s in LEFT.scenarios)
    assert window.right_cm > 17.0
    assert window.bottom_cm < 0.0
    assert window.top_cm > 24.0
    astray = window_of(LEFT, [1e6 * stem])
    assert astray.right_cm < 50.0


def test_stems_of_more_scenarios_than_there_is_room_for_are_drawn(tmp_path: Path) -> None:
    few, many = read_fake(tmp_path / "a", Fake(runs=1)), read_fake(tmp_path / "b", Fake(runs=1, task=MANY))

    assert seen(stems_figure(many)).shape[0] > 2 * seen(stems_figure(few)).shape[0]
    seen(task_figure(MANY))


def test_names_that_look_like_formulas_or_lack_a_letter_are_drawn(tmp_path: Path) -> None:
    task = renamed(LEFT, "own", ["$\\frac", "a$b$c", "_hidden", "豆 \N{SEEDLING}" + "x" * 90])
    evolution = read_fake(tmp_path / "e", Fake(runs=1, generations=2, task=task))

    for drawn in (stems_figure(evolution), task_figure(task), scenario_curves(evolution.history, task)):
        seen(drawn)
    assert episodes_film(evolution.episodes, task)[:4] == b"GIF8"
    assert drawable("豆a", 10) == "\N{WHITE SQUARE}a"
    assert len(drawable("x" * 90, 34)) == 34


def test_an_episode_that_never_began_is_drawn(tmp_path: Path) -> None:
    whole = episode()
    none = replace(
        whole, reason="no answer", time_s=whole.time_s[:1], is_right=whole.is_right[:0], stems_cm=whole.stems_cm[:1]
    )
    evolution = replace(read_fake(tmp_path / "e", Fake(runs=1, generations=1)), episodes=(none,))

    seen(stems_figure(evolution))
    with Image.open(io.BytesIO(episodes_film([none], LEFT))) as film:
        assert getattr(film, "n_frames", 1) == 1


def test_a_film_is_small_and_of_few_frames() -> None:
    data = episodes_film([episode(scenario=scenario) for scenario in MANY.scenarios], MANY)

    with Image.open(io.BytesIO(data)) as film:
        assert film.n_frames <= FRAMES
        assert film.info["loop"] == 0
    assert len(data) < 1_500_000


@pytest.mark.parametrize(("answer", "lit", "dark"), [(1.0, "right", "left"), (0.0, "left", "right")])
def test_the_film_shows_which_lamp_shines_until_the_end(answer: float, lit: str, dark: str) -> None:
    with Image.open(io.BytesIO(episodes_film([episode(answer)], LEFT))) as film:
        film.seek(1)
        during = np.asarray(film.convert("RGB"), dtype=np.float64)
        film.seek(film.n_frames - 1)
        end = np.asarray(film.convert("RGB"), dtype=np.float64)

    assert (during[0, 0] == 255.0).all()
    assert _signs_of(during, lit) > 2 * _signs_of(during, dark)
    assert _signs_of(end, lit) < _signs_of(during, lit)
    assert set(LAMP_PLACES) == {"left", "right"}


def _signs_of(picture: FloatArray, light: str) -> int:
    """Pixels of a lamp's colour."""
    colour = np.array([int(LAMP_COLOURS[light][k : k + 2], 16) for k in (1, 3, 5)])  # type: ignore[index]
    return int((np.abs(picture - colour).max(axis=2) < 12.0).sum())


def loaded(hidden: int, columns: int = 3) -> LoadedController:
    return controller_of(layered(hidden, 1, columns=columns), LEFT)


@pytest.mark.parametrize("hidden", [0, 1, 5, 40, 60])
def test_a_network_has_a_place_for_each_node(hidden: int) -> None:
    controller = loaded(hidden)

    layout = layout_of(controller)

    assert len(layout.hidden) == min(hidden, MOST_HIDDEN)
    assert layout.left_out == hidden - len(layout.hidden)
    places = list(layout.at.values())
    assert len(set(places)) == len(places) == 26 + len(layout.hidden) + 1
    assert all(0.0 <= x <= 1.0 and 0.0 <= y <= 1.0 for x, y in places)
    assert [name for group in layout.groups for name, _ in group.inputs][:2] == ["x1", "x2"]
    for source, to, _ in layout.links:
        assert layout.at[source][0] < layout.at[to][0]
    if hidden <= MOST_HIDDEN:
        assert len(layout.links) == sum(len(node.links) for node in controller.network.nodes)
    seen(network_figure(controller))


def test_hidden_nodes_with_the_greatest_weights_are_kept() -> None:
    controller = loaded(60)
    size = dict.fromkeys((node.key for node in controller.network.nodes), 0.0)
    for node in controller.network.nodes:
        for source, weight in node.links:
            for key in {source, node.key} & size.keys():
                size[key] += abs(weight)

    kept = set(layout_of(controller).hidden)

    assert min(size[key] for key in kept) >= max(size[key] for key in size.keys() - kept - {0})


def test_depth_is_the_longest_way_from_the_inputs() -> None:
    controller = loaded(9)

    depth = depths(controller.network.nodes, controller.network.inputs)

    for node in controller.network.nodes:
        assert depth[node.key] == 1 + max(depth[source] for source, _ in node.links)


@pytest.mark.parametrize("path", sorted(GOOD.glob("*.controller.json")), ids=lambda path: path.name)
def test_every_controller_that_the_rig_takes_is_drawn(path: Path) -> None:
    seen(network_figure(load_controller(path)))
