"""How many there are of something, and which, in words for people."""

from __future__ import annotations

from collections.abc import Sequence


def counted(count: int, what: str) -> str:
    """``1 run``, ``2 runs``; ``what`` is one of them, and its plural has an s."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``; of one name at least."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"
