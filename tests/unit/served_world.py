"""A virtual world behind its server, without a process, at a clock that the test moves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack

from flora_twin.server import WorldServer
from flora_twin.strips import OFF, LampLight, strip_bytes
from flora_twin.world import World

START_NS = 1_772_352_000_000_000_000
FULL_WHITE = LampLight(1.0, 1.0, 1.0)
RIGHT = strip_bytes(OFF, FULL_WHITE)


@dataclass
class Clock:
    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Rig:
    server: WorldServer
    clock: Clock
    folder: Path

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        reply = self.server.handle(msgpack.packb({"op": op, **arguments}))
        assert reply is not None
        answer = msgpack.unpackb(reply)
        assert isinstance(answer, dict)
        return answer


def make(folder: Path, *, seed: int = 3, rate: float = 0.0) -> Rig:
    """At the start of a world, or where the one in this folder was left."""
    clock = Clock()
    return Rig(WorldServer(World(seed), folder, start_utc_ns=START_NS, rate=rate, monotonic_s=clock), clock, folder)
