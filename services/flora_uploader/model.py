"""What the uploader is given, and what it says."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Stage = Literal["waiting", "stored", "refused"]


@dataclass(frozen=True, slots=True)
class Event:
    """Something to tell: a file stored or refused, or that all waits."""

    stage: Stage
    run: str = ""
    path: str = ""
    sha256: str = ""
    bytes: int = 0
    destination: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class World:
    """What is handed in.

    Attributes:
        now_s: real, monotonic seconds.
        utc_ns: wall clock.
        percent_free: of the spool's disk.
        uniform: chance, for the jitter.
        say: where events go.
    """

    now_s: Callable[[], float]
    utc_ns: Callable[[], int]
    percent_free: Callable[[], float]
    say: Callable[[Event], None]
    uniform: Callable[[float, float], float] = random.uniform


@dataclass(slots=True)
class Totals:
    """What this process did."""

    files: int = 0
    bytes: int = 0
    found_there: int = 0
    rechecked: int = 0
    found_damaged: int = 0
