"""Tasks: the paper's two, own ones as files, and one line for each that no plant can be set."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flora_common.errors import BadInput
from flora_common.geometry import resample_by_height
from flora_common.shapes import Obstacle, Target
from flora_lab.evolve.task import BUILT_IN, LEFT, MIDDLE, Scenario, Task, averages, straight_stem
from flora_lab.evolve.task_file import check_task, read_task, task_named, task_text

SLALOM = """
name = "slalom"
hours = 48.0
stop_height_cm = 19.0
collision_at_most = 0.5

[start]
height_cm = 5.0
tip_x_cm = -0.5

[target]
x_cm = 4.0
y_cm = 16.0
radius_cm = 1.5

[[scenario]]
name = "near"
[scenario.obstacle]
x_cm = 3.0
y_cm = 9.0

[[scenario]]
possible = false
[scenario.target]
x_cm = -4.0
y_cm = 15.0
[scenario.obstacle]
x_cm = -3.0
y_cm = 8.0
width_cm = 2.0
height_cm = 4.0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "task.toml"
    path.write_text(text)
    return path


def test_the_papers_tasks_are_as_it_gives_them() -> None:
    assert [(s.obstacle.x_cm, s.obstacle.y_cm) for s in LEFT.scenarios] == [
        (-8.24, 8.8),
        (-5.57, 8.8),
        (-2.90, 8.8),
        (2.43, 8.8),
    ]
    assert [(s.obstacle.x_cm, s.obstacle.y_cm) for s in MIDDLE.scenarios] == [(3.0, 8.8), (-3.0, 8.8)]
    for task, target in ((LEFT, Target(-5.12, 17.9, 2.0)), (MIDDLE, Target(0.0, 17.9, 2.0))):
        assert {s.target for s in task.scenarios} == {target}
        assert {(s.obstacle.width_cm, s.obstacle.height_cm) for s in task.scenarios} == {(7.0, 3.0)}
        assert (task.stop_height_cm, task.hours, task.most_steps) == (21.0, 72.0, 864)
        check_task(task, task.name)
    assert LEFT.is_possible.tolist() == [True, True, False, True]
    assert MIDDLE.is_possible.all()


def test_the_papers_average_is_told_with_and_without_what_is_impossible() -> None:
    told = averages(LEFT, np.array([[0.9, 0.8, 0.1, 1.0], [0.5, 0.5, 0.9, 0.5]]))

    assert np.abs(told.of_all - [0.7, 0.6]).max() < 1e-12
    assert np.abs(told.of_possible - [0.9, 0.5]).max() < 1e-12


def test_a_straight_stem_is_one_that_a_track_could_hold() -> None:
    stem = np.array(straight_stem(6.5, -2.0))

    assert np.abs(stem - resample_by_height([(0.0, 0.0), (-2.0, 6.5)])).max() < 1e-12
    assert stem[0].tolist() == [0.0, 0.0]


def test_an_own_task_is_read_whole(tmp_path: Path) -> None:
    task = read_task(written(tmp_path, SLALOM))

    assert (task.name, task.hours, task.stop_height_cm, task.most_steps) == ("slalom", 48.0, 19.0, 576)
    assert task.collision_at_most == 0.5
    assert task.start_cm == straight_stem(5.0, -0.5)
    assert task.scenarios == (
        Scenario("near", Target(4.0, 16.0, 1.5), Obstacle(3.0, 9.0)),
        Scenario("2", Target(-4.0, 15.0, 2.0), Obstacle(-3.0, 8.0, 2.0, 4.0), is_possible=False),
    )


@pytest.mark.parametrize("name", ["left", "middle", "reality", "slalom"])
def test_what_is_written_is_read_back(tmp_path: Path, name: str) -> None:
    task = read_task(written(tmp_path, SLALOM)) if name == "slalom" else BUILT_IN[name]

    assert read_task(written(tmp_path, task_text(task))) == task


