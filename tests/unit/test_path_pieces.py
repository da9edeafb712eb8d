"""From evidence of plant to a stem's line: thin pieces, the chain of them, its middle, and its end."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.geometry import arc_length, distance_to_polyline_cm
from flora_common.runs import CameraSection
from flora_common.vision.path import curve
from flora_common.vision.path.chain import Before, best_chain
from flora_common.vision.path.curve import Stem
from flora_common.vision.path.evidence import Evidence
from flora_common.vision.path.sampler import Sampler
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.strands import Strands, find_strands
from flora_common.vision.path.tip import find_tip

WIDTH, HEIGHT = 300, 360
SCALE = 20.0
ANCHOR = (150.0, 350.0)
CAMERA = CameraSection(anchor_px=ANCHOR, px_per_cm=SCALE, width_px=WIDTH, height_px=HEIGHT)
SETTINGS = PathSettings()
WIDEST_PX = SETTINGS.widest_stem_cm * SCALE
LEVEL = 80.0


def tube(line: FloatArray, width: float, *, level: float = LEVEL) -> np.ndarray:
    """Evidence of a band round a line, its edges anti-aliased: shape (HEIGHT, WIDTH)."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    places = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    low, high = line.min(axis=0) - width, line.max(axis=0) + width
    near = ((places >= low) & (places <= high)).all(axis=1)
    cover = np.zeros(len(places))
    cover[near] = np.clip(0.5 * width + 0.5 - distance_to_polyline_cm(places[near], line), 0.0, 1.0)
    return level * cover.reshape(HEIGHT, WIDTH)


def ellipse(centre: tuple[int, int], axes: tuple[int, int], angle: float = 0.0, level: float = LEVEL) -> np.ndarray:
    out = np.zeros((HEIGHT, WIDTH), np.float32)
    cv2.ellipse(out, centre, axes, angle, 0, 360, level, -1, cv2.LINE_AA)
    return out


def evidence_of(*parts: np.ndarray, tone: np.ndarray | None = None) -> Evidence:
    """What the parts together look like; as bright as they are clear, unless told."""
    plant = np.maximum.reduce([np.asarray(p, np.float32) for p in parts])
    bright = (90.0 + plant if tone is None else tone).astype(np.uint8)
    code = np.repeat(bright[:, :, None], 3, axis=2)
    return Evidence((0, 0), plant.astype(np.float32), code, 1.0)


def strands_of(evidence: Evidence) -> Strands:
    return find_strands(evidence, widest_px=WIDEST_PX, foot_px=ANCHOR)


def stem_of(evidence: Evidence, before: Before | None = None) -> Stem:
    chain = best_chain(strands_of(evidence), CAMERA, SETTINGS, before)
    assert chain is not None
    return curve.along_chain(chain, Sampler(evidence), SCALE)


def straight(degrees: float, length_px: float = 240.0, foot: tuple[float, float] = ANCHOR) -> FloatArray:
    """A line from the foot, so many degrees to the right of upright."""
    turn = math.radians(degrees)
    s = np.linspace(0.0, length_px, 120)
    return np.array(foot) + s[:, None] * np.array([math.sin(turn), -math.cos(turn)])


def test_a_leaf_is_no_strand_and_the_stem_below_it_is() -> None:
    stem = straight(0.0, 200.0)
    found = strands_of(evidence_of(tube(stem, 5.0), ellipse((150, 120), (45, 30))))
    assert found.leaf[120, 150] == 1
    assert found.leaf[300, 150] == 0
    assert found.leaf.sum() > 0.8 * math.pi * 45 * 30
    longest = max(found.pieces, key=lambda piece: piece.length)
    assert longest.length > 150
    assert np.abs(longest.points[:, 0] - 150.0).max() < 3.0
    assert np.median(longest.width) == pytest.approx(5.0, abs=1.0)


def test_a_line_is_cut_at_its_sharp_corner_and_not_in_a_gentle_bend() -> None:
    corner = np.array([[150.0, 350.0], [150.0, 200.0], [270.0, 190.0]])
    cut = [p for p in strands_of(evidence_of(tube(corner, 5.0))).pieces if p.length > 40]
    assert len(cut) == 2
    t = np.linspace(0.0, 0.5 * math.pi, 80)
    gentle = np.column_stack([150 + 110 * (1 - np.cos(t)), 350 - 160 * np.sin(t)])
    assert len([p for p in strands_of(evidence_of(tube(gentle, 5.0))).pieces if p.length > 40]) == 1


def test_the_stem_is_preferred_to_a_petiole() -> None:
    stem = straight(4.0, 270.0)
    fork = stem[60]
    petiole = fork + np.linspace(0, 90, 40)[:, None] * np.array([0.85, -0.53])
    leaf = ellipse((round(petiole[-1, 0]) + 18, round(petiole[-1, 1]) - 14), (30, 20), -30)
    chain = best_chain(strands_of(evidence_of(tube(stem, 5.0), tube(petiole, 3.0), leaf)), CAMERA, SETTINGS)
    assert chain is not None
    assert math.dist(chain.points[-1], stem[-1]) < 8.0
    assert chain.worth_cm > chain.rival_cm + 1.0


