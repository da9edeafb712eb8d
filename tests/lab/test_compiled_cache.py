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


def without_place(package: Path, environment: dict[str, str]) -> str:
    """Where a program that may write nothing beside its sources keeps what it compiles."""
    (package / "__pycache__").write_text("no folder can be made here")
    cleared = {name: value for name, value in os.environ.items() if name != VARIABLE}
    program = PROGRAM + "import os; print(os.environ['NUMBA_CACHE_DIR'])\n"
    done = subprocess.run(
        [sys.executable, "-B", "-c", program],
        cwd=package.parent,
        env={**cleared, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    answer, folder = done.stdout.split("\n")[:2]
    assert answer.startswith("1 ")
    return folder


def test_sources_that_cannot_be_written_beside_are_compiled_into_the_users_cache(package: Path, tmp_path: Path) -> None:
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": ""}
    folder = without_place(package, home)
    assert Path(folder).parent == tmp_path / ".cache" / "flora"
    assert any(Path(folder).rglob("*.nbi"))


def test_without_any_place_there_is_a_temporary_one_that_goes_with_the_process(package: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    folder = without_place(package, {"XDG_CACHE_HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)})
    assert Path(folder).parent == tmp_path
    assert not Path(folder).exists()


def test_a_process_that_was_started_with_a_folder_of_the_same_sources_uses_it(
    package: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given = str(tmp_path / f"numba-{fingerprint(package)}-abc")
    monkeypatch.setenv(VARIABLE, given)
    use_cache_of(package)
    assert os.environ[VARIABLE] == given
    (package / "called.py").write_text(CALLED.format(value=5))
    use_cache_of(package)
    assert os.environ[VARIABLE] != given
