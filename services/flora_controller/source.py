"""Where the steering rule comes from: a built-in name, a light plan, or a controller file.

A controller file may be replaced while it steers: it is looked at before each decision. A new one takes over whole, or
not at all: what is refused leaves the old one at work. The bytes that were accepted last are kept in the state folder,
so that a bad file in place of a good one does not stop a service that is started again either.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, get_args

from flora_common.controller_file import SUFFIX, LoadedController, load_controller, parse_controller
from flora_common.errors import BadController, ConfigError, StoreError
from flora_common.files import sha256_of_bytes, write_bytes
from flora_common.light_plan import SUFFIX as LIGHTS_SUFFIX
from flora_common.light_plan import read_light_plan
from flora_common.shapes import Obstacle, Target
from flora_common.suggest import did_you_mean
from flora_controller.acceptance import Acceptance
from flora_controller.core import BuiltIn, ControllerSection
from flora_controller.evolved import Evolved
from flora_controller.steering import Dark, OpenLoop, Planned, Steering, TipFollower, Waypoint

BUILT_IN: Final[tuple[str, ...]] = get_args(BuiltIn)

_Stamp = tuple[int, int, int, int, int]


def check_name(use: str) -> None:
    """Whether a rule that is no controller file can be had.

    Raises:
        BadInput: no such built-in rule, or a light plan that cannot be read.
    """
    if use.endswith(LIGHTS_SUFFIX):
        read_light_plan(Path(use))
    elif use not in BUILT_IN:
        raise ConfigError(
            f"[controller] use: no built-in controller `{use[:60]}`{did_you_mean(use, BUILT_IN)} "
            f"(a file's name ends in {SUFFIX} or {LIGHTS_SUFFIX})"
        )


def built_in(section: ControllerSection, target: Target | None, obstacle: Obstacle | None) -> Steering:
    """The rule of a built-in name, or of a light plan.

    Raises:
        BadInput: no such name, the run lacks what the rule steers by, or a plan that cannot be read.
    """
    if section.use.endswith(LIGHTS_SUFFIX):
        return Planned(read_light_plan(Path(section.use)))
    check_name(section.use)
    if section.use == "open-loop":
        return OpenLoop(section.open_loop)
    if section.use == "dark":
        return Dark()
    if target is None:
        raise ConfigError(f"controller `{section.use}` steers to a target; give run.toml a section [target]")
    if section.use == "tip-follower":
        return TipFollower(target, section.tip_follower)
    if obstacle is None:
        raise ConfigError("controller `waypoint` goes round an obstacle; give run.toml a section [obstacle]")
    if section.waypoint.release_cm < section.waypoint.guard_cm:
        raise ConfigError("[controller.waypoint]: release_cm must not be less than guard_cm")
    return Waypoint(target, obstacle, section.waypoint)


def kept_file(state_dir: Path, path: Path) -> Path:
    """Where the accepted bytes of the file at ``path`` are kept: each configured path has its own."""
    return state_dir / f"accepted-{sha256_of_bytes(os.fsencode(path))[:12]}{SUFFIX}"


def check_usable(path: Path, kept: Path, acceptance: Acceptance) -> None:
    """Whether a start finds a file to steer by, at the path or kept from before; changes nothing.

    Raises:
        BadController: it does not.
    """
    try:
        acceptance.check(load_controller(path), offered=False)
    except BadController as problem:
        _kept_before(kept, acceptance, problem)


def _kept_before(kept: Path, acceptance: Acceptance, problem: BadController | StoreError) -> LoadedController:
    """The file that was accepted last; the problem is raised where there is none."""
    try:
        loaded = parse_controller(kept.read_bytes(), where=str(kept))
        acceptance.check_kept(loaded, offered=False)
    except (OSError, BadController):
        raise problem from None
    return loaded


class FixedSource:
    """A built-in rule or a light plan: nothing replaces it while the service runs."""

    def __init__(self, steering: Steering) -> None:
        self.steering = steering
        self.refusal = ""

    def poll(self) -> bool:
        return False


class FileSource:
    """A controller file.

    Args:
        path: the file, or a link to it.
        kept: where the bytes that were accepted last are kept.
        acceptance: what a file must pass.

    Attributes:
        steering: the rule now in force.

    Raises:
        BadController: it must not steer, and none was accepted before.
        StoreError: that it is accepted cannot be written down, and none was accepted before.
    """

    def __init__(self, path: Path, kept: Path, acceptance: Acceptance) -> None:
        self._path = path
        self._kept = kept
        self._acceptance = acceptance
        self._refused = ""
        self._not_kept = ""
        self._stamp = _stamp_of(path)
        try:
            self.steering = self._accepted(load_controller(path))
            self._keep()
        except (BadController, StoreError) as problem:
            self.steering = self._evolved(_kept_before(kept, acceptance, problem))
            self._refuse(problem)

    @property
    def refusal(self) -> str:
        """Why what lies at ``path`` now is not in force, or would not outlive a restart; empty where all is well."""
        return "; ".join(part for part in (self._refused, self._not_kept) if part)

    def poll(self) -> bool:
        """Look at the file; True where another rule has taken over."""
        has_changed = self._look()
        if has_changed or self._not_kept:  # the disk may have room by now
            self._keep()
        return has_changed

    def _look(self) -> bool:
        stamp = _stamp_of(self._path)
        if stamp == self._stamp:
            return False
        self._stamp = stamp
        try:
            steering = self._accepted(load_controller(self._path))
        except (BadController, StoreError) as problem:
            self._refuse(problem)
            return False
        self._refused = ""
        is_other = steering.sha256 != self.steering.sha256
        self.steering = steering
        return is_other

    def _refuse(self, problem: BadController | StoreError) -> None:
        self._refused = f"refused, the one before goes on: {problem}"
        if isinstance(problem, StoreError):
            self._stamp = None  # the file is good: it is tried again until the disk takes it

    def _accepted(self, loaded: LoadedController) -> Evolved:
        self._acceptance.take(loaded, self._acceptance.check(loaded, offered=False))
        return self._evolved(loaded)

    def _evolved(self, loaded: LoadedController) -> Evolved:
        policy = self._acceptance.policy
        return Evolved(loaded, policy.target, policy.obstacle, self._path.name)

    def _keep(self) -> None:
        try:
            if not self._kept.is_file() or sha256_of_bytes(self._kept.read_bytes()) != self.steering.sha256:
                write_bytes(self._kept, self.steering.loaded.data)
        except (OSError, StoreError) as problem:
            self._not_kept = f"in force, but a copy cannot be kept: {problem}"
        else:
            self._not_kept = ""


def _stamp_of(path: Path) -> _Stamp | None:
    """Changes whenever the file, or what the link leads to, is replaced or written to; None where there is none."""
    try:
        status = os.stat(path)  # noqa: PTH116 - all five fields of one look
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
