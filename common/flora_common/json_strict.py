"""JSON from strangers into a plain table, and a table into the one text that stands for it.

What Python's own reader lets through and no file of ours may hold is refused: keys given twice, NaN and infinities,
whole numbers of more than 19 digits, lone surrogates, nesting beyond the stack.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

from flora_common.errors import BadInput

LONGEST_WHOLE: Final = 19
"""Characters of a whole number: no count or time that belongs into a file is longer."""


def read_table(data: bytes, *, where: str, what: str, error: type[BadInput]) -> dict[str, Any]:
    """Parse one JSON object.

    Args:
        data: the text in UTF-8.
        where: the file, for the message.
        what: the kind of file, for the message.
        error: the error class to raise.

    Raises:
        error: any violation, in one line.
    """

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        table: dict[str, Any] = {}
        for key, value in items:
            if key in table:
                raise error(f"{where}: key `{key[:40]}` is given twice")
            table[key] = value
        return table

    def number(text: str) -> float:
        value = float(text)
        if not math.isfinite(value):
            raise error(f"{where}: {text[:20]} is not a finite number")
        return value

    def whole(text: str) -> int:
        if len(text) > LONGEST_WHOLE:
            raise error(f"{where}: {text[:20]}… is larger than any number that belongs here")
        return int(text)

    try:
        table = json.loads(
            data.decode(), object_pairs_hook=pairs, parse_float=number, parse_int=whole, parse_constant=number
        )
        json.dumps(table, ensure_ascii=False).encode()  # escapes can spell half a character
    except UnicodeDecodeError as problem:
        raise error(f"{where}: not UTF-8 text (byte {problem.start})") from problem
    except UnicodeEncodeError as problem:
        raise error(f"{where}: a text holds half a character (a lone surrogate)") from problem
    except RecursionError as problem:
        raise error(f"{where}: not valid JSON: nested too deeply") from problem
    except ValueError as problem:
        raise error(f"{where}: not valid JSON: {problem}") from problem
    if not isinstance(table, dict):
        raise error(f"{where}: not {what} (no JSON object)")
    return table


def canonical_bytes(table: Mapping[str, Any]) -> bytes:
    """The one text of a table: keys in order, no white space, numbers the shortest way that reads back the same."""
    return json.dumps(table, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