def test_a_gap_behind_a_leaf_is_bridged_but_not_one_over_the_bare_board() -> None:
    stem = straight(0.0, 290.0)
    lower, upper = stem[:40], stem[75:]
    hidden = evidence_of(tube(lower, 5.0), tube(upper, 5.0), ellipse((150, 210), (55, 44)))
    chain = best_chain(strands_of(hidden), CAMERA, SETTINGS)
    assert chain is not None
    assert math.dist(chain.points[-1], stem[-1]) < 8.0
    bare = evidence_of(tube(lower, 5.0), tube(upper, 5.0))
    chain = best_chain(strands_of(bare), CAMERA, SETTINGS)
    assert chain is not None
    assert math.dist(chain.points[-1], lower[-1]) < 8.0


def test_no_chain_begins_far_from_the_anchor() -> None:
    far = straight(0.0, 150.0, foot=(40.0, 180.0))
    assert best_chain(strands_of(evidence_of(tube(far, 5.0))), CAMERA, SETTINGS) is None


def test_where_the_stem_was_decides_between_two_alike() -> None:
    left, right = straight(-14.0, 250.0), straight(14.0, 250.0)
    both = strands_of(evidence_of(tube(left, 5.0), tube(right, 5.0)))
    for line in (left, right):
        chain = best_chain(both, CAMERA, SETTINGS, Before(line))
        assert chain is not None
        assert math.dist(chain.points[-1], line[-1]) < 8.0


@pytest.mark.parametrize("degrees", [-41.3, -17.0, 0.0, 3.3, 26.6, 44.0])
def test_the_middle_of_a_stem_is_found_to_a_fraction_of_a_pixel(degrees: float) -> None:
    line = straight(degrees, 190.0, foot=(150.37, 350.0))
    stem = stem_of(evidence_of(tube(line, 5.2)))
    inner = stem.line[(arc_length(stem.line) > 25) & (arc_length(stem.line) < 165)]
    off = distance_to_polyline_cm(inner, line)
    assert off.mean() < 0.15
    assert stem.clean.mean() > 0.85
    assert np.median(stem.width) == pytest.approx(5.2, abs=0.8)


def test_a_leaf_at_one_side_does_not_pull_the_line() -> None:
    line = straight(0.0, 250.0)
    leaf = ellipse((150 + 24, 220), (24, 15))
    stem = stem_of(evidence_of(tube(line, 5.0), leaf))
    beside = stem.line[np.abs(stem.line[:, 1] - 220) < 30]
    assert np.abs(beside[:, 0] - 150.0).max() < 0.6


@pytest.mark.parametrize(("degrees", "end"), [(0.0, 203.0), (12.0, 188.4), (-33.0, 201.7)])
def test_an_open_end_is_found_to_less_than_a_pixel(degrees: float, end: float) -> None:
    line = straight(degrees, end)
    evidence = evidence_of(tube(line, 5.0))
    tip = find_tip(stem_of(evidence), Sampler(evidence), SCALE)
    ahead = np.array([math.sin(math.radians(degrees)), -math.cos(math.radians(degrees))])
    across = np.array([-ahead[1], ahead[0]])
    # the band is round at its end and reaches half a width further
    along = float((tip.places[-1] - line[-1]) @ ahead)
    assert tip.open_end
    assert along == pytest.approx(2.5, abs=0.9)
    assert abs(float((tip.places[-1] - line[-1]) @ across)) < 1.5
    assert tip.error_px < 2.0


def test_under_a_bud_the_stem_goes_straight_on() -> None:
    line = straight(0.0, 200.0)
    evidence = evidence_of(tube(line, 5.0), ellipse((150, 142), (11, 14)), tone=np.full((HEIGHT, WIDTH), 120.0))
    tip = find_tip(stem_of(evidence), Sampler(evidence), SCALE)
    assert np.abs(tip.places[:, 0] - 150.0).max() < 2.5
    assert tip.places[-1, 1] < 160.0
    assert len(tip.onwards) > 5


def test_among_young_leaves_the_tip_of_a_stem_that_was_followed_changes_less_from_picture_to_picture() -> None:
    line, rng = straight(0.0, 200.0), np.random.default_rng(5)
    leaves = [ellipse((150 + 8 * k, 140), (8, 26), 14.0 * k) for k in (-1, 1)]
    # where the stem was counts for nothing: only how its end is chosen differs
    before, alone, followed = Before(line, 0.0), [], []
    for _ in range(30):
        noise = cv2.GaussianBlur(rng.normal(0.0, 120.0, (HEIGHT, WIDTH)), (0, 0), 2.0)
        evidence = evidence_of(tube(line, 5.0), *leaves, tone=np.clip(120.0 + noise, 0, 255))
        stem, sampler = stem_of(evidence_of(tube(line, 5.0))), Sampler(evidence)
        for ends, given in ((alone, None), (followed, before)):
            ends.append(find_tip(stem, sampler, SCALE, given).places[-1])
    assert np.std(followed, axis=0).max() < 0.4 * np.std(alone, axis=0).max()
    assert np.abs(np.mean(followed, axis=0)[0] - 150.0) < 1.5
