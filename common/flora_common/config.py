"""One TOML file for a whole rig: ``[rig]`` for all, and a section for each service, which alone knows its keys.

Strict: an unknown key or section ends the start with one line that names the nearest known one. Defaults keep
everything and harm nothing.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

import msgspec

from flora_common.bus import BusAddress
from flora_common.bus_keys import ClientKeys, check_reach, client_keys, is_loopback, is_tcp
from flora_common.errors import BadInput, ConfigError
from flora_common.messages.envelope import Name
from flora_common.rig_name import RigName
from flora_common.suggest import did_you_mean
from flora_common.toml_strict import convert, read_toml, to_toml

DEFAULT_CONFIG: Final = Path("/etc/flora/flora.toml")

SECTIONS: Final = (
    "rig",
    "bus",
    "flash",
    "capture",
    "stem",
    "controller",
    "led",
    "uploader",
    "recorder",
    "dashboard",
    "lab",
    "twin",
    "monitor",
)
"""Every section that a rig's file may have. A service reads ``[rig]`` and its own; of the others it checks the name."""

DASHBOARD_PORT: Final = 8322
"""Where the page is looked for, unless the configuration says otherwise."""

Endpoint = Annotated[
    str,
    msgspec.Meta(
        pattern=r"^(ipc|tcp|inproc)://.+",
        max_length=256,
        extra={"words": "an address such as ipc:///run/flora/bus-publish or tcp://10.0.0.5:5571"},
    ),
]


class ClockSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[rig.clock]``: the machine's time, or the virtual grow box's."""

    kind: Literal["system", "twin"] = "system"
    """``twin`` is the virtual grow box, whose time may stand still or run ahead."""

    twin: Endpoint = "ipc:///run/flora/twin"
    """Where flora-twin answers."""


class RigSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[rig]``: what all services share."""

    name: RigName = "box1"
    """First part of every topic; small letters, digits, - and _."""

    run_dir: str = "/var/lib/flora/runs/current"
    """The present run's folder, with its ``run.toml``."""

    state_dir: str = "/var/lib/flora/state"
    """What services keep over a restart; one folder per rig."""

    bus_publish: Endpoint = "ipc:///run/flora/bus-publish"
    """Where flora-bus hears: all publish there."""

    bus_subscribe: Endpoint = "ipc:///run/flora/bus-subscribe"
    """Where flora-bus says: all subscribe there; another endpoint than ``bus_publish``."""

    bus_keys: str = ""
    """Folder of the keys that a bus over ``tcp://`` asks for; empty for none."""

    bus_open: bool = False
    """A bus that other machines reach may do without keys: everyone on the network can then light the lamps."""

    health_every_s: Annotated[float, msgspec.Meta(ge=0.1, le=60.0)] = 10.0
    """Real seconds between two ``health`` messages of a service."""

    clock: ClockSection = ClockSection()

    @property
    def bus(self) -> BusAddress:
        """Where the bus is, with this machine's keys where it is over TCP and has some: the files are read each time.

        Raises:
            ConfigError: the keys cannot be used.
        """
        return BusAddress(self.bus_publish, self.bus_subscribe, self.own_keys())

    @property
    def has_own_clock(self) -> bool:
        """Whether the times in messages are of this machine's own clock: else nobody here knows how old they are."""
        is_here = self.bus_subscribe.startswith("ipc://") or is_loopback(self.bus_subscribe)
        return self.clock.kind != "twin" and is_here

    def own_keys(self) -> ClientKeys | None:
        """What this machine shows to the bus; None where nobody asks.

        Raises:
            ConfigError: the files cannot be used.
        """
        is_asked = self.bus_keys and (is_tcp(self.bus_publish) or is_tcp(self.bus_subscribe))
        return client_keys(Path(self.bus_keys)) if is_asked else None

    def check_bus(self) -> None:
        """Whether the bus may be where the section says; reads no file.

        Raises:
            ConfigError: both ends are the same; no such port; it would be open to other machines, and nobody has said
                that this is meant.
        """
        if self.bus_publish == self.bus_subscribe:
            raise ConfigError(f"bus_publish and bus_subscribe are both {self.bus_publish}; they must differ")
        for key, endpoint in (("bus_publish", self.bus_publish), ("bus_subscribe", self.bus_subscribe)):
            check_reach(key, endpoint, bus_keys=self.bus_keys, bus_open=self.bus_open)

    def check_run_dir(self) -> None:
        """Whether messages can name the run: by its folder's own name, where ``run_dir`` is a link to it.

        Raises:
            ConfigError: they cannot.
        """
        name = Path(os.path.realpath(self.run_dir)).name
        try:
            msgspec.convert(name, Name)
        except msgspec.ValidationError as problem:
            folder = f"{self.run_dir}" if Path(self.run_dir).name == name else f"{self.run_dir} leads to `{name}`"
            raise ConfigError(
                f"run_dir {folder}: a run folder's name is at most 64 letters, digits, `.`, `_` and `-`, "
                "the first one a letter or digit"
            ) from problem

    def named(self, name: str) -> RigSection:
        """Another rig on the same bus."""
        return msgspec.structs.replace(self, name=name)


