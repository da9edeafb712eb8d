"""What matplotlib says of its own folder, and what it says otherwise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from flora_lab.quiet_matplotlib import VARIABLE

DRAWING = """
import logging
import flora_lab.figure_style
logging.getLogger("matplotlib").warning("something else")
"""


def said(home: Path, **environment: str) -> str:
    """What a program that draws says on stderr, with this home."""
    ours = {name: value for name, value in os.environ.items() if name != VARIABLE and not name.startswith("XDG_")}
    done = subprocess.run(
        [sys.executable, "-c", DRAWING],
        env={**ours, "HOME": str(home), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    # on a slow machine it also tells that it lists the fonts
    return "".join(line for line in done.stderr.splitlines(keepends=True) if "building the font cache" not in line)


@pytest.fixture
def no_home(tmp_path: Path) -> Path:
    """A home in which nobody can make a folder, root included."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file"


def test_a_home_that_cannot_be_written_is_no_news(no_home: Path) -> None:
    assert said(no_home) == "something else\n"


def test_a_folder_that_was_set_and_cannot_be_written_is_told(no_home: Path) -> None:
    assert f"mkdir -p failed for path {no_home}/mine" in said(no_home, **{VARIABLE: str(no_home / "mine")})
