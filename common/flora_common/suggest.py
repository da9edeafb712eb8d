"""The nearest name for one that nobody knows: "did you mean …?"."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Final

_MOST_NAMES: Final = 40
_LONGEST: Final = 60
_NEAR, _SLIP = 0.6, 0.85
"""How alike names are, from 0 to 1, of which one is asked after, and of which one must be meant."""


def did_you_mean(wrong: str, known: Iterable[str]) -> str:
    """A clause to append to an error: ``; did you mean `x`?``, or the list of what exists where nothing is near."""
    names = sorted(known)
    near = difflib.get_close_matches(wrong, names, n=1, cutoff=_NEAR)
    if near:
        return f"; did you mean `{clipped(near[0])}`?"
    more = ", …" if len(names) > _MOST_NAMES else ""
    return f"; known: {', '.join(map(clipped, names[:_MOST_NAMES]))}{more}" if names else ""


def is_slip(wrong: str, known: Iterable[str]) -> bool:
    """Whether a name that nobody knows is all but one that is known, and hence a slip of the pen."""
    return bool(difflib.get_close_matches(wrong, known, n=1, cutoff=_SLIP))


def clipped(text: str, longest: int = _LONGEST) -> str:
    """Text from a file or a person for a message: a line of a megabyte says no more than its beginning."""
    return text if len(text) <= longest else f"{text[:longest]}…"
