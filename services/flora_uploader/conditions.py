"""How things stand: problems that last, by name, and one sentence about all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from flora_uploader.policy import DiskAlert

SENTENCE_LENGTH: Final = 500


@dataclass(frozen=True, slots=True)
class _Condition:
    reason: str
    serious: bool


class Conditions:
    """Lasting problems. The target's comes first, then what is newest last.

    Attributes:
        disk: the disk alert that holds.
    """

    def __init__(self) -> None:
        self.disk: DiskAlert | None = None
        self._holding: dict[str, _Condition] = {}

    def __contains__(self, key: str) -> bool:
        return key in self._holding

    def set(self, key: str, reason: str, *, serious: bool = True) -> bool:
        """Begin or change one; an empty reason ends it. Returns whether this is news."""
        if not reason:
            self.clear(key)
            return False
        before = self._holding.get(key)
        self._holding[key] = _Condition(reason, serious)
        return before is None or before.reason != reason

    def clear(self, key: str) -> None:
        self._holding.pop(key, None)

    @property
    def is_serious(self) -> bool:
        """Whether the service is degraded."""
        return any(condition.serious for condition in self._holding.values())

    def sentence(self) -> str:
        """One line: the target's problem, else the first of the serious ones, and how many more there are."""
        if not self._holding:
            return ""
        order = sorted(self._holding.items(), key=lambda item: (item[0] != "target", not item[1].serious))
        first = order[0][1].reason
        more = len(order) - 1
        tail = f" (and {more} more {'thing' if more == 1 else 'things'})" if more else ""
        return first[: SENTENCE_LENGTH - len(tail)] + tail
