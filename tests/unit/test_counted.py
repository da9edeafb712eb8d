"""Counts in words."""

from __future__ import annotations

import pytest

from flora_common.counted import counted, listed


@pytest.mark.parametrize(("count", "said"), [(0, "0 runs"), (1, "1 run"), (2, "2 runs")])
def test_one_of_them_has_no_plural(count: int, said: str) -> None:
    assert counted(count, "run") == said


@pytest.mark.parametrize(("names", "said"), [(["a"], "a"), (["a", "b"], "a or b"), (["a", "b", "c"], "a, b or c")])
def test_names_are_listed_as_people_list_them(names: list[str], said: str) -> None:
    assert listed(names, "or") == said
    assert listed(names) == said.replace("or", "and")
