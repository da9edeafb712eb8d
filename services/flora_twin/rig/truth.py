"""What the camera saw against what was there: only a virtual rig can tell."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flora_common.geometry import clearance_cm, distance_to_polyline_cm
from flora_common.runs import RunFolder
from flora_common.tracks import read_track


@dataclass(frozen=True, slots=True)
class TruthCheck:
    """Measured stems beside the true ones, over all readings of a run.

    Attributes:
        tip_median_cm, tip_p95_cm: distance of the measured to the true tip.
        stem_median_cm, stem_p95_cm: distance of the measured points to the true centreline.
        clearance_cm: smallest true distance of stem and obstacle; None without one.
    """

    tip_median_cm: float
    tip_p95_cm: float
    stem_median_cm: float
    stem_p95_cm: float
    clearance_cm: float | None


def check_truth(run: RunFolder, box_dir: Path) -> TruthCheck | None:
    """Compare ``track.csv`` with the grow box's ``truth.jsonl``; None where no photograph of the run has a stem.

    Args:
        run: the run folder.
        box_dir: the grow box's folder.
    """
    by_hash = {line["sha256"]: line for line in _lines(box_dir / "truth.jsonl") if "centreline_cm" in line}
    # Tables have milliseconds; photographs are matched by time to the table, and by hash to the truth.
    truth_at = {
        round(line["time_s"], 3): by_hash[line["sha256"]]
        for line in _lines(run.frames_log)
        if line["sha256"] in by_hash and not line["file"].startswith("background/")
    }
    if not run.track_csv.exists():
        return None
    track = read_track(run.track_csv)
    tips: list[float] = []
    stems: list[float] = []
    clearances: list[float] = []
    obstacle = run.read_run_file().obstacle_or_none()
    for time_s, points in zip(track.time_s, track.points_cm, strict=True):
        truth = truth_at.get(round(float(time_s), 3))
        if truth is None:
            continue
        centreline = np.array(truth["centreline_cm"])
        tips.append(float(np.linalg.norm(points[-1] - centreline[-1])))
        stems += distance_to_polyline_cm(points[1:], centreline).tolist()
        if obstacle is not None:
            clearances.append(clearance_cm(centreline, obstacle))
    if not tips:
        return None
    tip_median_cm, tip_p95_cm = (float(v) for v in np.percentile(tips, [50, 95]))
    stem_median_cm, stem_p95_cm = (float(v) for v in np.percentile(stems, [50, 95]))
    least_cm = min(clearances) if clearances else None
    return TruthCheck(tip_median_cm, tip_p95_cm, stem_median_cm, stem_p95_cm, least_cm)


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines() if line]
