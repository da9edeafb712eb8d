"""NaN, infinities and 1e308 at every input of an evolved-like network, and in its constants: no lamp hears of them.

neat-python itself answers NaN with 1.0, and the right lamp would shine for ever. Here all 26 inputs go the whole way of
a rig: file, steering rule, decision core. What counts is a light that the network chose. That no file with such a
constant is read at all is tested with the files; here constants go bad afterwards.
"""

from __future__ import annotations

import itertools
import json
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import msgspec
import pytest

from flora_common.controller_file import INPUT_NAMES, LoadedController, parse_controller
from flora_common.messages import LightCommand, Stem
from flora_common.network import Network, Node
from flora_common.shapes import Obstacle, Target
from flora_controller.core import ControllerCore, ControllerSection, Lineup
from flora_controller.evolved import Evolved
from flora_controller.record import Record
from signing_keys import EXPORT

NOT_FINITE: Final = (math.nan, math.inf, -math.inf)
BAD: Final = (*NOT_FINITE, 1e308, -1e308)
POINTS: Final = tuple((0.3 * i + 0.1, 2.0 * i + 0.1) for i in range(10))
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)
HIDDEN: Final = 3
LINKS: Final = 26 * HIDDEN + HIDDEN * (HIDDEN - 1) // 2 + HIDDEN


def _evolved_like() -> LoadedController:
    """All 26 inputs into three hidden nodes, these into one another and the output, as grown genomes are."""
    chance = random.Random(1)
    table = json.loads(EXPORT.read_text(encoding="utf-8"))
    network = table["network"]
    into_output = network["nodes"][0] | {"id": 0, "type": "output", "bias": 0.1}
    sigmoid = {"name": "sigmoid", "custom": False}
    hidden = [
        {**into_output, "id": i, "type": "hidden", "activation": sigmoid, "bias": chance.gauss(0, 1)}
        for i in range(1, HIDDEN + 1)
    ]
    inputs = [node for node in network["nodes"] if node["type"] == "input"]
    pairs = [
        *itertools.product((node["id"] for node in inputs), range(1, HIDDEN + 1)),
        *itertools.combinations(range(1, HIDDEN + 1), 2),
        *((i, 0) for i in range(1, HIDDEN + 1)),
    ]
    network["nodes"] = [into_output, *hidden, *inputs]
    network["connections"] = [{"from": a, "to": b, "weight": chance.gauss(0, 1), "enabled": True} for a, b in pairs]
    return parse_controller(json.dumps(table).encode(), where="evolved-like")


LOADED: Final = _evolved_like()


def answered(
    loaded: LoadedController = LOADED,
    *,
    points: Any = POINTS,
    target: Target = TARGET,
    obstacle: Obstacle = OBSTACLE,
) -> LightCommand:
    """What the lamps hear of one stem. The messages' own bounds are left out: the core must not rely on them."""
    heard = Stem(tick=1, time_s=300.0, outcome="ok", points_cm=points)
    steering = Evolved(loaded, target, obstacle, "evolved-like")
    # The judgement of the plant is told the true task: the network alone is fed the bad one.
    core = ControllerCore(
        Lineup(steering), ControllerSection(), target=TARGET, obstacle=OBSTACLE, record=Record(run="r")
    )
    answer = core.on_stem(heard)
    assert answer is not None
    return answer[0]


def test_the_network_steers_when_all_is_well() -> None:
    assert not answered().blind


def _with_input(name: str, bad: float) -> dict[str, Any]:
    """The stem, target or obstacle in which one of the 26 inputs is bad."""
    place = INPUT_NAMES.index(name)
    if place < 2 * len(POINTS):
        flat = [v for point in POINTS for v in point]
        flat[place] = bad
        return {"points": tuple(zip(flat[::2], flat[1::2], strict=True))}
    if name.startswith("target"):
        return {"target": replace(TARGET, **{f"{name[-1]}_cm": bad})}
    return {"obstacle": replace(OBSTACLE, **{"x_cm" if name.endswith(("left", "right")) else "y_cm": bad})}


def test_no_light_comes_from_an_input_that_is_no_sensible_number() -> None:
    asked = [(name, bad, answered(**_with_input(name, bad))) for name in INPUT_NAMES for bad in BAD]

    assert len(asked) == 26 * len(BAD)
    assert [(name, bad) for name, bad, command in asked if not command.blind] == []


class _Damaged(Network):
    """A network whose constants went bad after it was checked, as memory does."""

    def __init__(self, good: Network, nodes: list[Node]) -> None:
        super().__init__(good.inputs, good.outputs, good.nodes)
        self.nodes = tuple(nodes)


def _damaged() -> Iterator[LoadedController]:
    good = LOADED.network
    for at, node in enumerate(good.nodes):
        worse = [replace(node, bias=bad) for bad in NOT_FINITE] + [replace(node, response=bad) for bad in NOT_FINITE]
        for link, (source, _) in enumerate(node.links):
            for bad in NOT_FINITE:
                links = (*node.links[:link], (source, bad), *node.links[link + 1 :])
                worse.append(replace(node, links=links))
        for changed in worse:
            nodes = [*good.nodes[:at], changed, *good.nodes[at + 1 :]]
            yield replace(LOADED, network=_Damaged(good, nodes))


def test_no_light_comes_from_a_constant_that_went_bad_in_memory() -> None:
    commands = [answered(loaded) for loaded in _damaged()]

    assert len(commands) == (LINKS + 2 * (HIDDEN + 1)) * len(NOT_FINITE)
    assert [command for command in commands if not command.blind] == []


@pytest.mark.parametrize("bad", BAD)
def test_the_bus_refuses_such_a_stem_before_anybody_sees_it(bad: float) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"tick": 1, "time_s": 0.0, "outcome": "ok", "points_cm": [*POINTS[:9], (bad, 1.0)]}, Stem)
