"""Numbers that people give as options: refused where none can mean them, by the option's own name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec
import typer

from flora_common.errors import BadInput
from flora_common.toml_strict import number_given

LEAST_S: Final = 0.001
"""Tables tell times in milliseconds."""
LONGEST_STEP_S: Final = 86_400.0
"""Between two photographs, as in run.toml."""


def within(least: float, most: float) -> Callable[[typer.CallbackParam, float | None], float | None]:
    """The callback of an option that takes a number from ``least`` to ``most``, both included; NaN is none."""

    def check(option: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None and not least <= value <= most:
            raise BadInput(f"{option.opts[0]}: {value:g} does not lie in [{least:g}, {most:g}]")
        return value

    return check


def must_not(option: str, given: object, why: str) -> None:
    """Refuse an option that changes nothing: who gives it believes that it does.

    Args:
        option: by its name.
        given: its value; None or False where it was not given.
        why: it has no effect.

    Raises:
        BadInput: it was given.
    """
    if given is not None and given is not False:
        raise BadInput(f"{option}: has no effect, {why}; leave it out")


def refusal(
    problem: msgspec.ValidationError, given: dict[str, Any], options: Mapping[str, str], otherwise: str
) -> BadInput:
    """What is wrong with options that are checked as a struct, told by the option.

    Args:
        problem: of the conversion.
        given: what was converted; the message says which number of it was refused.
        options: by the name of the field, with the names of its tables before it: ``noise.theta_3``.
        otherwise: for a field that is not named there.
    """
    text, _, place = str(problem).partition(" - at `$")
    path = place.strip("`").removeprefix(".")
    field = re.sub(r"\[.*", "", path)
    words = re.sub(r"`(float|int)`", "a number", f"{text[0].lower()}{text[1:]}")
    return BadInput(f"{options.get(field, otherwise)}: {words}{number_given(given, path)}")
