"""``outcome.json``: what is written comes back, and nothing in it is believed unseen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from flora_common.errors import BadInput
from flora_common.experiment_file import (
    FORMAT,
    Controller,
    ExperimentFile,
    Measured,
    Pictures,
    Really,
    read_experiment,
    write_experiment,
)
from flora_common.runs import ObstacleSection, TargetSection

OUTCOME = ExperimentFile(
    format=FORMAT,
    software="flora 0.1.0",
    controller=Controller("left", "0" * 64),
    seed=7,
    target=TargetSection(-5.12, 17.9),
    obstacle=ObstacleSection(-6.3, 12.5),
    hours=72.0,
    stop_height_cm=21.0,
    measured=Measured("height", 65.4, 0.883, 51.6, 0.796, 0.991, 1.0, 785, 784, 31),
    true=Really(1.1, 0.06, 0.11),
    pictures=Pictures(793, 0, 0, 0),
    restarts={"flora-stem": 1},
    took_s=93.5,
    run="rig/runs/bean",
)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    write_experiment(tmp_path, OUTCOME)
    assert read_experiment(tmp_path) == OUTCOME


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "flora-experiment-2"}, "$.format"),
        ({"run": "/etc"}, "must be a relative path inside the folder"),
        ({"run": "rig/../../.."}, "must be a relative path inside the folder"),
        ({"seed": -1}, "$.seed"),
        ({"seed": True}, "$.seed"),
        ({"hours": "72"}, "$.hours"),
        ({"extra": 1}, "unknown field `extra`"),
        ({"controller": {"name": "left", "sha256": "0" * 63}}, "$.controller.sha256"),
        ({"measured": None}, "$.measured"),
        ({"target": {"x_cm": 1e9, "y_cm": 0.0}}, "$.target.x_cm"),
    ],
)
def test_what_is_none_is_told_in_a_line(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    write_experiment(tmp_path, OUTCOME)
    file = tmp_path / "outcome.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(BadInput) as told:
        read_experiment(tmp_path)
    assert said in str(told.value)
    assert str(file) in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff", b'{"format": NaN}', b"[" * 100_000])
def test_what_is_no_json_is_told_in_a_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "outcome.json").write_bytes(content)
    with pytest.raises(BadInput, match="not the outcome of an experiment"):
        read_experiment(tmp_path)


def test_what_is_missing_is_told_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read"):
        read_experiment(tmp_path)
