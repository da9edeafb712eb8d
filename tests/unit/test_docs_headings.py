"""A link to a heading leads to that heading; that pages are there at all, ``tests/test_repo_shape.py`` looks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "services").glob("*/README.md"))]


def anchors(page: Path) -> set[str]:
    """The headings as links name them: small letters, without signs, with hyphens for blanks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.+?)\s*$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_heading_that_is_linked_to_is_there(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:\s]*)#([^)\s]+)\)", page.read_text(encoding="utf-8"))
    lost = [f"{file}#{name}" for file, name in links if name not in anchors(page.parent / file if file else page)]
    assert lost == []


def test_headings_are_named_as_links_name_them(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# On a Pi\n```\n# no heading\n```\n## `run.toml`, and more\n### lab.rigs.NAME\n")
    assert anchors(page) == {"on-a-pi", "runtoml-and-more", "labrigsname"}
