"""``flora-twin experiment``, and ``flora-lab evaluate --on twin`` over it: a controller through the whole rig."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.controller_file import load_controller
from flora_common.experiment_file import read_experiment
from flora_common.runs import RunFolder
from flora_common.tracks import read_track
from flora_lab.judging import judge
from flora_lab.main import main as lab
from flora_twin.main import main as twin

TIP_ONLY = Path(__file__).parents[1] / "golden" / "controllers" / "good" / "tip_only.controller.json"

HOUR = """
name = "an hour"
hours = 1.0

[[scenario]]
name = "away"
[scenario.target]
x_cm = 4.0
y_cm = 16.0
[scenario.obstacle]
x_cm = 20.0
y_cm = 12.5
"""


def test_a_controller_is_sent_through_the_rig_and_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task, out = tmp_path / "hour.toml", tmp_path / "out"
    task.write_text(HOUR)
    arguments = ["evaluate", str(TIP_ONLY), "--on", "twin", "--task", str(task), "--repeat", "1", "--seed", "20004"]
    assert lab([*arguments, "-o", str(out), "--json"]) == 0
    (trial,) = json.loads(capsys.readouterr().out)["trials"]
    (folder,) = (out / "runs").iterdir()

    outcome = read_experiment(folder)
    assert outcome.controller.sha256 == load_controller(TIP_ONLY).sha256
    assert outcome.seed == 20004
    assert (outcome.pictures.missing, outcome.pictures.torn, outcome.pictures.not_stored) == (0, 0, 0)
    assert outcome.true is not None
    assert outcome.true.tip_off_median_cm < 0.5
    assert trial["true_clearance_cm"] == pytest.approx(trial["clearance_cm"], abs=0.5)
    assert (trial["ended"], trial["hours"], trial["place"]) == ("time", 1.0, "twin")

    run = RunFolder(folder / outcome.run)
    assert run.read_run_file().target_or_none() is not None
    track = read_track(run.track_csv)
    judged = judge(track.time_s, track.points_cm, run.read_run_file().target_or_none(), None, hours=1.0)
    assert judged.fitness_at_stop == pytest.approx(trial["fitness_at_end"])
    # its lamps were the network's, once a picture had told which part of the seedling is the stem: the tip is left of
    # the target, so the right one shone
    assert set(track.light[2:]) == {"right"}
    assert cv2.imdecode(np.fromfile(folder / "strip.jpg", np.uint8), cv2.IMREAD_COLOR).shape[1] > 400


def test_a_run_ends_where_the_stem_touches_the_obstacle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    place = ["--target", "0.0,17.9", "--obstacle", "0.0,8.8,7.0,5.0"]
    assert twin(["experiment", "-o", str(out), *place, "--seed", "4", "--hours", "20"]) == 0
    said = capsys.readouterr().out
    outcome = read_experiment(out)
    assert (outcome.measured.ended, outcome.measured.clearance_cm) == ("collision", 0.0)
    assert outcome.measured.ended_h < 1.0
    assert outcome.measured.photographs <= 12
    assert (outcome.controller.name, outcome.controller.sha256) == ("waypoint", "")
    assert "obstacle   touched at hour" in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--target", "1"], "--target `1`: write X,Y or X,Y,RADIUS"),
        (["--target", "1,nan"], "--target"),
        (["--target", "1,900"], "--target: `y_cm`"),
        (["--obstacle", "1,2,3"], "write X,Y or X,Y,WIDTH,HEIGHT"),
        (["--obstacle", "1,2,0,3"], "--obstacle: `width_cm`"),
        (["--target", "61,16"], "target (61, 16) cm is outside the box"),
        (["--target=-5,-3"], "target (-5, -3) cm is outside the box"),
        (["--target", "0.5,1"], "the target lies on the anchor"),
        (["--target=-6,12"], "target (-6, 12) cm is inside the obstacle"),
        (["--stop-height", "15"], "the target begins 15.9 cm high and runs end at --stop-height, 15 cm"),
        (["--obstacle", "58,12"], "obstacle from (54.5, 10.5) to (61.5, 13.5) cm reaches outside the box"),
        (["--obstacle", "0,1"], "reaches outside the box"),
        (["--obstacle", "0,1.5"], "the obstacle covers the anchor"),
        (["--controller", "none.controller.json"], "none.controller.json: cannot be read"),
        (["--speed", "warp"], "write lockstep, realtime, or a number"),
    ],
)
def test_what_cannot_be_done_ends_with_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert twin(["experiment", "-o", str(tmp_path / "out"), *arguments]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.strip().count("\n") == 0
    assert not (tmp_path / "out").exists()
