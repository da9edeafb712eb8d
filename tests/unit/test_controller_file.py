"""Controller files: what is accepted, and the sentence for what is not."""

from __future__ import annotations

import copy
import json
import math
import os
from pathlib import Path
from typing import Any

import pytest

from flora_common.controller_file import (
    INPUT_NAMES,
    MAX_BYTES,
    bytes_to_sign,
    load_controller,
    parse_controller,
)
from flora_common.errors import BadController
from flora_common.network import NotFinite
from flora_common.shapes import Obstacle, Target
from flora_common.stem_range import StemRange
from flora_controller.main import main

GOLDEN = Path(__file__).parent.parent / "golden" / "controllers"
SENTENCES: dict[str, str] = json.loads((GOLDEN / "bad" / "sentences.json").read_text(encoding="utf-8"))
EXPORT = GOLDEN / "good" / "neat_export.controller.json"
TIP_ONLY = GOLDEN / "good" / "tip_only.controller.json"
STEM = [[0.1 * i, 2.0 * i] for i in range(10)]
TARGET, OBSTACLE = Target(-5.12, 17.9), Obstacle(-6.3, 12.5)


def test_every_bad_example_has_its_sentence() -> None:
    assert sorted(SENTENCES) == sorted(p.name.split(".")[0] for p in (GOLDEN / "bad").glob("*.controller.json"))


@pytest.mark.parametrize("name", sorted(SENTENCES))
def test_bad_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = GOLDEN / "bad" / f"{name}.controller.json"

    with pytest.raises(BadController) as caught:
        load_controller(path)

    said = str(caught.value)
    assert said == f"{path}: {SENTENCES[name]}"
    assert "\n" not in said
    assert len(said) < 400
    assert main(["check", str(path)]) == 2
    assert capsys.readouterr().err == f"flora-controller: {said}\n"


def test_check_says_what_a_good_file_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(EXPORT)]) == 0
    assert "26 inputs, 4 nodes" in capsys.readouterr().out


def test_a_range_of_stems_may_be_there_and_check_tells_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = {"left_cm": -8.5, "right_cm": 9.0, "lowest_tip_cm": 6.2, "highest_tip_cm": 21.0}
    lengths = {"shortest_cm": 6.5, "longest_cm": 24.0}
    path = tmp_path / "ranged.controller.json"
    path.write_text(json.dumps(json.loads(TIP_ONLY.read_text()) | {"stem_range": told | lengths}))

    assert load_controller(TIP_ONLY).file.stem_range is None
    assert load_controller(path).file.stem_range == StemRange(**told, **lengths)
    assert [main(["check", str(file)]) for file in (TIP_ONLY, path)] == [0, 0]
    without, ranged = capsys.readouterr().out.splitlines()
    assert "no stem range" in without
    assert "stems from x -8.5 to 9 cm, tips 6.2 to 21 cm high, 6.5 to 24 cm long" in ranged


def test_a_network_exported_by_neat_python_gives_neat_pythons_answers() -> None:
    network = load_controller(EXPORT).network

    for case in json.loads((GOLDEN / "good" / "neat_export.answers.json").read_text()):
        (output,) = network.activate(case["inputs"])
        assert output == pytest.approx(case["output"], rel=1e-14, abs=0.0)


def test_inputs_are_the_papers_26_and_scaled() -> None:
    loaded = load_controller(EXPORT)

    values = dict(zip(INPUT_NAMES, loaded.values(STEM, TARGET, OBSTACLE), strict=True))

    assert len(values) == 26
    assert values["x3"] == pytest.approx(0.2 / 10)
    assert values["y10"] == pytest.approx((18.0 - 10.0) / 10)
    assert values["target_x"] == pytest.approx(-0.512)
    edges = [values[f"obstacle_{edge}"] for edge in ("left", "bottom", "right", "top")]
    assert edges == pytest.approx([-0.98, 0.1, -0.28, 0.4])


@pytest.mark.parametrize(("target", "obstacle", "wants"), [(None, OBSTACLE, "target"), (TARGET, None, "obstacle")])
def test_a_task_that_lacks_what_the_network_wants_is_told(
    target: Target | None, obstacle: Obstacle | None, wants: str
) -> None:
    with pytest.raises(BadController, match=rf"wants to know the {wants}; give run.toml a section \[{wants}\]"):
        load_controller(EXPORT).check_task(target, obstacle)


def test_a_network_that_does_not_look_at_the_obstacle_needs_none() -> None:
    assert load_controller(TIP_ONLY).values(STEM, TARGET, None) == (0.9, -5.12)


def test_a_link_to_a_file_is_followed(tmp_path: Path) -> None:
    current = tmp_path / "current.controller.json"
    current.symlink_to(TIP_ONLY)

    assert load_controller(current).sha256 == load_controller(TIP_ONLY).sha256


@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "loop", "dangling", "large"])
def test_what_is_no_regular_file_of_sensible_size(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "x.controller.json"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "dangling":
        path.symlink_to(tmp_path / "gone")
    elif kind == "large":
        path.write_bytes(b" " * (MAX_BYTES + 1))
    wanted = {
        "folder": r"cannot be read \(Is a directory\); name the file in it, such as best.controller.json",
        "pipe": "not a regular file",
        "large": f"{MAX_BYTES + 1} bytes; a controller file has at most {MAX_BYTES}",
    }.get(kind, "cannot be read")

    with pytest.raises(BadController, match=f"^{path}: {wanted}"):
        load_controller(path)


def _numbers(node: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Places of the network's constants in the parsed file."""
    if isinstance(node, dict):
        return [place for key, value in node.items() for place in _numbers(value, (*at, key))]
    if isinstance(node, list):
        return [place for i, value in enumerate(node) for place in _numbers(value, (*at, i))]
    return [at] if at[-1] in ("weight", "bias", "response", "offset", "scale") else []


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308, -1e308])
def test_no_constant_may_be_anything_but_a_sensible_number(bad: float) -> None:
    good = json.loads(EXPORT.read_text())
    places = _numbers(good)
    assert len(places) > 100

    for place in places:
        table = copy.deepcopy(good)
        inner = table
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = bad
        with pytest.raises(BadController):
            parse_controller(json.dumps(table).encode(), where="x")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308, -1e308])
def test_no_input_may_be_anything_but_a_sensible_number(bad: float) -> None:
    network = load_controller(EXPORT).network

    for place in range(26):
        values = [0.1] * 26
        values[place] = bad
        with pytest.raises(NotFinite, match=f"input {place + 1} "):
            network.activate(values)


def test_the_bytes_to_sign_leave_the_signature_out_and_do_not_depend_on_the_order_of_keys() -> None:
    table = json.loads(EXPORT.read_text())
    turned = dict(reversed(table.items()))
    signed = table | {"signature": {"algorithm": "ed25519", "key": "k", "value": "v"}}
    other = table | {"name": "another"}

    assert bytes_to_sign(table) == bytes_to_sign(turned) == bytes_to_sign(signed)
    assert bytes_to_sign(table) != bytes_to_sign(other)
    assert parse_controller(json.dumps(signed).encode(), where="x").file.signature is not None
