"""TOML into typed, frozen structures: unknown keys, wrong types and numbers out of range are told, with the place."""

from __future__ import annotations

import functools
import re
import tomllib
import types
import typing
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomli_w

from flora_common.errors import BadInput
from flora_common.suggest import clipped, did_you_mean

T = TypeVar("T", bound=msgspec.Struct)


def read_toml(path: Path, error: type[BadInput]) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        error: the file cannot be read or is not TOML; the message names file, line and column.
    """
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not UTF-8 text (byte {problem.start})") from problem
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise error(f"{path}: not valid TOML: {problem}") from problem


def convert(data: dict[str, Any], into: type[T], *, where: str, error: type[BadInput]) -> T:
    """Check a parsed table against a struct type.

    Args:
        data: the table as parsed.
        into: a struct type; fields that it does not name are refused, at every depth.
        where: the file, and the section where there is one, for the message.
        error: the error class to raise.
    """
    _refuse_unknown(data, into, where, error)
    try:
        return msgspec.convert(data, into)
    except msgspec.ValidationError as problem:
        text = str(problem)
        at = re.search(r" - at `\$\.?(.*)`$", text)
        message = text[: at.start()] if at else text
        path = at.group(1) if at and at.group(1) else ""
        key = f" `{path}`" if path else ""
        hint = _known_values(into, path, message) or _number_given(data, path)
        raise error(f"{where}:{key} {message[0].lower()}{clipped(message[1:], 200)}{hint}") from problem


def _known_values(into: type[msgspec.Struct], path: str, message: str) -> str:
    """For a word that is not one of the allowed ones: which they are, the nearest first."""
    wrong = re.match(r"Invalid enum value '(.*)'$", message)
    if wrong is None:
        return ""
    kind: Any = into
    for name in re.sub(r"\[[^\]]*\]", "", path).split("."):
        owner = _struct_in(kind)
        found = [field.type for field in msgspec.structs.fields(owner) if field.encode_name == name] if owner else []
        if not found:
            return ""
        kind = found[0]
    literals = [part for part in (kind, *typing.get_args(kind)) if typing.get_origin(part) is typing.Literal]
    return did_you_mean(wrong.group(1), [str(v) for part in literals for v in typing.get_args(part)])


def _number_given(data: dict[str, Any], path: str) -> str:
    """The number that was refused: ``nan`` is not seen to be out of a range."""
    value: Any = data
    for name in re.findall(r"[^.\[\]]+", path):
        try:
            value = value[int(name) if isinstance(value, list) else name]
        except (KeyError, IndexError, TypeError, ValueError):
            return ""
    return f", it is {value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else ""


def to_toml(value: msgspec.Struct) -> str:
    """A struct as TOML text, fields that are None left out (TOML has no null)."""
    return tomli_w.dumps(_without_none(msgspec.to_builtins(value, builtin_types=(datetime,))))


def _without_none(table: dict[str, Any]) -> dict[str, Any]:
    return {k: _without_none(v) if isinstance(v, dict) else v for k, v in table.items() if v is not None}


def _refuse_unknown(data: dict[str, Any], into: type[msgspec.Struct], where: str, error: type[BadInput]) -> None:
    structs = _structs_of(into)
    for key, value in data.items():
        if key not in structs:
            raise error(f"{where}: unknown key `{clipped(key)}`{did_you_mean(key, structs)}")
        inner = structs[key]
        if inner is None:
            continue
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, dict):
                _refuse_unknown(item, inner, f"{where} [{key}]", error)


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
