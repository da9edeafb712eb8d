"""TOML into typed, frozen structures: unknown keys, wrong types and numbers out of range are told, with the place."""

from __future__ import annotations

import functools
import re
import tomllib
import types
import typing
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import tomli_w

from flora_common.errors import BadInput
from flora_common.suggest import clipped, did_you_mean, is_slip

T = TypeVar("T", bound=msgspec.Struct)

LARGEST_WHOLE: Final = 2**63 - 1
"""TOML promises whole numbers of 64 bits; larger ones fit neither an array nor a message."""
_MOST_DIGITS: Final = 4300
"""Python reads no whole number that is longer, and says so in words of its own."""


def read_toml(path: Path, error: type[BadInput]) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        error: the file cannot be read or is not TOML, or holds a whole number beyond 64 bits or
            a text with a NUL character; the message names the file, and line and column or the key.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
        table = tomllib.loads(text)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not UTF-8 text (byte {problem.start})") from problem
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise error(f"{path}: not valid TOML: {problem}") from problem
    except ValueError as problem:  # the only one that is no TOMLDecodeError: of whole numbers that are too long
        raise error(f"{path}: a whole number is too large{_long_number_at(text)}") from problem
    for key, value in _values(table):
        if isinstance(value, int) and not -LARGEST_WHOLE <= value <= LARGEST_WHOLE:
            raise error(f"{path}: `{clipped(key)}` is too large, a whole number must lie within ±{LARGEST_WHOLE}")
        if isinstance(value, str) and "\0" in value:
            raise error(f"{path}: `{clipped(key)}` holds a NUL character, which no name or text may; take it out")
    return table


def _long_number_at(text: str) -> str:
    """Where in a file the whole number is that Python does not read; empty where it is not found."""
    found = re.search(rf"\d[\d_]{{{_MOST_DIGITS},}}", text)
    return f" (line {text.count(chr(10), 0, found.start()) + 1})" if found else ""


