"""The path method on photographs of real plants, and the figures that the how-to page quotes (run with ``-s``)."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from flora_common.tracks import read_track
from flora_lab.main import main
from real_photographs import BEAN, FOLDED, STALK, RealPlant, independent_apex_px


def tracked(
    capfd: pytest.CaptureFixture[str], out: Path, plant: RealPlant, *more: str
) -> tuple[dict, list[dict[str, str]]]:
    """The summary, and the table of all readings."""
    files = ["-o", str(out / "t.csv"), "--overlays", str(out / "o"), "--json"]
    assert main(["track", str(plant.path), *plant.options, *more, *files]) == 0
    with (out / "o" / "readings.csv").open() as file:
        return json.loads(capfd.readouterr().out), list(csv.DictReader(file))


def tell(capfd: pytest.CaptureFixture[str], text: str) -> None:
    with capfd.disabled():
        print(f"\n  {text}", end="")


@BEAN.needed
def test_bean_is_followed_without_a_window(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found, _ = tracked(capfd, tmp_path, BEAN)
    track = read_track(tmp_path / "t.csv")
    x = 361 + track.points_cm[:, 9, 0] * 20
    y = 335 - track.points_cm[:, 9, 1] * 20
    tell(capfd, f"bean, path: {found['outcomes']} of 94, lights {found['lights']}, setup {found['setup']}")
    tell(
        capfd, f"bean, path: tip x {x[:3].mean():.0f} -> {x[40:47].mean():.0f} (left) -> {x[-3:].mean():.0f} px (right)"
    )
    tell(capfd, f"bean, path: step of the tip median {np.median(np.hypot(np.diff(x), np.diff(y))):.1f} px")
    assert found["readings"] >= 90
    assert found["lights"] == {"left": 47, "right": 47}
    assert x[:3].mean() - x[40:47].mean() > 12  # to the left lamp
    assert x[-3:].mean() - x[40:47].mean() > 15  # and back to the right one
    assert y[-1] < y[0] - 15  # it grew


@STALK.needed
def test_stalk_follows_the_independent_apex_and_its_period(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found, readings = tracked(capfd, tmp_path, STALK)
    apex = independent_apex_px()
    ok = [i for i, r in enumerate(readings) if r["outcome"] == "ok"]
    tip = np.array([(float(readings[i]["tip_x_px"]), float(readings[i]["tip_y_px"])) for i in ok])
    off = tip - apex[ok]
    r_x, r_y = (float(np.corrcoef(tip[:, k], apex[ok, k])[0, 1]) for k in range(2))
    rms, about = (float(np.sqrt((v**2).sum(axis=1).mean())) for v in (off, off - off.mean(axis=0)))
    tell(capfd, f"stalk, path: {found['outcomes']} of 296; ok: r_x {r_x:.3f}, r_y {r_y:.3f}, RMS {rms:.1f} px,")
    tell(capfd, f"stalk, path: mean ({off[:, 0].mean():+.1f}, {off[:, 1].mean():+.1f}) px, RMS about it {about:.1f} px")
    x = np.interp(np.arange(296), ok, tip[:, 0])
    periods = [_period_frames(v[96:]) for v in (x, apex[:, 0])]
    tell(capfd, f"stalk, path: period {periods[0]:.0f} frames, of the independent track {periods[1]:.0f}")
    assert len(ok) > 200
    assert r_x > 0.95
    assert about < 15
    assert abs(periods[0] - periods[1]) <= 3
    for peak in (183, 250):
        near = slice(peak - 15, peak + 16)
        assert abs(int(np.argmax(x[near])) - 15) <= 3


def _period_frames(x: np.ndarray) -> float:
    """The lag of the first maximum of the autocorrelation after its first minimum."""
    v = x - np.polyval(np.polyfit(np.arange(len(x)), x, 1), np.arange(len(x)))
    full = np.correlate(v, v, "full")[len(v) - 1 :]
    low = int(np.argmax(np.diff(full) > 0))
    return float(low + np.argmax(full[low : low + 100]))


@FOLDED.needed
def test_folded_stalk_is_followed_round_its_bend(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found, readings = tracked(capfd, tmp_path, FOLDED, "--points", "arc")
    track = read_track(tmp_path / "t.csv")
    film = cv2.VideoCapture(str(FOLDED.path))
    pictures = [film.read()[1] for _ in range(83)]
    points_cm = dict(zip(track.time_s.tolist(), track.points_cm, strict=True))
    on_stem = []
    for i in (10, 14, 20, 24, 37, 40, 44, 48, 52, 56):
        time_s = float(readings[i]["time_s"])
        if time_s not in points_cm:
            on_stem.append(0.0)
            continue
        bright = cv2.dilate((pictures[i][..., 1] > 90).astype(np.uint8), np.ones((5, 5), np.uint8))
        px = [432.0, 264.0] + points_cm[time_s][1:] * [FOLDED.px_per_cm, -FOLDED.px_per_cm]
        on_stem.append(float(np.mean([bright[round(y), round(x)] for x, y in px])))
    bent = [points_cm[float(readings[i]["time_s"])][:, 0] for i in range(20, 37)]
    back_px = [FOLDED.px_per_cm * float(x_cm.max() - x_cm[-1]) for x_cm in bent]
    tell(capfd, f"folded, path: {found['outcomes']} of 83; points on the stalk in ten frames {np.mean(on_stem):.0%}")
    tell(capfd, f"folded, path: in frames 20-36 the end is {min(back_px):.0f} px back from the bend and more")
    assert found["outcomes"]["ok"] >= 60
    assert np.mean(on_stem) > 0.9
    assert min(back_px) > 10.0
