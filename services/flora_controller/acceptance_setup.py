"""The checks of :mod:`flora_controller.acceptance` as a rig is configured: its keys, its disk and its clock."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from flora_common.app import App
from flora_common.clock_sync import is_right
from flora_common.errors import ConfigError, StoreError
from flora_common.shapes import Obstacle, Target
from flora_common.signing import PUBLIC_SUFFIX, read_trusted_keys
from flora_controller.acceptance import Acceptance, Policy
from flora_controller.core import ControllerSection
from flora_controller.serials import SERIALS_FILE, read_serials, write_serials

EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def policy_of(section: ControllerSection, target: Target | None, obstacle: Obstacle | None) -> Policy:
    """What this rig asks of a controller file.

    Raises:
        ConfigError: keys that cannot be read, or signatures are required and there is no key to check them with.
    """
    keys = read_trusted_keys(Path(section.keys_dir))
    if section.trust == "required" and not keys:
        raise ConfigError(
            f'[controller] trust is "required", but there is no key *{PUBLIC_SUFFIX} in keys_dir {section.keys_dir}'
        )
    return Policy(section.trust, section.task, target, obstacle, keys)


def look_only(policy: Policy, state_dir: Path) -> Acceptance:
    """The same checks for whoever wants to know what a start would say: nothing is written down, no clock asked."""
    try:
        serials = read_serials(state_dir / SERIALS_FILE)
    except StoreError:
        serials = None
    return Acceptance(policy, serials, keep=lambda _: None, utc=lambda: None)


def open_acceptance(app: App[ControllerSection], target: Target | None, obstacle: Obstacle | None) -> Acceptance:
    """What controller files must pass on this rig.

    Raises:
        ConfigError: see :func:`policy_of`.
    """
    policy, serials_file = policy_of(app.config, target, obstacle), app.state_dir / SERIALS_FILE
    try:
        serials = read_serials(serials_file)
    except StoreError as problem:
        serials = None
        app.trouble("serials", str(problem))

    def utc() -> datetime | None:
        return EPOCH + timedelta(microseconds=app.clock.utc_ns() // 1000) if is_right(app.rig.clock) else None

    return Acceptance(policy, serials, keep=lambda kept: write_serials(serials_file, kept), utc=utc)
