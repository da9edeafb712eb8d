"""How many there are of something, in words for people."""

from __future__ import annotations


def counted(count: int, what: str) -> str:
    """``1 run``, ``2 runs``; ``what`` is one of them, and its plural has an s."""
    return f"{count} {what}{'' if count == 1 else 's'}"
