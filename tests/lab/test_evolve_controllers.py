"""Evolved networks as controller files: the rig decides as evolution did, to the last bit."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from evolve_genomes import INPUTS as INPUT_COUNT
from evolve_genomes import random_networks
from evolve_reference import Fed, asked_as_neat_does, controller_of, neat_network
from neat.export import export_network_json

from flora_common.arrays import Array
from flora_common.controller_file import INPUT_NAMES, LoadedController, parse_controller
from flora_common.errors import BadController
from flora_common.network import NotFinite
from flora_common.shapes import Obstacle, Target
from flora_controller.evolved import Evolved
from flora_controller.steering import View
from flora_lab.evolve.controllers import (
    INPUTS,
    SCALE_CM,
    FromFile,
    controller_bytes,
    export_of,
)
from flora_lab.evolve.task import LEFT, MIDDLE, Scenario, Task

TARGET, OBSTACLE = LEFT.scenarios[1].target, LEFT.scenarios[1].obstacle


def stems(count: int, seed: int = 2) -> Array:
    """Stems that lean here and there, shape (count, 10, 2)."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 10)
    tips = np.stack([rng.normal(scale=5.0, size=count), rng.uniform(5.0, 21.0, count)], axis=-1)
    bow = rng.normal(scale=2.0, size=count)[:, None] * np.sin(math.pi * share)
    out = tips[:, None] * share[:, None]
    out[..., 0] += bow
    return out


def bits(ask: Any, values: Sequence[float]) -> bytes | None:
    """The answer's very bits; None where there is none, or no finite one on the way to it."""
    try:
        (output,) = ask(values)
    except (NotFinite, OverflowError):
        return None
    return np.float64(output).tobytes()


def test_the_inputs_are_the_papers_26_in_its_order() -> None:
    assert [entry.name for entry in INPUTS] == list(INPUT_NAMES)
    assert len(INPUTS) == INPUT_COUNT
    loaded = controller_of(random_networks(1, 1)[0], LEFT)
    stem = stems(1)[0]

    values = loaded.values(stem.tolist(), TARGET, OBSTACLE)

    wanted = [*stem.ravel(), -5.12, 17.9, -5.57 - 3.5, 8.8 - 1.5, -5.57 + 3.5, 8.8 + 1.5]
    assert np.abs(np.array(values) * SCALE_CM - wanted).max() < 1e-12


@pytest.mark.parametrize("calm", [True, False])
def test_what_was_evolved_and_what_the_rig_runs_answer_alike(calm: bool) -> None:
    seen = stems(12)
    answered = 0
    sides: set[str | None] = set()
    for network in random_networks(120, 3, calm=calm):
        loaded = controller_of(network, LEFT)
        again = neat_network(loaded)
        neats = asked_as_neat_does(loaded)
        rig = Evolved(loaded, TARGET, OBSTACLE, "rig")
        for stem in seen:
            values = loaded.values(stem.tolist(), TARGET, OBSTACLE)
            wanted = bits(loaded.network.activate, values)
            decision = rig.decide(View(0.0, stem, None), {})
            sides.add(decision.light)
            if wanted is None:
                assert decision.light is None
                continue
            answered += 1
            assert bits(network.activate, values) == bits(again.activate, values) == wanted
            told = (FromFile(loaded).output(stem, TARGET, OBSTACLE), neats.output(stem, TARGET, OBSTACLE))
            assert {np.float64(output).tobytes() for output in told} == {wanted}
            assert decision.light == ("left" if told[0] <= 0.5 else "right")
            assert decision.output == told[0]
    assert answered == 120 * 12 if calm else answered > 800
    assert {"left", "right"} <= sides


def test_there_and_back_is_the_same_file() -> None:
    for network in random_networks(40, 4):
        loaded = controller_of(network, MIDDLE, name="one", provenance={"seed": 4})
        back = controller_of(neat_network(loaded), MIDDLE, name="one", provenance={"seed": 4})
        again = parse_controller(loaded.data, where="again")

        assert again.file == loaded.file
        assert {n.key: n for n in back.network.nodes} == {n.key: n for n in loaded.network.nodes}


# neat-python asks for the time of day in a way that Python 3.12 advises against.
@pytest.mark.filterwarnings("ignore:datetime.datetime.utcnow:DeprecationWarning")
def test_the_export_is_neat_pythons_own_but_for_the_time_of_day() -> None:
    for network in random_networks(20, 5):
        table = json.loads(controller_bytes("one", export_of(network), LEFT, {}))["network"]
        theirs = json.loads(export_network_json(network))

        assert theirs.pop("metadata")
        assert table.pop("metadata") == {}
        assert table == theirs


def test_the_same_network_gives_the_same_bytes() -> None:
    one, other = (controller_of(random_networks(3, 6)[2], LEFT).data for _ in range(2))
    assert one == other
    assert one.endswith(b"}\n")
    assert controller_of(random_networks(3, 6)[1], LEFT).data != one


def test_the_file_says_what_it_was_evolved_for() -> None:
    network = random_networks(1, 7)[0]
    loaded = controller_of(network, LEFT, name="left-1", provenance={"seed": 7, "fitness": 0.825})
    task = loaded.file.task

    assert (loaded.file.name, task.name) == ("left-1", "left")
    assert task.target is not None
    assert (task.target.x_cm, task.target.y_cm, task.target.radius_cm) == (-5.12, 17.9, 2.0)
    assert [o.x_cm for o in task.obstacles] == [-8.24, -5.57, -2.90, 2.43]
    assert loaded.file.provenance == {"seed": 7, "fitness": 0.825}
    two = Task("two", (Scenario("a", TARGET, OBSTACLE), Scenario("b", Target(1.0, 15.0), OBSTACLE)))
    told = controller_of(network, two).file.task
    assert told.target is None
    assert len(told.obstacles) == 1


def test_what_the_rig_would_refuse_is_told_before_it_is_written() -> None:
    network = random_networks(1, 8)[0]
    key, activation, aggregation, _, response, links = network.node_evals[0]
    network.node_evals[0] = (key, activation, aggregation, 1e7, response, links)
    with pytest.raises(BadController, match=r"nine: .*bias"):
        controller_of(network, LEFT, name="nine")
    network.node_evals[0] = (key, lambda z: z, aggregation, 0.0, response, links)
    with pytest.raises(BadController, match="is custom"):
        controller_of(network, LEFT)


def test_any_function_can_be_fed_as_a_file_says() -> None:
    loaded: LoadedController = controller_of(random_networks(1, 9)[0], LEFT)
    seen: list[Sequence[float]] = []

    def ask(values: Sequence[float]) -> float:
        seen.append(values)
        return 0.25

    stem = stems(1)[0]
    assert Fed(loaded, ask).output(stem, TARGET, Obstacle(1.0, 9.0)) == 0.25
    assert seen == [loaded.values(stem.tolist(), TARGET, Obstacle(1.0, 9.0))]
