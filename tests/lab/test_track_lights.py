"""Which lamp shone, by word, by spans, and by the picture."""

from __future__ import annotations

import numpy as np
import pytest

from flora_common.errors import BadInput
from flora_lab.lights import ToldRule, light_in_picture, parse_rule, where_lamps_alternate

BLACK = np.zeros((60, 100, 3), dtype=np.uint8)


def lit(*columns: slice, rows: int = 10) -> np.ndarray:
    picture = BLACK.copy()
    for c in columns:
        picture[:rows, c] = 255
    return picture


def told(text: str) -> ToldRule:
    rule = parse_rule(text)
    assert isinstance(rule, ToldRule)
    return rule


def test_word_holds_for_every_frame() -> None:
    for light in ("left", "right", "dark", "both"):
        assert {told(light)(i) for i in range(3)} == {light}


def test_words_that_need_the_pictures_stay_words() -> None:
    assert (parse_rule("auto"), parse_rule("picture")) == ("auto", "picture")


def test_spans_hold_their_ends() -> None:
    rule = told("left:0-46, right:47-93")
    assert [rule(i) for i in (0, 46, 47, 93)] == ["left", "left", "right", "right"]
    with pytest.raises(BadInput, match="no span holds frame 94"):
        rule(94)


def test_lamps_are_believed_where_both_are_seen_to_shine() -> None:
    alike = dict(enumerate([0, 0, 0, 1, 1, 1]))
    seen = dict(enumerate(["left", "left", "both", "right", "right", "dark"]))
    assert where_lamps_alternate(seen, alike) == dict(enumerate(["left"] * 3 + ["right"] * 3))


def test_a_bright_thing_on_one_side_is_no_lamp() -> None:
    alike = dict(enumerate([0, 0, 0, 0, 1, 1]))
    seen = dict(enumerate(["right", "right", "left", "right", "dark", "dark"]))
    assert set(where_lamps_alternate(seen, alike).values()) == {"dark"}
    assert where_lamps_alternate({}, {}) == {}


@pytest.mark.parametrize(
    "text", ["left:5-3", "left:0-10,right:10-20", "left:a-b", "lfet:0-3", "nonsense", "", "left:0-5,", "left:-1-5"]
)
def test_nonsense_is_told(text: str) -> None:
    with pytest.raises(BadInput, match="--light-from"):
        parse_rule(text)


def test_brighter_half_tells_the_lamp() -> None:
    assert light_in_picture(BLACK) == "dark"
    assert light_in_picture(lit(slice(0, 10))) == "left"
    assert light_in_picture(lit(slice(90, 100))) == "right"
    assert light_in_picture(lit(slice(0, 10), slice(90, 100))) == "both"
    assert light_in_picture(lit(slice(0, 10), slice(97, 100))) == "left"
    assert light_in_picture(lit(slice(0, 1), rows=1)) == "dark"
    assert light_in_picture(np.full((4, 1, 3), 255, np.uint8)) in ("both", "left", "right")