def test_a_start_may_be_given_point_by_point(tmp_path: Path) -> None:
    bent = [[0.02 * i * i, 0.7 * i] for i in range(10)]

    task = read_task(written(tmp_path, SLALOM.replace("height_cm = 5.0\ntip_x_cm = -0.5", f"points_cm = {bent}")))

    assert task.start_stem_cm.tolist() == bent


def test_a_task_is_named_or_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, SLALOM)
    assert task_named("left") is LEFT
    assert task_named("middle") is MIDDLE
    assert task_named(str(path)).name == "slalom"
    plain = tmp_path / "task"
    plain.write_text(SLALOM)
    assert task_named(str(plain)).name == "slalom"
    for text, said in (
        (
            "lefd",
            "--task lefd: neither a built-in task (left, middle, reality, round) nor a file; did you mean `left`?",
        ),
        ("17", "--task 17: neither a built-in task (left, middle, reality, round) nor a file"),
        ("none.toml", "none.toml: cannot be read (No such file or directory)"),
    ):
        with pytest.raises(BadInput) as told:
            task_named(text)
        assert str(told.value) == said


TARGET = "x_cm = 4.0\ny_cm = 16.0"
NEAR = "x_cm = 3.0\ny_cm = 9.0"
START = "height_cm = 5.0\ntip_x_cm = -0.5"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            TARGET,
            "x_cm = 61.0\ny_cm = 16.0",
            "near: target (61, 16) cm is outside the box, 120 cm wide and 200 cm high",
        ),
        (TARGET, "x_cm = 4.0\ny_cm = -1.0", "near: target (4, -1) cm is outside the box"),
        (TARGET, "x_cm = 4.0\ny_cm = 8.9", "near: target (4, 8.9) cm is inside the obstacle"),
        (TARGET, "x_cm = 0.5\ny_cm = 1.0", "near: the target lies on the anchor"),
        (
            TARGET,
            "x_cm = 4.0\ny_cm = 21.0",
            "near: the target begins 19.5 cm high and runs end at stop_height_cm, 19 cm",
        ),
        (TARGET, "x_cm = nan\ny_cm = 16.0", "`target.x_cm` expected `float` >= -500.0, it is nan"),
        (TARGET, "x_cm = 4.0\ny_cm = inf", "`target.y_cm` expected `float` <= 500.0, it is inf"),
        (TARGET, "x_cm = 4.0", "`target` object missing required field `y_cm`"),
        (TARGET, "x_cm = 4.0\ny_cm = 16.0\nradius = 2.0", "unknown key `radius`; did you mean `radius_cm`?"),
        (NEAR, "x_cm = 58.0\ny_cm = 9.0", "obstacle from (54.5, 7.5) to (61.5, 10.5) cm reaches outside the box"),
        (NEAR, "x_cm = 3.0\ny_cm = 1.0", "reaches outside the box"),
        (NEAR, "x_cm = 3.0\ny_cm = 1.5", "near: the obstacle covers the anchor"),
        (NEAR, "x_cm = 3.0\ny_cm = 5.0", "near: the obstacle touches the stem that runs start from"),
        ('name = "near"', 'name = "2"', "two scenarios are called `2`"),
        ("[[scenario]]\npossible = false", "[[scenario]]", None),
        ("possible = false", 'possible = "no"', "`scenario[1].possible` expected `bool`, got `str`"),
        ('name = "near"', 'name = "near"\npossible = false', "no scenario is possible"),
        ('name = "slalom"', 'name = "left"', "`left` is the name of the paper's task"),
        ('name = "slalom"', "", "missing required field `name`"),
        (
            START,
            "height_cm = 19.0",
            "[start]: the tip is 19 cm high; it must be above 0 cm and below stop_height_cm, 19 cm",
        ),
        (START, "height_cm = -2.0", "`start.height_cm` expected `float` > 0.0"),
        (START, "points_cm = [[0.0, 0.0], [0.0, 1.0]]", "`start.points_cm` expected `array` of length >= 10"),
        (START, f"points_cm = {[[1.0, 0.5 * i] for i in range(10)]}", "[start]: the first point is the anchor"),
        (START, f"tip_x_cm = 0.0\npoints_cm = {[[0.0, 0.5 * i] for i in range(10)]}", "not both"),
        ("hours = 48.0", "hours = 0.01", "`hours` expected `float` >= 0.08333333333333333"),
        ("hours = 48.0", "hours = nan", "`hours` expected `float`"),
        ("hours = 48.0", "hours = 48.0\nhour = 2", "unknown key `hour`; did you mean `hours`?"),
        ("hours = 48.0", "hours = ", "not valid TOML"),
    ],
)
def test_what_no_plant_can_be_set_is_told_in_one_line(tmp_path: Path, old: str, new: str, said: str | None) -> None:
    assert SLALOM.count(old) == 1
    path = written(tmp_path, SLALOM.replace(old, new))
    if said is None:
        assert read_task(path).is_possible.all()
        return

    with pytest.raises(BadInput) as told:
        read_task(path)

    text = str(told.value)
    assert text.startswith(str(path))
    assert said in text
    assert "\n" not in text
    assert told.value.exit_status == 2


