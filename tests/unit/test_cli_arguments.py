"""Every command that is installed: wrong arguments are told in one line, and the line says where help is."""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

import flora_lab.main
import flora_monitor.main
import flora_twin.main

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TARGETS: dict[str, str] = PROJECT["scripts"]
SUBCOMMANDS = ("flora-stem calibrate", "flora-controller check", "flora-controller offer", "flora-monitor tail")


def main_of(command: str) -> Callable[[list[str]], int]:
    module, _, function = TARGETS[command].partition(":")
    made: Callable[[list[str]], int] = getattr(importlib.import_module(module), function)
    return made


def commands_of(command: Any) -> Iterator[Any]:
    yield command
    for inner in getattr(command, "commands", {}).values():
        yield from commands_of(inner)


@pytest.mark.parametrize("app", [flora_lab.main.build_app(), flora_twin.main.build_app(), flora_monitor.main.app])
def test_a_help_text_holds_no_brackets_which_would_be_taken_for_markup_and_not_shown(app: typer.Typer) -> None:
    options = [option for command in commands_of(typer.main.get_command(app)) for option in command.params]
    assert len(options) > 30
    assert [option.name for option in options if "[" in (getattr(option, "help", None) or "")] == []


@pytest.mark.parametrize("command", [*sorted(TARGETS), *SUBCOMMANDS])
def test_an_option_that_does_not_exist_is_one_line_and_status_2(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *subcommand = command.split()
    assert main_of(name)([*subcommand, "--nonsense"]) == 2
    told = capsys.readouterr()
    assert (told.out, told.err.count("\n")) == ("", 1)
    assert told.err.startswith(f"{name}")
    assert told.err.endswith(f"(see {command} --help)\n")


@pytest.mark.parametrize("interval", ["inf", "nan", "0", "1e9"])
def test_an_interval_that_no_run_has_is_refused(interval: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main_of("flora-monitor")(["rates", "--interval", interval]) == 2
    said = f"flora-monitor: --interval: {float(interval):g} does not lie in [0.001, 86400]\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("arguments", [("flora-lab", "track", ""), ("flora-monitor", "check", "a.mcap", "")])
def test_an_empty_argument_is_not_the_current_folder(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    command, *given = arguments
    assert main_of(command)(given) == 2
    said = f"{command}: an argument is empty, where something must be named (see {command} --help)\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--config"], "flora-bus: argument --config: expected one argument (see flora-bus --help)\n"),
        (["a\nb"], "flora-bus: unrecognized arguments: a b (see flora-bus --help)\n"),
        (
            ["-v", "-q"],
            "flora-bus: argument -q/--quiet: not allowed with argument -v/--verbose (see flora-bus --help)\n",
        ),
    ],
)
def test_what_a_service_cannot_read_is_one_line_whatever_it_is(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main_of("flora-bus")(arguments) == 2
    assert capsys.readouterr().err == said
