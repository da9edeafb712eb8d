"""What is known of a rig before the doctor looks at its parts: configuration of each service, units, who was heard."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from flora_common.config import DEFAULT_CONFIG, RigSection
from flora_common.health import Line
from flora_common.runs import RunFolder
from flora_monitor.doctor_units import MANUAL, Units, account_of
from flora_monitor.doctor_world import Account, Done, NotLookedAt, World, Wrong

AT_ONCE: Final = 2
"""Services asked for their configuration at once: a rig that runs must not be held up."""


class CaptureKeys(msgspec.Struct, frozen=True):
    """Keys of ``[capture]`` that the doctor needs; those of the classes below likewise."""

    backend: str
    source: str


class LedKeys(msgspec.Struct, frozen=True):
    backend: str
    pin: str


class FlashKeys(msgspec.Struct, frozen=True):
    backend: str
    chip: str
    line: int


class UploaderKeys(msgspec.Struct, frozen=True):
    target: str
    marker: str


class ControllerKeys(msgspec.Struct, frozen=True):
    use: str
    trust: str
    keys_dir: str


S = TypeVar("S", bound=msgspec.Struct)


@dataclass(frozen=True, slots=True)
class Heard:
    """What the bus said: whether it answered, a line for each service, and why one that is there does not."""

    is_there: bool
    lines: tuple[Line, ...] = ()
    hindrance: str = ""


@dataclass(frozen=True, slots=True)
class Case:
    """A rig on a machine.

    Attributes:
        world: the machine.
        rig: ``[rig]``.
        config: the file; None for the default one.
        services: those that must be there.
        printed: how each service answered ``--print-config``.
        units: by the service's name; empty where systemd does not run here.
        heard: from the bus.
        touch: switch, write and read back.
    """

    world: World
    rig: RigSection
    config: Path | None
    services: tuple[str, ...]
    printed: Mapping[str, Done]
    units: Units
    heard: Heard
    touch: bool

    @property
    def is_virtual(self) -> bool:
        """The virtual grow box: its time, no devices, nothing that starts at boot."""
        return self.rig.clock.kind == "twin"

    @property
    def run(self) -> RunFolder:
        return RunFolder(self.world.at(self.rig.run_dir))

    def section(self, name: str, keys: type[S]) -> S:
        """What is in force for a service.

        Raises:
            NotLookedAt: the service does not say.
        """
        done = self.printed.get(f"flora-{name}")
        if done is None or not done.is_good:
            raise NotLookedAt(f"[{name}] cannot be read")
        try:
            return msgspec.convert(tomllib.loads(done.out).get(name, {}), keys)
        except (tomllib.TOMLDecodeError, msgspec.ValidationError) as problem:
            raise NotLookedAt(f"flora-{name} --print-config says nothing that can be read ({problem})") from problem

    def account(self, service: str) -> Account:
        """Whom a service runs as."""
        return account_of(self.world, self.units.get(service))

    def is_running(self, service: str) -> bool:
        """Whether a process of the service holds its devices now."""
        return self.world.is_locked(Path(self.rig.state_dir) / f"{service}.lock")

    def ask(self, service: str, *command: str) -> Done:
        """A child process as the service would run: as its user, where the caller may choose."""
        return self.world.run(command, account=self.account(service))

    def ask_json(self, service: str, code: str, *arguments: str) -> Any:
        """What a few lines of Python say in the service's place, as one JSON value.

        Raises:
            NotLookedAt: the caller is not allowed to, where the service is.
            Wrong: it fails.
        """
        return self.read_json(service, self.ask(service, str(self.world.python), "-P", "-c", code, *arguments))

    def read_json(self, service: str, done: Done) -> Any:
        """The last line of what a child said; raises as :meth:`ask_json`."""
        me, other = self.world.me, self.account(service)
        if not done.is_good:
            if "PermissionError" in done.err and me.uid not in (0, other.uid):
                raise NotLookedAt(f"{me.name} may not, {other.name} would have to be asked: run this command with sudo")
            raise Wrong(done.reason)
        try:
            return msgspec.json.decode(done.out.splitlines()[-1])
        except (ValueError, RecursionError, IndexError) as problem:
            raise NotLookedAt(f"the answer cannot be read: {done.out[-200:]!r}") from problem


def print_configs(world: World, config: Path | None, services: Sequence[str]) -> dict[str, Done]:
    """Ask each service what is in force: that also proves that it can be loaded."""
    named = ["--config", str(config)] if config is not None else []
    with ThreadPoolExecutor(AT_ONCE) as pool:
        asked = pool.map(lambda service: world.run([world.program(service), *named, "--print-config"]), services)
        return dict(zip(services, asked, strict=True))


def check_config(case: Case) -> str:
    """The file is there, and every service can read it."""
    file = case.config or DEFAULT_CONFIG
    bad = {service: done for service, done in case.printed.items() if not done.is_good}
    if bad:
        reasons = dict.fromkeys(done.reason.removeprefix(f"{service}: ") for service, done in bad.items())
        raise Wrong(f"{', '.join(bad)} cannot start: {'; '.join(reasons)}")
    if case.config is None and not case.world.at(DEFAULT_CONFIG).exists():
        raise Wrong(f"{file} is not there, every service takes its defaults; write one ({MANUAL})")
    return f"{file}: {len(case.printed)} services read it; rig `{case.rig.name}`"
