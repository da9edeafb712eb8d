"""What every command of the monitor is given: which bus, which rig, how to show it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer

from flora_common.bus import COMES_AND_GOES
from flora_common.config import RigSection, at_bus, checked_rig_name, load_config
from flora_common.errors import BadInput, BadRunFolder
from flora_common.health import ONLY_LOOKS, services_of_catalogue
from flora_common.runs import RunFolder
from flora_common.suggest import did_you_mean
from flora_monitor.listen import IS_IT_RUNNING, Listener
from flora_monitor.stats import Board, checked_pattern, matches

DEFAULT_TICK_S: Final = 300.0
LEAST_TICK_S: Final = 0.001
MOST_TICK_S: Final = 86_400.0
BESIDES: Final = (ONLY_LOOKS, COMES_AND_GOES)
"""A rig is well without them, and they tell their health."""


class MonitorSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[monitor]``: which services ``health`` wants to see."""

    services: tuple[Annotated[str, msgspec.Meta(pattern=r"^flora-[a-z]+$", max_length=64)], ...] = (
        services_of_catalogue()
    )
    """Which must be there for ``health`` and ``doctor`` to be content."""


@dataclass(frozen=True, slots=True)
class Common:
    """Options of every command."""

    rig: RigSection
    section: MonitorSection
    only_rig: str | None
    as_json: bool

    @property
    def is_lock_step(self) -> bool:
        """Rig time is the grow box's, not this machine's."""
        return self.rig.clock.kind == "twin"

    def tick_s(self, interval_s: float | None) -> float:
        if interval_s is not None:
            return interval_s
        try:
            return RunFolder(Path(self.rig.run_dir)).read_run_file().interval_s
        except BadRunFolder:
            return DEFAULT_TICK_S

    def services(self, pattern: str) -> list[str]:
        """Those that must be there, of the ones that a pattern names; whoever is named in full must be there, too.

        Raises:
            BadInput: it names none that is known.
        """
        known = (*self.section.services, *(name for name in BESIDES if name not in self.section.services))
        if not any(matches(pattern, name) for name in known):
            raise BadInput(f"no service is called `{pattern[:60]}`{did_you_mean(pattern, known)}")
        if pattern in known:
            return [pattern]
        return [name for name in self.section.services if matches(pattern, name)]

    def board(self, interval_s: float | None = None) -> Board:
        return Board(tick_s=self.tick_s(interval_s), health_s=self.rig.health_every_s, is_lock_step=self.is_lock_step)

    def listener(self, pattern: str = "*", *, waits: bool = True) -> Listener:
        """Of this rig; where no bus answers it says that it waits for one, or asks."""
        without_bus = "waiting for it" if waits else IS_IT_RUNNING
        return Listener(self.rig, only_rig=self.only_rig, pattern=pattern, without_bus=without_bus)


def _checked_interval(value: float | None) -> float | None:
    """As long as run.toml may say; NaN is no such time."""
    if value is not None and not LEAST_TICK_S <= value <= MOST_TICK_S:
        raise BadInput(f"--interval: {value:g} does not lie in [{LEAST_TICK_S:g}, {MOST_TICK_S:g}]")
    return value


Pattern = Annotated[
    str, typer.Argument(help="Glob on <rig>/<kind>, or on the kind alone.", metavar="PATTERN", callback=checked_pattern)
]
Rig = Annotated[str | None, typer.Option("--rig", help="This rig only.", metavar="NAME")]
Config = Annotated[Path | None, typer.Option("--config", help="The rig's TOML file.", metavar="FILE")]
Publish = Annotated[str | None, typer.Option("--publish", help="Where the bus hears.", metavar="ENDPOINT")]
Subscribe = Annotated[str | None, typer.Option("--subscribe", help="Where the bus says.", metavar="ENDPOINT")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object a line; also when piped.")]
Count = Annotated[int | None, typer.Option("--count", min=1, help="End after this many messages.")]
Seconds = Annotated[float | None, typer.Option("--seconds", min=0.0, help="End after this many seconds.")]
Interval = Annotated[
    float | None,
    typer.Option(
        "--interval", callback=_checked_interval, help="Seconds between ticks; as run.toml says where not given."
    ),
]


def common_options(
    config: Path | None, rig: str | None, publish: str | None, subscribe: str | None, *, as_json: bool
) -> Common:
    found, section = load_config(config, "monitor", MonitorSection)
    found = at_bus(found, publish=publish, subscribe=subscribe)
    if rig is not None:
        checked_rig_name(rig)
    return Common(found, section, rig, as_json or not sys.stdout.isatty())
