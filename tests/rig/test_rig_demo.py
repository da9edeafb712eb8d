"""``flora-twin demo``: one command from an empty folder to a page with a result."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from flora_common.runs import RunFolder
from flora_common.tracks import read_track
from flora_twin.main import main
from flora_twin.rig import experiment
from flora_twin.rig.truth import check_truth


def test_the_demo_ends_with_a_result_to_look_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment, "DASHBOARD_PORT", 0)  # the usual one may be wanted by a rig of this machine
    out = tmp_path / "out"
    arguments = ["demo", "--out", str(out), "--hours", "1", "--seed", "4", "--quiet"]
    assert main([*arguments, "--fault", "service_killed@0.5h=flora-led"]) == 0
    said = capsys.readouterr().out
    run = RunFolder(out / "rig" / "runs" / "bean")
    frames = run.read_frames()
    assert len(frames) >= 12
    assert [frame.time_s for frame in frames] == [300.0 * i for i in range(len(frames))]
    # The rig is stopped inside a tick, so its very last photograph may be without a stem; no other may.
    readings = read_track(run.track_csv).time_s.tolist()
    assert readings == [frame.time_s for frame in frames][: len(readings)]
    assert len(frames) - len(readings) <= 1
    assert len(run.background_pictures()) == 8
    assert f"{len(frames) + 8} announced, 0 missing, 0 torn, {len(frames) + 8} at the NAS" in said.replace("\n", " ")
    assert "flora-led 1" in said
    assert "url=http://127.0.0.1:" in (out / "rig" / "logs" / "flora-dashboard.log").read_text()
    assert (out / "report.html").read_text().startswith("<!doctype html>")
    assert cv2.imread(str(out / "strip.png")) is not None
    assert [file.suffix for file in sorted(run.bus.iterdir())] == [".mcap"]
    truth = check_truth(run, out / "rig" / "box")
    assert truth is not None
    assert truth.tip_median_cm < 0.5  # a seedling: its leaves are still small
    assert truth.clearance_cm is not None
    assert truth.clearance_cm > 3.0


def test_a_demo_is_made_anew_in_the_same_folder_and_says_what_it_cannot_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path), "--hours", "1", "--controller", "waypont"]) == 2
    assert "waypoint" in capsys.readouterr().err
    assert main(["demo", "--out", str(tmp_path), "--hours", "1", "--fault", "nas_gone@2h"]) == 2
    assert "would never strike" in capsys.readouterr().err
