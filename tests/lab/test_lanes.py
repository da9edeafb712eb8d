"""How many plants stand side by side is a setting, and makes no difference to any of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from flora_common.errors import BadInput
from flora_lab import compiled_cache
from flora_lab.lanes import CHOICES, VARIABLE, lanes

PROGRAM = Path(__file__).with_name("plants_bits.py")


def run(set_to: str) -> list[str]:
    environment = {**os.environ, VARIABLE: set_to}
    command = [sys.executable, str(PROGRAM)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=True)
    return done.stdout.split()


@pytest.mark.slow  # all is compiled anew
def test_plants_are_the_same_to_the_bit_however_many_stand_side_by_side() -> None:
    own, widest = run(""), run(str(CHOICES[-1]))
    assert int(own[0]) in CHOICES[:-1]
    assert int(widest[0]) == CHOICES[-1]
    assert own[1] == widest[1]


@pytest.mark.parametrize(("features", "expected"), [("+avx2,+avx512f,+fma", 32), ("+avx2,-avx512f", 16), ("", 16)])
def test_processors_have_their_own(monkeypatch: pytest.MonkeyPatch, features: str, expected: int) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert lanes(features) == expected
    monkeypatch.setenv(VARIABLE, "64")
    assert lanes(features) == 64


@pytest.mark.parametrize("set_to", ["12", "wide", "-16", "16.0"])
def test_what_is_no_choice_is_refused(monkeypatch: pytest.MonkeyPatch, set_to: str) -> None:
    monkeypatch.setenv(VARIABLE, set_to)
    with pytest.raises(BadInput, match=rf"^FLORA_LANES is '{set_to}'; set it to one of 16, 32, 64, or not at all$"):
        lanes("+avx2")


def test_code_compiled_for_other_lanes_is_kept_apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "source.py").write_text("from numba import njit\n")
    folders = []
    monkeypatch.setenv("ANOTHER_FOLDER", "")  # so that it is taken back after the test
    monkeypatch.setattr(compiled_cache, "VARIABLE", "ANOTHER_FOLDER")  # numba's own stays as it is
    monkeypatch.setattr(compiled_cache.sys, "modules", {})
    for set_to in ("", "16", "", "64"):
        monkeypatch.setenv(VARIABLE, set_to)
        compiled_cache.use_cache_of(tmp_path)
        folders.append(Path(os.environ["ANOTHER_FOLDER"]))
    assert folders[0] == folders[2]
    assert len(set(folders)) == 3
    assert all(folder.is_dir() for folder in folders)
