"""What is wrong in simulators themselves, hidden and counted: how it is drawn, and how it is counted.

``make discovery-simulators`` judges whole worlds.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from discovery import simulators
from discovery.simulators import CLOSEST, FASTEST, SLOWEST, Judged, clock, clocks_table, memory_table, thinned
from flora_common.errors import BadInput
from flora_common.tracks import Track
from flora_lab.run_tracks import RunTrack


def track(rows: int = 100) -> RunTrack:
    points = np.zeros((rows, 10, 2))
    points[:, :, 1] = np.linspace(0.0, 1.0, 10) * np.linspace(3.0, 4.0, rows)[:, None]
    light = tuple("left" if row // 30 % 2 == 0 else "right" for row in range(rows))
    return RunTrack(
        "run", "bean", Path("track.csv"), "0" * 64, Track(300.0 * np.arange(rows) + 60.0, light, points, {})
    )


def test_a_thinned_track_grows_faster_and_is_shorter() -> None:
    whole, few = track().track, thinned(track(), 4).track
    assert few.time_s.tolist() == (300.0 * np.arange(25) + 60.0).tolist()
    assert np.array_equal(few.points_cm, whole.points_cm[::4])
    assert few.light == whole.light[::4]


def test_clocks_are_wrong_to_either_side_by_at_least_so_much() -> None:
    rng = np.random.default_rng(3)
    drawn = np.array([clock(rng) for _ in range(2000)])
    assert drawn.min() >= SLOWEST
    assert drawn.max() <= FASTEST
    assert (np.abs(np.log(drawn)) >= np.log(CLOSEST) - 1e-12).all()
    assert 0.2 < (drawn < 1.0).mean() < 0.4


def judged(simulator: str, factor: float | None, *faults: dict[str, Any], world: int = 1, effect: str = "") -> Judged:
    return Judged(world, 0, simulator, "affected" if effect else "healthy", effect, factor, list(faults))


def wrong(factor: float, low: float, high: float, confidence: float = 0.97) -> dict[str, Any]:
    return {
        "effect": "time_scale",
        "parameters": {"factor": factor},
        "interval": {"factor": [low, high]},
        "confidence": confidence,
    }


MISSING = {"effect": "memory", "parameters": {}, "interval": {}, "confidence": 0.97}


def test_what_is_told_of_each_kind_is_counted() -> None:
    told = [
        judged("remembers", 1.0),
        judged("remembers", 1.0),
        judged("remembers", 1.0, wrong(2.0, 1.5, 2.5), effect="sag"),
        judged("remembers", 4.0, wrong(4.4, 3.0, 5.0, 0.999)),
        judged("remembers", 2.0, wrong(3.0, 2.5, 5.0, 0.991)),
        judged("remembers", 0.5, wrong(2.0, 1.5, 2.5)),
        judged("remembers", 0.5),
        judged("forgets", None, MISSING),
        judged("forgets", 5.0, MISSING, wrong(5.5, 5.0, 6.0)),
    ]
    assert memory_table(told).splitlines()[2:] == [
        "| forgets, 3 to 12 times too fast | healthy | 1 | 1 | 1 |",
        "| forgets, as learned | healthy | 1 | 0 | 1 |",
        "| remembers, 0.3 to 12 times too fast | healthy | 4 | 3 | - |",
        "| remembers, in time | affected | 1 | 1 | - |",
        "| remembers, in time | healthy | 2 | 0 | - |",
    ]
    assert clocks_table(told).splitlines()[2:] == [
        "| 0.9 to 0.99 | 3 | 1 | - | - | 0 of 0 |",
        "| 0.99 to 0.999 | 1 | 1 | 50 % | 50 % | 0 of 1 |",
        "| 0.999 to 1 | 1 | 1 | 10 % | 10 % | 1 of 1 |",
        "",
        "Of 4 clocks of simulators that remember and are wrong, 2 were told.",
    ]


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    for text in ("not JSON\n", '[{"seed": 1}]\n', "[1]\n"):
        (tmp_path / "results.jsonl").write_text(text)
        with pytest.raises(BadInput, match="is no results file"):
            simulators.read_results(tmp_path / "results.jsonl")


def test_worlds_that_are_judged_are_not_judged_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = tmp_path / "results.jsonl"
    kept = [judged("remembers", 1.0, world=5), judged("forgets", None, MISSING, world=5)]
    results.write_text(json.dumps([asdict(one) for one in kept]) + '\n[{"world": 6')
    monkeypatch.setattr(simulators, "judge_world", lambda seed, form: pytest.fail(f"world {seed} {form}"))
    options = simulators.parsed(["--worlds", "1", "--seed", "5", "--results", str(results)])
    assert simulators.judge_all(options) == kept
