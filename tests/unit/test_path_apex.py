"""Where an apex has moved: pictures of which that is known."""

from __future__ import annotations

import math

import cv2
import msgspec
import numpy as np
import pytest

from flora_common.arrays import FloatArray
from flora_common.vision.path import apex, nearby
from flora_common.vision.path.apex import Apex, Followed, apex_at, drawn_to
from flora_common.vision.path.evidence import Evidence

SCALE = 18.4
START = np.array([130.3, 118.7])
ONE_MM = SCALE / 10.0
MEASURED_VAR = (apex.MEASURED_ERROR_CM * SCALE) ** 2


def leaves(seed: int = 1) -> np.ndarray:
    """Soft-edged ellipses of one colour over each other, about the middle of a dark picture."""
    rng = np.random.default_rng(seed)
    picture = np.full((240, 260, 3), 40, np.uint8)
    for _ in range(30):
        centre = (START + rng.normal(0.0, 12.0, 2)).astype(int).tolist()
        colour = rng.integers(60, 200, 3).tolist()
        cv2.ellipse(picture, centre, (9, 4), float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(picture, (0, 0), 1.2)


def moved(picture: np.ndarray, by: FloatArray, turn_deg: float = 0.0) -> np.ndarray:
    """The picture turned about its apex and moved, px."""
    matrix = cv2.getRotationMatrix2D(START.tolist(), turn_deg, 1.0)
    matrix[:, 2] += by
    return cv2.warpAffine(picture, matrix, picture.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def evidence(picture: np.ndarray, origin: tuple[int, int] = (0, 0)) -> Evidence:
    plant = np.where(picture.max(axis=2) > 44, 20.0, 0.0).astype(np.float32)
    return Evidence(origin, plant, picture, 1.0)


def known(picture: np.ndarray, sure: int = apex.KNOWN_FROM) -> Apex:
    found = apex_at(evidence(picture), 0.0, START, MEASURED_VAR, SCALE)
    assert found is not None
    return msgspec.structs.replace(found, sure=sure)


@pytest.mark.parametrize("seed", range(8))
def test_motion_is_found_to_a_tenth_of_a_pixel_wherever_the_part_that_is_looked_at_begins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    by = rng.uniform(-14.0, 14.0, 2)
    later = moved(leaves(seed), by)
    there = Followed(known(leaves(seed)), evidence(later[30:, 20:], (20, 30)), 300.0, SCALE).there
    assert there is not None
    assert there - START == pytest.approx(by, abs=0.1)


def test_other_light_in_each_channel_is_no_motion() -> None:
    by = np.array([2.4, -1.3])
    later = moved(leaves(), by)
    lit = np.clip(later * np.array([0.8, 1.1, 0.9]) + np.array([12.0, -5.0, 20.0]), 0, 255).astype(np.uint8)
    there = Followed(known(leaves()), evidence(lit), 300.0, SCALE).there
    assert there is not None
    assert there - START == pytest.approx(by, abs=0.1)


def test_an_apex_that_turns_by_some_degrees_is_still_found_near_its_place() -> None:
    there = Followed(known(leaves()), evidence(moved(leaves(), np.array([6.0, 1.0]), 6.0)), 300.0, SCALE).there
    assert there is not None
    assert there - START == pytest.approx([6.0, 1.0], abs=0.6)


@pytest.mark.parametrize(
    ("later", "time_s"),
    [
        (leaves(7), 300.0),
        (np.full((240, 260, 3), 40, np.uint8), 300.0),
        (moved(leaves(), np.array([60.0, 0.0])), 300.0),
        (leaves(), nearby.LONGEST_S + 1.0),
        (leaves(), -1.0),
    ],
    ids=["another apex", "nothing", "too far", "too late", "too early"],
)
def test_what_cannot_be_told_is_not(later: np.ndarray, time_s: float) -> None:
    followed = Followed(known(leaves()), evidence(later), time_s, SCALE)
    line = np.column_stack([np.full(100, 130.0), np.linspace(220.0, 120.0, 100)])
    assert followed.there is None
    assert not followed.is_astray(line[-1])
    assert followed.drawn(line) is line
    assert followed.believed(line)[0] is line


def test_a_bare_edge_tells_nothing_of_the_motion_along_it() -> None:
    edge = np.full((240, 260, 3), 40, np.uint8)
    edge[:, 131:] = 160
    assert apex.found_again(known(edge), evidence(edge), SCALE) is None


def test_measurements_that_scatter_are_evened_and_motion_is_followed_at_once() -> None:
    rng = np.random.default_rng(3)
    state, errors = known(leaves(), 1), []
    for i in range(1, 60):
        by = np.array([10.0 * math.sin(0.3 * i), -0.2 * i])
        measured = START + by + rng.normal(0.0, ONE_MM, 2)
        line = np.linspace(START + np.array([0.0, 100.0]), measured, 120)
        believed, after = Followed(state, evidence(moved(leaves(), by)), 300.0 * i, SCALE).believed(line)
        assert after is not None
        assert after.tip_px == pytest.approx(tuple(believed[-1]))
        state = after
        errors.append(believed[-1] - START - by)
    steps = np.diff(np.array(errors)[8:], axis=0)
    assert np.sqrt((steps**2).sum(axis=1).mean()) < 0.3 * ONE_MM
    assert np.hypot(*np.array(errors)[8:].T).mean() < 0.6 * ONE_MM


def test_a_tip_that_lies_elsewhere_moves_nothing_where_the_apex_is_known_and_is_the_apex_where_it_is_not() -> None:
    elsewhere = START + np.array([40.0, 10.0])
    line = np.linspace(START + np.array([0.0, 100.0]), elsewhere, 120)
    sure = Followed(known(leaves()), evidence(leaves()), 300.0, SCALE)
    assert sure.is_astray(elsewhere)
    out, after = sure.believed(line)
    assert out is line
    assert after is not None
    assert after.tip_px == pytest.approx(tuple(START), abs=0.05)
    new = Followed(known(leaves(), apex.KNOWN_FROM - 1), evidence(leaves()), 300.0, SCALE)
    assert not new.is_astray(elsewhere)
    out, after = new.believed(line)
    assert out is line
    assert after is not None
    assert after.tip_px == tuple(elsewhere)


def test_an_apex_becomes_known_by_pictures_beyond_doubt_and_doubtful_ones_undo_them_one_by_one() -> None:
    state = known(leaves(), 0)
    assert Followed(state, evidence(leaves()), 300.0, SCALE).there is None
    for _ in range(apex.KNOWN_FROM):
        assert not Followed(state, evidence(leaves()), 300.0, SCALE).is_known
        state = apex.judged(state, is_sure=True)
    assert Followed(state, evidence(leaves()), 300.0, SCALE).is_known
    assert not Followed(apex.judged(state, is_sure=False), evidence(leaves()), 300.0, SCALE).is_known
    assert apex.judged(known(leaves(), 0), is_sure=False).sure == 0
    assert apex.judged(known(leaves(), apex.MOST_SURE), is_sure=True).sure == apex.MOST_SURE


def test_an_apex_at_the_edge_of_what_was_looked_at_is_not_remembered() -> None:
    assert apex_at(evidence(leaves()), 0.0, np.array([8.0, 100.0]), 1.0, SCALE) is None


def test_a_line_is_bent_to_another_end_by_its_last_section_alone() -> None:
    line = np.column_stack([np.zeros(201), -np.arange(201.0)])
    out = drawn_to(line, np.array([4.0, -198.0]), 50.0)
    assert (out[:151] == line[:151]).all()
    assert out[-1] == pytest.approx([4.0, -198.0])
    assert (np.diff(out[:, 0]) >= 0.0).all()


def test_what_was_stored_comes_back_and_what_is_damaged_is_refused() -> None:
    whole = known(leaves())
    assert msgspec.json.decode(msgspec.json.encode(whole), type=Apex) == whole
    stored = msgspec.to_builtins(whole)
    for broken in (
        {"tip_px": (0.0, 0.0)},
        {"side": whole.side + 2},
        {"code": stored["code"][:-4]},
        {"corner_px": (0, 0)},
    ):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({**stored, **broken}, Apex)


def test_a_piece_that_was_kept_at_another_scale_tells_nothing() -> None:
    assert apex.found_again(known(leaves()), evidence(leaves()), 3.0 * SCALE) is None


def test_a_measured_tip_counts_more_the_longer_ago_the_apex_was_seen() -> None:
    """A stem grows out of the leaves that its apex is known by: what is measured is the newer word."""
    still, line = evidence(leaves()), np.array([[START[0], START[1] + k] for k in range(120, 0, -1)])
    measured = START - [0.0, 2.0 * ONE_MM]
    ends = []
    for time_s in (300.0, 900.0):
        told, _ = Followed(known(leaves()), still, time_s, SCALE).believed(np.concatenate([line, measured[None]]))
        ends.append(float(START[1] - told[-1, 1]) / ONE_MM)
    assert 0.0 < ends[0] < ends[1] < 2.0