S = TypeVar("S", bound=msgspec.Struct)


def load_config(path: Path | None, section: str, into: type[S]) -> tuple[RigSection, S]:
    """``[rig]`` and one service's section.

    Args:
        path: the TOML file; None means :data:`DEFAULT_CONFIG` where it exists, else all defaults.
        section: the service's section.
        into: its type.

    Raises:
        ConfigError: file missing, not TOML, unknown section or key, wrong type, out of range.
    """
    path, tables = _tables(path)
    rig = _rig(path, tables)
    return rig, convert(tables.get(section, {}), into, where=f"{path} [{section}]", error=ConfigError)


def load_rig(path: Path | None) -> RigSection:
    """``[rig]`` alone, for commands that have no section of their own; otherwise as :func:`load_config`."""
    return _rig(*_tables(path))


def at_bus(rig: RigSection, *, publish: str | None, subscribe: str | None) -> RigSection:
    """The same rig with its bus elsewhere, as the options ``--publish`` and ``--subscribe`` say; None changes nothing.

    Raises:
        ConfigError: not an endpoint, or one that other machines reach, without keys.
    """
    for flag, key, value in (("--publish", "bus_publish", publish), ("--subscribe", "bus_subscribe", subscribe)):
        if value is not None:
            convert({key: value}, RigSection, where=flag, error=ConfigError)
            rig = msgspec.structs.replace(rig, **{key: value})
    rig.check_bus()
    return rig


def checked_rig_name(name: str) -> str:
    """The value of an option ``--rig``.

    Raises:
        BadInput: no rig can be called so.
    """
    try:
        convert({"name": name}, RigSection, where="--rig", error=ConfigError)
    except ConfigError as problem:
        raise BadInput(f"--rig {name!r}: a rig's name is small letters, digits, - and _, 32 at most") from problem
    return name


def _tables(path: Path | None) -> tuple[Path, dict[str, Any]]:
    if path is None:
        path = DEFAULT_CONFIG
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return path, {}
        except OSError:
            pass  # who reads it is told
    tables = read_toml(path, ConfigError)
    for name, table in tables.items():
        if name not in SECTIONS:
            raise ConfigError(f"{path}: unknown section [{name}]{did_you_mean(name, SECTIONS)}")
        if not isinstance(table, dict):
            raise ConfigError(f"{path}: `{name}` must be a section, [{name}]")
    return path, tables


def _rig(path: Path, tables: dict[str, Any]) -> RigSection:
    rig = convert(tables.get("rig", {}), RigSection, where=f"{path} [rig]", error=ConfigError)
    try:
        rig.check_bus()
        rig.check_run_dir()
    except ConfigError as problem:
        raise ConfigError(f"{path} [rig]: {problem}") from problem
    return rig


def config_text(rig: RigSection, section: str, own: msgspec.Struct) -> str:
    """What is in force, defaults filled in, as TOML that reads back the same."""

    def under(prefix: str, text: str) -> str:
        # Headers inside the text are relative to its own table.
        return f"[{prefix}]\n" + text.replace("\n[", f"\n[{prefix}.")

    return under("rig", to_toml(rig)) + "\n" + under(section, to_toml(own))
