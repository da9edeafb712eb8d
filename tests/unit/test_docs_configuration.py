"""``docs/reference/configuration.md``: up to date, whole, and what the commands themselves say."""

from __future__ import annotations

import importlib
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import msgspec
import pytest

from flora_common.config import SECTIONS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "configuration.md"
SERVICES = ("bus", "flash", "capture", "stem", "controller", "led", "uploader", "recorder", "dashboard")


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "generate"))
    module = importlib.import_module("configuration")
    monkeypatch.delitem(sys.modules, "configuration")
    return module


def test_the_page_is_what_the_structs_say(made: ModuleType) -> None:
    assert PAGE.read_text(encoding="utf-8") == made.page(), f"{PAGE} is out of date: run `make docs`"


def test_every_section_that_a_file_may_have_is_there(made: ModuleType) -> None:
    assert [line[3:] for line in made.page().splitlines() if line.startswith("## ")] == list(SECTIONS)
    assert set(SECTIONS) == set(made.STRUCTS)


@pytest.mark.parametrize("section", [*SERVICES, "lab"])
def test_keys_and_defaults_are_those_that_the_command_prints(
    made: ModuleType, section: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flora.toml"
    file.write_text("")
    package = "flora_lab.serve.service" if section == "lab" else f"flora_{section}.main"
    assert importlib.import_module(package).main(["--config", str(file), "--print-config"]) == 0
    printed = tomllib.loads(capsys.readouterr().out)
    for name in ("rig", section):
        for table, struct in made.tables(name, made.STRUCTS[name]):
            if table.endswith(".NAME"):
                continue
            of: Any = printed
            for part in table.split("."):
                of = of[part]
            told = {row.name: row.default for row in made.rows(struct) if row.default != "none"}
            assert told == {key: made.default_of(value) for key, value in of.items() if not isinstance(value, dict)}


def test_a_key_without_a_meaning_is_refused(made: ModuleType) -> None:
    class Silent(msgspec.Struct):
        """``[silent]``."""

        line: int = 17

    with pytest.raises(LookupError, match=r"Silent\.line: write below it what it means"):
        made.rows(Silent)


def test_a_number_without_bounds_is_refused(made: ModuleType) -> None:
    with pytest.raises(LookupError, match="a number without bounds"):
        made.kind_of({"type": "integer", "minimum": 0})


def test_what_is_written_of_a_key_is_found_wherever_it_stands(made: ModuleType) -> None:
    class Loud(msgspec.Struct):
        """``[loud]`` and ``[very.loud]``: for the test
        of this. More.

        Attributes:
            listed_a, listed_b: in the docstring,
                on two lines.
        """

        listed_a: bool = True
        listed_b: Annotated[float, msgspec.Meta(gt=0.0, lt=1e4)] = 0.5
        below: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 3
        """Below ``it``."""
        told: Annotated[str, msgspec.Meta(description="with the type", pattern=r"^a|b$(?!\n)")] = ""
        maybe: tuple[bool, ...] | None = None
        """Or nothing."""

    found = [(row.name, row.kind, row.default, row.meaning) for row in made.rows(Loud)]
    assert found == [
        ("listed_a", "`true`, `false`", "`true`", "In the docstring, on two lines"),
        ("listed_b", "number above 0 below 10,000", "`0.5`", "In the docstring, on two lines"),
        ("below", "whole number 1 to 1,000", "`3`", "Below `it`"),
        ("told", "text `^a|b$`", '`""`', "With the type"),
        ("maybe", "list of `true`, `false`", "none", "Or nothing"),
    ]
    assert made.purpose(Loud) == "For the test of this. More."
