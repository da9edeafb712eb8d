"""How things stand: problems that last, by name, and what to say about all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from flora_common.messages.envelope import LONGEST_SENTENCE
from flora_uploader.policy import DiskAlert, disk_alert

SHOWN: Final = 3


@dataclass(frozen=True, slots=True)
class _Condition:
    reason: str
    serious: bool


class Conditions:
    """Lasting problems.

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

    def disk_is(self, percent_free: float) -> None:
        """How much room the spool's disk has, for those who are not root: the steps that it has passed are told."""
        self.disk = disk_alert(100.0 - percent_free, self.disk)
        self.set(
            "disk",
            f"the spool's disk is more than {self.disk.percent} % full" if self.disk else "",
            serious=self.disk is not None and self.disk.is_serious,
        )

    @property
    def is_serious(self) -> bool:
        """Whether the service is degraded."""
        return any(condition.serious for condition in self._holding.values())

    def sentence(self) -> str:
        """The target's problem, then what else is serious, the disk last: three at most, and how many more."""
        order = sorted(
            self._holding.items(), key=lambda item: (item[0] != "target", not item[1].serious, item[0] == "disk")
        )
        told = "; ".join(condition.reason for _, condition in order[:SHOWN])
        more = f" (and {len(order) - SHOWN} more)" if len(order) > SHOWN else ""
        return told[: LONGEST_SENTENCE - len(more)] + more
