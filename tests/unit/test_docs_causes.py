"""``docs/reference/causes.md``: up to date."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from flora_lab.effects.catalogue import CATALOGUE

ROOT = Path(__file__).parents[2]


def test_the_page_is_what_the_catalogue_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "generate"))
    made = importlib.import_module("causes")
    monkeypatch.delitem(sys.modules, "causes")
    page = (ROOT / "docs" / "reference" / "causes.md").read_text(encoding="utf-8")
    assert page == made.page(), "causes.md is out of date: run `make docs`"
    for effect in CATALOGUE:
        assert f"`{effect.name}`" in page
        assert all(f"`{name}`" in page for name in effect.names)
