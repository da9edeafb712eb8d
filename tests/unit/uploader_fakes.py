"""A spool, a target in memory that can fail at any call, and clocks that stand still, for the uploader's tests."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from flora_common.errors import NasUnreachable
from flora_uploader.config import UploaderSection
from flora_uploader.ledger import Ledger
from flora_uploader.model import Event, World
from flora_uploader.owner import Owners
from flora_uploader.uploader import Uploader

DAY_NS = 24 * 3600 * 1_000_000_000
NOW_NS = 1_800_000_000 * 1_000_000_000


class Killed(BaseException):
    """The process ends here, with no clean-up."""


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


class MemoryTarget:
    """Files by path; what was not synced when a process is killed is cut in half, as after a power cut.

    Attributes:
        at_call: called with (number of the call, its name) before each; may raise.
    """

    name = "/memory"

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.unsynced: set[str] = set()
        self.calls = 0
        self.is_there = True
        self.at_call: Callable[[int, str], None] = lambda number, what: None
        self.renamed_unsynced: list[str] = []
        self.same_as: str | None = None

    def _call(self, what: str) -> None:
        self.calls += 1
        try:
            self.at_call(self.calls, what)
        except Killed:
            for path in self.unsynced & set(self.files):
                self.files[path] = self.files[path][: len(self.files[path]) // 2]
            self.unsynced.clear()
            raise

    def connect(self) -> None:
        self._call("connect")
        if not self.is_there:
            raise NasUnreachable("/memory: gone")

    def disconnect(self) -> None:
        pass

    def size(self, path: str) -> int | None:
        self._call("size")
        return len(self.files[path]) if path in self.files else None

    def is_same_file(self, path: str, source: os.stat_result) -> bool:
        self._call("is_same_file")
        return path == self.same_as

    def make_folder(self, path: str) -> None:
        self._call("make_folder")

    def create(self, path: str) -> MemoryFile:
        self._call("create")
        self.files[path] = b""
        self.unsynced.add(path)
        return MemoryFile(self, path)

    def open(self, path: str) -> MemoryFile:
        self._call("open")
        return MemoryFile(self, path)

    def rename(self, old: str, new: str) -> None:
        self._call("rename")
        if old in self.unsynced:
            self.renamed_unsynced.append(old)
        self.files[new] = self.files.pop(old)
        self._call("rename done")

    def remove(self, path: str) -> None:
        self._call("remove")
        self.files.pop(path, None)

    def names(self, folder: str) -> list[str]:
        self._call("names")
        start = folder + "/"
        return [path.removeprefix(start) for path in self.files if path.startswith(start)]


class MemoryFile:
    def __init__(self, target: MemoryTarget, path: str) -> None:
        self._target = target
        self._path = path
        self._position = 0

    def write(self, data: memoryview) -> None:
        self._target._call("write")
        self._target.files[self._path] += bytes(data)
        self._target.unsynced.add(self._path)

    def sync(self) -> None:
        self._target._call("sync")
        self._target.unsynced.discard(self._path)

    def readinto(self, buffer: memoryview) -> int:
        self._target._call("read")
        data = self._target.files[self._path][self._position : self._position + len(buffer)]
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)

    def close(self) -> None:
        pass


def rot(ledger: Ledger) -> None:
    """What a failing card does to an open ledger: all of the file but its first page is something else."""
    ledger._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with ledger.path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xa5" * (ledger.path.stat().st_size - 4096))
    ledger._db.execute("PRAGMA shrink_memory")  # nothing of it is remembered


@dataclass
class Clocks:
    """Real seconds and wall clock, moved by tests only."""

    s: float = 0.0
    utc_ns: int = NOW_NS


@dataclass
class Bench:
    """An uploader with everything round it.

    Attributes:
        spool: folder with run folders; ``run`` is the present one.
    """

    root: Path
    target: MemoryTarget = field(default_factory=MemoryTarget)
    clocks: Clocks = field(default_factory=Clocks)
    config: UploaderSection = field(default_factory=UploaderSection)
    percent_free: float = 60.0
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.spool = self.root / "runs"
        self.run = self.spool / "bean"
        (self.run / "frames").mkdir(parents=True)
        self.write("run.toml", b"[camera]\n")
        self.start()

    def start(self) -> None:
        """A new process: everything but disk, ledger and target is forgotten."""
        self.ledger = Ledger(self.root / "state", self.target.name)
        world = World(
            lambda: self.clocks.s,
            lambda: self.clocks.utc_ns,
            lambda: self.percent_free,
            self.events.append,
            lambda low, high: high,
        )
        owners = Owners(self.target, self.ledger.id, rig="box1", machine="pi")
        self.uploader = Uploader(self.spool, self.run, self.target, owners, self.ledger, self.config, world)

    def restart(self) -> None:
        self.uploader.abandon()
        self.ledger.close()
        self.start()

    def kill(self) -> None:
        """The process is gone: no clean-up but the kernel's."""
        self.uploader._job = None
        self.ledger.close()

    def work(self, seconds: float = 0.0) -> None:
        """Let it work until nothing can be done now, and on through so many seconds of waiting."""
        end_s = self.clocks.s + seconds
        while True:
            wait_s = self.uploader.step()
            if self.clocks.s + wait_s > end_s:
                self.clocks.s = max(self.clocks.s, end_s)
                return
            self.clocks.s += wait_s

    def write(self, path: str, data: bytes, *, age_ns: int = 0, run: Path | None = None) -> Path:
        file = (run or self.run) / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        stamp = self.clocks.utc_ns - age_ns
        os.utime(file, ns=(stamp, stamp))
        return file

    def photograph(self, number: int, data: bytes, *, age_ns: int = 0, announce: bool = True) -> str:
        """A frame as the camera leaves it: the file, then its line."""
        path = f"frames/{number:06d}.jpg"
        self.write(path, data, age_ns=age_ns)
        if announce:
            with (self.run / "frames.jsonl").open("a") as log:
                log.write(json.dumps({"file": path, "tick": number, "sha256": sha(data)}) + "\n")
        return path

    def state_of(self, path: str, run: str = "bean") -> str:
        entry = self.ledger.get(run, path)
        return entry.state if entry else "unknown"

    def there(self, path: str, run: str = "bean") -> bytes | None:
        return self.target.files.get(f"{run}/{path}")

    def stages(self) -> list[tuple[str, str]]:
        return [(event.stage, event.path) for event in self.events]


def heal(bench: Bench) -> None:
    """Whatever its target failed at, it does not any more."""
    bench.target.at_call = lambda number, what: None
