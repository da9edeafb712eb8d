"""Counts in words."""

from __future__ import annotations

import pytest

from flora_common.counted import counted


@pytest.mark.parametrize(("count", "said"), [(0, "0 runs"), (1, "1 run"), (2, "2 runs")])
def test_one_of_them_has_no_plural(count: int, said: str) -> None:
    assert counted(count, "run") == said
