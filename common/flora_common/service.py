"""What every service shares: one way to start, and to end.

A service is a function ``build(app)`` that hangs its handlers on an :class:`~flora_common.app.App`; ``run_service``
does the rest::

    def build(app: App[FlashSection]) -> None:
        app.on(Frame, lambda frame: ...)
        app.every(1.0, check)
"""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from flora_common import clock as clocks
from flora_common import twin_link
from flora_common.app import App
from flora_common.cli import ArgumentParser, run_cli, version_line
from flora_common.config import RigSection, config_text, load_config
from flora_common.errors import ConfigError
from flora_common.files import make_folder
from flora_common.lock import AlreadyHeld, hold
from flora_common.log import Log, choose_sink
from flora_common.runs import RunFolder

S = TypeVar("S", bound=msgspec.Struct)


@dataclass(frozen=True, slots=True)
class Action(Generic[S]):
    """A flag that does one thing and ends, such as ``flora-led --dark``."""

    flag: str
    help: str
    work: Callable[[RigSection, S], int | None]


def run_service(
    name: str,
    section_type: type[S],
    build: Callable[[App[S]], None],
    *,
    argv: Sequence[str] | None = None,
    description: str = "",
    actions: Sequence[Action[S]] = (),
    check: Callable[[RigSection, S], None] = lambda rig, config: None,
    make_clock: Callable[[RigSection], clocks.Clock] | None = None,
) -> int:
    """The body of every service's ``main``; returns the exit status.

    Args:
        name: the command.
        section_type: type of its configuration section, whose name is the command's without ``flora-``.
        build: hangs the service's work on the app; raises FloraError where it cannot work.
        argv: arguments without the program name; ``sys.argv`` where None.
        description: one sentence for ``--help``.
        actions: further flags that do one thing and end.
        check: raises ConfigError, or other BadInput, where a configuration of the right types cannot be used all the
            same. Asked at the start and by ``--check-config``: it writes nothing, and waits for nobody.
        make_clock: where the beat needs a leading clock; others follow the rig's.
    """
    section = name.removeprefix("flora-")

    def work() -> int | None:
        options = _parser(name, description, actions).parse_args(argv)
        if options.version:
            print(version_line(name))
            return 0
        rig, config = load_config(options.config, section, section_type)
        if options.check_config:
            rig.own_keys()
            _check_folders(rig)
            check(rig, config)
            print(f"{name}: configuration is good")
            return 0
        if options.print_config:
            print(config_text(rig, section, config), end="")
            return 0
        for action in actions:
            if getattr(options, _destination(action.flag)):
                return action.work(rig, config)
        level = logging.DEBUG if options.verbose else logging.WARNING if options.quiet else logging.INFO
        log = Log(name, choose_sink(), level=level, common={"run": RunFolder(Path(rig.run_dir)).name})
        check(rig, config)
        with _only_one(name, rig):
            clock = make_clock(rig) if make_clock else default_clock(rig)
            app = App(name, rig, config, log=log, clock=clock)
            build(app)
            app.loop()
        return 0

    return run_cli(name, work)


def default_clock(rig: RigSection) -> clocks.Clock:
    """The machine's clock on a rig, the grow box's in the virtual one."""
    return clocks.SystemClock() if rig.clock.kind == "system" else twin_link.follower_clock(rig.clock.twin)


def _check_folders(rig: RigSection) -> None:
    """Whether run folder and state folder are there, or can ever be made where they are named.

    One that is missing is no fault of the configuration: a service or systemd makes the state folder, a person the run,
    later. Nor is one that whoever asks may not look into: the services are other users.

    Raises:
        ConfigError: something else is in the way.
    """
    for key, folder in (("run_dir", Path(rig.run_dir)), ("state_dir", Path(rig.state_dir))):
        path = folder.absolute()
        there = next(place for place in (path, *path.parents) if os.access(place, os.F_OK))
        if not there.is_dir():
            raise ConfigError(f"[rig] {key} {folder}: {there} is no folder; move it away, or name another place")


@contextlib.contextmanager
def _only_one(name: str, rig: RigSection) -> Iterator[None]:
    """Hold the service's lock; the kernel lets go of it however the process ends."""
    folder = Path(rig.state_dir)
    try:
        make_folder(folder)
        lock = hold(folder / f"{name}.lock")
    except OSError as problem:
        raise ConfigError(f"[rig] state_dir {folder}: cannot be written ({problem.strerror})") from problem
    except AlreadyHeld as by:
        raise ConfigError(f"{name} already runs for rig `{rig.name}` (pid {by.pid}); stop it first") from None
    try:
        yield
    finally:
        os.close(lock)


def _destination(flag: str) -> str:
    return "action_" + flag.strip("-").replace("-", "_")


def _parser(name: str, description: str, actions: Sequence[Action[Any]]) -> ArgumentParser:
    parser = ArgumentParser(name, description=description)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the rig's TOML file (default /etc/flora/flora.toml)"
    )
    parser.add_argument("--check-config", action="store_true", help="check the configuration and end")
    parser.add_argument(
        "--print-config", action="store_true", help="print what is in force, defaults included, and end"
    )
    parser.add_argument("--version", action="store_true", help="print the version and end")
    volume = parser.add_mutually_exclusive_group()
    volume.add_argument("-v", "--verbose", action="store_true", help="say more")
    volume.add_argument("-q", "--quiet", action="store_true", help="only warnings and errors")
    for action in actions:
        parser.add_argument(action.flag, dest=_destination(action.flag), action="store_true", help=action.help)
    return parser
