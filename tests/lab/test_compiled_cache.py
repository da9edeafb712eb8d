"""Compiled code that is kept is that of the sources as they are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from flora_lab.compiled_cache import VARIABLE, fingerprint, use_cache_of

CALLED = """
from numba import njit
@njit(cache=True)
def called():
    return {value}
"""
CALLING = """
from numba import njit
from sources.called import called
@njit(cache=True)
def calling():
    return called()
"""
PROGRAM = """
import sys
from pathlib import Path
from flora_lab.compiled_cache import use_cache_of
use_cache_of(Path("sources"))
from sources.calling import calling
print(calling(), sum(calling.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "__init__.py").write_text("")
    (tmp_path / "sources" / "calling.py").write_text(CALLING)
    (tmp_path / "sources" / "called.py").write_text(CALLED.format(value=1))
    return tmp_path / "sources"


def started(package: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=package.parent, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_a_function_is_compiled_anew_when_one_that_it_calls_has_changed(package: Path) -> None:
    assert started(package) == "1 0"
    assert started(package) == "1 1"
    (package / "called.py").write_text(CALLED.format(value=2))
    assert started(package) == "2 0"
    assert len(list((package / "__pycache__").glob("numba-*"))) == 1


def test_files_without_compiled_functions_do_not_count(package: Path) -> None:
    before = fingerprint(package)
    (package / "words.py").write_text("TEXT = 'no such thing'\n")
    assert fingerprint(package) == before
    (package / "called.py").write_text(CALLED.format(value=3))
    assert fingerprint(package) != before


def test_files_whose_functions_are_only_put_into_others_count(package: Path) -> None:
    before = fingerprint(package)
    (package / "parts.py").write_text("from elsewhere import inlined\n\n\n@inlined\ndef part():\n    return 1\n")
    assert fingerprint(package) != before


def test_a_folder_that_the_user_has_set_stays(package: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "mine"))
    use_cache_of(package)
    assert os.environ[VARIABLE] == str(tmp_path / "mine")
    assert not (package / "__pycache__").exists()


def test_a_folder_that_was_inherited_is_replaced(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "somewhere/numba-0123456789abcdef")
    numba = sys.modules.get("numba")
    before = None if numba is None else numba.config.CACHE_DIR
    use_cache_of(package)
    assert Path(os.environ[VARIABLE]).name == f"numba-{fingerprint(package)}"
    if numba is not None:
        numba.config.CACHE_DIR = before