def test_a_task_needs_scenarios_and_each_its_target_and_obstacle(tmp_path: Path) -> None:
    head, body = SLALOM.split("[[scenario]]", 1)
    first = body.split("[[scenario]]")[0]
    bare = head.split("[target]")[0]
    for text, said in (
        (head, "a task without scenarios"),
        (f"{head}[[scenario]]\n", "[[scenario]] 1: has no obstacle"),
        (f"{bare}[[scenario]]{first}", "[[scenario]] near: has no target"),
    ):
        with pytest.raises(BadInput) as told:
            read_task(written(tmp_path, text))
        assert said in str(told.value)
    common = f"{head}[obstacle]\nx_cm = 3.0\ny_cm = 9.0\n[[scenario]]\n"
    assert read_task(written(tmp_path, common)).scenarios == (
        Scenario("1", Target(4.0, 16.0, 1.5), Obstacle(3.0, 9.0)),
    )


def test_numbers_that_are_not_finite_are_told_in_tasks_that_no_file_held() -> None:
    stem = ((0.0, 0.0), *((math.nan, float(i)) for i in range(1, 10)))
    with pytest.raises(BadInput, match=r"mine \[start\]: holds a number that is not finite"):
        check_task(Task("own", MIDDLE.scenarios, stem), "mine")
    lost = Scenario("lost", Target(0.0, math.nan), Obstacle(3.0, 8.8))
    with pytest.raises(BadInput, match=r"mine \[\[scenario\]\] lost: holds a number that is not finite"):
        check_task(Task("own", (lost,)), "mine")


def test_as_many_scenarios_as_wanted(tmp_path: Path) -> None:
    one = "[[scenario]]\n[scenario.obstacle]\nx_cm = 3.0\ny_cm = 9.0\n"
    head = SLALOM.split("[[scenario]]", 1)[0]
    assert len(read_task(written(tmp_path, head + 100 * one)).scenarios) == 100
    with pytest.raises(BadInput, match="`scenario` expected `array` of length <= 100"):
        read_task(written(tmp_path, head + 101 * one))


def test_the_example_of_the_reference_page_is_a_task(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "task-file.md").read_text()
    task = read_task(written(tmp_path, page.split("```toml\n")[1].split("```")[0]))

    assert [s.name for s in task.scenarios] == ["from the left", "other side", "blocked"]
    assert task.scenarios[2] == replace(LEFT.scenarios[2], name="blocked")
    assert (task.start_cm, task.hours, task.stop_height_cm) == (LEFT.start_cm, LEFT.hours, LEFT.stop_height_cm)
