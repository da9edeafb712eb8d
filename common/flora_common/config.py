"""One TOML file for a whole rig: ``[rig]`` for all, and a section for each service, which alone knows its keys.

Strict: an unknown key or section ends the start with one line that names the nearest known one. Defaults keep
everything and harm nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal, TypeVar

import msgspec

from flora_common.bus import BusAddress
from flora_common.errors import ConfigError
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

Endpoint = Annotated[str, msgspec.Meta(pattern=r"^(ipc|tcp|inproc)://.+", max_length=256)]


class ClockSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[rig.clock]``: the machine's time, or the virtual grow box's."""

    kind: Literal["system", "twin"] = "system"
    twin: Endpoint = "ipc:///run/flora/twin"


class RigSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[rig]``: what all services share."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}$(?!\n)")] = "box1"
    run_dir: str = "/var/lib/flora/runs/current"
    state_dir: str = "/var/lib/flora/state"
    bus_publish: Endpoint = "ipc:///run/flora/bus-publish"
    bus_subscribe: Endpoint = "ipc:///run/flora/bus-subscribe"
    health_every_s: Annotated[float, msgspec.Meta(ge=0.1, le=60.0)] = 10.0
    clock: ClockSection = ClockSection()

    @property
    def bus(self) -> BusAddress:
        return BusAddress(self.bus_publish, self.bus_subscribe)


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
    if path is None:
        if not DEFAULT_CONFIG.exists():
            return RigSection(), into()
        path = DEFAULT_CONFIG
    tables = read_toml(path, ConfigError)
    for name, table in tables.items():
        if name not in SECTIONS:
            raise ConfigError(f"{path}: unknown section [{name}]{did_you_mean(name, SECTIONS)}")
        if not isinstance(table, dict):
            raise ConfigError(f"{path}: `{name}` must be a section, [{name}]")
    rig = convert(tables.get("rig", {}), RigSection, where=f"{path} [rig]", error=ConfigError)
    own = convert(tables.get(section, {}), into, where=f"{path} [{section}]", error=ConfigError)
    return rig, own


def config_text(rig: RigSection, section: str, own: msgspec.Struct) -> str:
    """What is in force, defaults filled in, as TOML that reads back the same."""

    def under(prefix: str, text: str) -> str:
        # Headers inside the text are relative to its own table.
        return f"[{prefix}]\n" + text.replace("\n[", f"\n[{prefix}.")

    return under("rig", to_toml(rig)) + "\n" + under(section, to_toml(own))