def _values(table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Every value that is no table or list, with its keys; without recursion, for `a.a.a = 1` nests without end."""
    left: list[tuple[str, Any]] = [("", table)]
    while left:
        place, value = left.pop()
        if isinstance(value, dict):
            # The beginning of a key is enough to find it by, and a thousand long ones within one another stay cheap.
            left.extend((f"{clipped(place)}.{key}" if place else key, inner) for key, inner in value.items())
        elif isinstance(value, list):
            left.extend((place, inner) for inner in value)
        else:
            yield place, value


def convert(
    data: dict[str, Any],
    into: type[T],
    *,
    where: str,
    error: type[BadInput],
    unknown: Callable[[str], None] | None = None,
) -> T:
    """Check a parsed table against a struct type.

    Args:
        data: the table as parsed.
        into: a struct type.
        where: the file, and the section where there is one, for the message.
        error: the error class to raise.
        unknown: is told in a sentence of keys that the type does not name, at any depth; they are not looked at then.
            Without it they are refused, and those that are but slips of the pen always.
    """
    foreign: list[str] | None = None if unknown is None else []
    data = _known(data, into, where, error, foreign)
    if unknown is not None and foreign:
        keys = ", ".join(f"`{key}`" for key in foreign)
        unknown(f"{where}: {keys} {'is' if len(foreign) == 1 else 'are'} unknown, and not looked at")
    try:
        return msgspec.convert(data, into)
    except msgspec.ValidationError as problem:
        text = str(problem)
        at = re.search(r" - at `\$\.?(.*)`$", text)
        message = text[: at.start()] if at else text
        path = at.group(1) if at and at.group(1) else ""
        key = f" `{path}`" if path else ""
        if words := _in_words(into, path, message):
            raise error(f"{where}:{key} must be {words}, it is {clipped(repr(_value_at(data, path)))}") from problem
        hint = _known_values(into, path, message) or number_given(data, path)
        raise error(f"{where}:{key} {message[0].lower()}{clipped(message[1:], 200)}{hint}") from problem


def _known_values(into: type[msgspec.Struct], path: str, message: str) -> str:
    """For a word that is not one of the allowed ones: which they are, the nearest first."""
    wrong = re.match(r"Invalid enum value '(.*)'$", message)
    if wrong is None:
        return ""
    kind = _type_at(into, path)
    literals = [part for part in (kind, *typing.get_args(kind)) if typing.get_origin(part) is typing.Literal]
    return did_you_mean(wrong.group(1), [str(v) for part in literals for v in typing.get_args(part)])


def _in_words(into: type[msgspec.Struct], path: str, message: str) -> str:
    """For a text that is not of the form asked for: what its type's ``Meta(extra={"words": ...})`` says of the form."""
    if not message.startswith("Expected `str` matching regex"):
        return ""
    kind = _type_at(into, path)
    metas = (part for part in typing.get_args(kind) if isinstance(part, msgspec.Meta))
    return next((str(meta.extra["words"]) for meta in metas if meta.extra and "words" in meta.extra), "")


def _type_at(into: type[msgspec.Struct], path: str) -> Any:
    """The annotation of the field at a place such as ``noise.omega``; None where there is none."""
    kind: Any = into
    for name in re.sub(r"\[[^\]]*\]", "", path).split("."):
        owner = _struct_in(kind)
        found = [field.type for field in msgspec.structs.fields(owner) if field.encode_name == name] if owner else []
        if not found:
            return None
        kind = found[0]
    return kind


def number_given(data: dict[str, Any], path: str) -> str:
    """A clause with the number that was refused: ``nan`` is not seen to be out of a range.

    Args:
        data: the table that was checked.
        path: of the number in it: ``noise.omega``, ``window_px[3]``.

    Returns:
        ``, it is nan``; empty where there is no number at that place.
    """
    value = _value_at(data, path)
    if not isinstance(value, int | float) or isinstance(value, bool):
        return ""
    try:
        return f", it is {value:g}"
    except OverflowError:  # a whole number that no float holds; its hundreds of digits would help nobody
        return ""


def _value_at(data: dict[str, Any], path: str) -> Any:
    value: Any = data
    for name in re.findall(r"[^.\[\]]+", path):
        try:
            value = value[int(name) if isinstance(value, list) else name]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return value


def to_toml(value: msgspec.Struct) -> str:
    """A struct as TOML text, fields that are None left out (TOML has no null)."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(value, builtin_types=(datetime,))))


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {k: _without_none(v) if isinstance(v, dict) else v for k, v in table.items() if v is not None}


def _known(
    data: dict[str, Any],
    into: type[msgspec.Struct],
    where: str,
    error: type[BadInput],
    foreign: list[str] | None,
    above: str = "",
) -> dict[str, Any]:
    """A table without the keys that are no fields of a struct type; their dotted names are added to ``foreign``.

    Raises:
        error: such a key, where there is no ``foreign``, or all but the name of a field.
    """
    structs = _structs_of(into)
    known: dict[str, Any] = {}
    for key, value in data.items():
        if key not in structs:
            if foreign is None or is_slip(key, structs):
                raise error(f"{where}: unknown key `{clipped(key)}`{did_you_mean(key, structs)}")
            foreign.append(above + clipped(key))
            continue
        inner, items = structs[key], value if isinstance(value, list) else [value]
        if inner is not None:
            deeper = f"{where} [{key}]", error, foreign, f"{above}{key}."
            items = [_known(item, inner, *deeper) if isinstance(item, dict) else item for item in items]
        known[key] = items if isinstance(value, list) else items[0]
    return known


@functools.cache
def _structs_of(into: type[msgspec.Struct]) -> dict[str, type[msgspec.Struct] | None]:
    """Keys of a struct, and the struct type inside each; asked for every table of a long list."""
    return {field.encode_name: _struct_in(field.type) for field in msgspec.structs.fields(into)}


def _struct_in(kind: Any) -> type[msgspec.Struct] | None:
    """The struct type inside an annotation such as ``Camera``, ``Camera | None`` or ``list[Camera]``."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return kind
    if typing.get_origin(kind) in (typing.Union, types.UnionType, list, tuple, typing.Annotated):
        for part in typing.get_args(kind):
            found = _struct_in(part)
            if found is not None:
                return found
    return None
