"""``flora-lab track`` on photographs of real plants, and the figures that the how-to page quotes (run with ``-s``)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from flora_common.runs import CameraSection
from flora_common.tracks import read_track
from flora_common.vision.paper import PaperSettings, PaperTracker
from flora_lab import sources
from flora_lab.lights import parse_rule
from flora_lab.main import main
from flora_lab.track import learning
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Span
from real_photographs import BEAN, FOLDED, STALK, independent_apex_px

PAPER = ["--method", "paper"]
BEAN_PLACE = ["--anchor", "361,335", "--px-per-cm", "20", "--light-from", "left:0-46,right:47-93"]
BEAN_WINDOW = ["--window", "300,200,420,335"]


def summary_of(capfd: pytest.CaptureFixture[str], out: Path, *arguments: str) -> dict:
    assert main(["track", *arguments, "-o", str(out), "--json"]) == 0
    return json.loads(capfd.readouterr().out)


def tell(capfd: pytest.CaptureFixture[str], text: str) -> None:
    with capfd.disabled():
        print(f"\n  {text}", end="")


@BEAN.needed
def test_bean_tip_goes_to_the_lit_side(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    found = summary_of(capfd, tmp_path / "t.csv", str(BEAN.path), *PAPER, *BEAN_PLACE, *BEAN_WINDOW)
    assert (found["frames"], found["outcomes"]) == (94, {"ok": 94})
    assert found["mean_quality"] > 0.98
    x = 361 + read_track(tmp_path / "t.csv").points_cm[:, 9, 0] * 20
    y = 335 - read_track(tmp_path / "t.csv").points_cm[:, 9, 1] * 20
    tell(capfd, f"bean: 94 of 94 ok, tip x {x[0]:.0f} -> {x[40:47].min():.0f} (left) -> {x[-1]:.0f} px (right)")
    tell(capfd, f"bean: step of the tip median {np.median(np.hypot(np.diff(x), np.diff(y))):.1f} px")
    assert x[40:47].mean() < 342  # by eye 336
    assert x[85:].mean() > 360  # by eye 368
    assert y[-1] < y[0] - 15  # it grew


@BEAN.needed
def test_bean_lamps_are_told_from_the_pictures(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, rule in (("alternation", []), ("picture", ["--light-from", "picture"])):
        place = [*PAPER, *BEAN_PLACE[:4], *BEAN_WINDOW, *rule]
        found = summary_of(capfd, tmp_path / f"{name}.csv", str(BEAN.path), *place)
        assert (found["lights"], found["lights_from"]) == ({"left": 47, "right": 47}, name)
        assert read_track(tmp_path / f"{name}.csv").light == ("left",) * 47 + ("right",) * 47


@STALK.needed
@FOLDED.needed
def test_films_without_lamps_are_dark() -> None:
    for film in (STALK.path, FOLDED.path):  # both have something bright on one side
        source = sources.open_source(film)
        found = learning.sort_frames(source, Span(), "auto", Pool(1), path=True)
        assert set(found.lights.values()) == {"dark"}


@BEAN.needed
def test_bean_without_window_or_at_an_eighth_is_lost(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    good = read_tip(tmp_path / "good.csv", capfd, *BEAN_WINDOW)
    whole = read_tip(tmp_path / "whole.csv", capfd)
    eighth = read_tip(tmp_path / "eighth.csv", capfd, *BEAN_WINDOW, "--reduction", "8")
    off = np.hypot(*(whole - good).T) * 20
    rms = float(np.sqrt((np.hypot(*(eighth - good).T) ** 2).mean()) * 20)
    tell(capfd, f"bean, whole picture: tip more than 20 px away in {np.mean(off > 20):.0%} of frames")
    tell(capfd, f"bean, 1/8: tip RMS {rms:.1f} px from that at full size")
    assert np.mean(off > 20) > 0.3
    assert rms > 3.0


def read_tip(out: Path, capfd: pytest.CaptureFixture[str], *options: str) -> np.ndarray:
    found = summary_of(capfd, out, str(BEAN.path), *PAPER, *BEAN_PLACE, *options)
    tell(capfd, f"bean {' '.join(options) or '(no window)'}: {found['outcomes']}, quality {found['mean_quality']:.2f}")
    return read_track(out).points_cm[:, 9]


@STALK.needed
def test_stalk_agrees_with_the_independent_apex_track(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    place = ["--anchor", "123,170", "--px-per-cm", "24", "--interval-s", "120"]
    found = summary_of(capfd, tmp_path / "t.csv", str(STALK.path), *PAPER, *place, "--window", "0,0,230,115")
    assert (found["frames"], found["readings"]) == (296, 296)
    points = read_track(tmp_path / "t.csv").points_cm
    x, y = 123 + points[:, 9, 0] * 24, 170 - points[:, 9, 1] * 24
    apex_x, apex_y = independent_apex_px().T
    rms = float(np.sqrt(np.mean((x - apex_x) ** 2 + (y - apex_y) ** 2)))
    bias = (float(np.mean(x - apex_x)), float(np.mean(y - apex_y)))
    left = float(np.sqrt(np.mean((x - apex_x - bias[0]) ** 2 + (y - apex_y - bias[1]) ** 2)))
    r_x, r_y = np.corrcoef(x, apex_x)[0, 1], np.corrcoef(y, apex_y)[0, 1]
    tell(capfd, f"stalk: r_x {r_x:.3f}, r_y {r_y:.3f}; RMS {rms:.1f} px, mean ({bias[0]:+.1f}, {bias[1]:+.1f}) px, ")
    tell(capfd, f"stalk: RMS {left:.1f} px about that mean; the apex moves over {np.ptp(apex_x):.0f} px in x")
    assert r_x > 0.96
    assert r_y > 0.8
    assert left < 10
    for peak in (118, 183, 250):
        near = slice(peak - 15, peak + 16)
        assert abs(int(np.argmax(x[near])) - 15) <= 1


@FOLDED.needed
def test_folded_stalk_is_cut_short_by_the_row_means(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = sources.open_source(FOLDED.path)
    camera = CameraSection((432.0, 264.0), 40.0, *source.size_px)
    settings = PaperSettings(reduction=1, window_px=(450.0, 100.0, 600.0, 264.0))
    span = Span(0, 83)
    frames = learning.sort_frames(source, span, parse_rule("dark"), Pool(1), path=False)
    setup = learning.paper_setup(source, [], settings, frames).setup
    assert isinstance(setup, dict)
    follow = PaperTracker(setup["dark"], camera, settings)
    worst, twice, quality = [], [], []
    for frame in span.take(source.frames()):
        picture = frame.load(1)
        mask, reading = follow.stem_mask(picture), follow.read(picture)
        assert reading.points_cm is not None
        row, column = np.nonzero(mask)
        points = reading.points_cm * [40.0, -40.0] + [432.0, 264.0]
        away = np.hypot(points[1:9, None, 0] - column, points[1:9, None, 1] - row).min(axis=1)
        worst.append(float(away.max()))
        twice.append(any(np.diff(np.flatnonzero(r[:560])).max(initial=0) > 10 for r in mask))
        quality.append(reading.quality)
    fold = slice(20, 33)
    tell(capfd, f"folded, frames 20-32: a row meets the stalk twice in {np.mean(twice[fold]):.0%} of frames;")
    tell(
        capfd, f"folded, frames 20-32: points up to {max(worst[fold]):.1f} px from any stem pixel (stalk 2-3 px wide),"
    )
    tell(capfd, f"folded, frames 20-32: while the quality says {np.mean(quality[fold]):.2f}")
    assert all(twice[fold])
    assert min(worst[fold]) > 4.0
