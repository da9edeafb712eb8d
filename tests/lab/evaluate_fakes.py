"""``flora-lab evaluate`` with a fake ``flora-twin``: its numbers, its page, its refusals."""

from __future__ import annotations

import html.parser
import json
from pathlib import Path
from typing import Any

import pytest
import twin_fakes

from flora_lab.evaluate import on_twin
from flora_lab.main import main

GOLDEN = Path(__file__).parents[1] / "golden" / "controllers"
TIP_ONLY = GOLDEN / "good" / "tip_only.controller.json"
NEAT_EXPORT = GOLDEN / "good" / "neat_export.controller.json"


def twin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, behaviour: dict[str, str] | None = None) -> Path:
    """The fake `flora-twin` takes the place of the installed one."""
    program = twin_fakes.write_program(tmp_path / "bin", behaviour)
    monkeypatch.setattr(on_twin, "command", lambda name: str(program.parent / name))
    return program


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path, status: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["evaluate", *map(str, arguments), "--json"]) == status
    numbers: dict[str, Any] = json.loads(capsys.readouterr().out)
    return numbers


def only(entries: list[dict[str, Any]], **wanted: object) -> dict[str, Any]:
    (one,) = [entry for entry in entries if all(entry[name] == value for name, value in wanted.items())]
    return one


def check_page(path: Path, *words: str) -> str:
    """It parses, shows these words, and needs nothing from elsewhere."""
    seen: list[str] = []

    class Parser(html.parser.HTMLParser):
        def handle_data(self, data: str) -> None:
            seen.append(data)

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            for name, value in attrs:
                if name in ("src", "href"):
                    assert value is not None
                    assert value.startswith("data:")

    text = path.read_text()
    Parser().feed(text)
    for word in words:
        assert word in " ".join(seen)
    return text


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    capsys.readouterr()
    assert main(["evaluate", *map(str, arguments)]) == 2
    streams = capsys.readouterr()
    assert streams.out == ""
    (line,) = streams.err.strip().splitlines()
    return line
