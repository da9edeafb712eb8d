"""``[uploader]``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec

from flora_common.config import RigSection
from flora_common.errors import ConfigError
from flora_uploader.scan import SpoolUnreadable, is_run_folder, real_path
from flora_uploader.target import FolderTarget

SWITCHED_OFF: Final = "switched off: [uploader] target is empty"

Seconds = Annotated[float, msgspec.Meta(ge=0.1, le=1e6)]


class UploaderSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where files of record go, and how."""

    target: Annotated[str, msgspec.Meta(description="folder, local or mounted; empty switches uploading off")] = ""
    marker: Annotated[
        str,
        msgspec.Meta(
            pattern=r"^[^/\x00]*$",
            extra={"words": "the name of a file, without /"},
            max_length=200,
            description="file that must be at the target, or nothing is written; empty for no check",
        ),
    ] = ".flora-nas"
    runs_dir: Annotated[
        str, msgspec.Meta(description="folder with run folders; empty for the one that holds the rig's run_dir")
    ] = ""
    table_every_s: Annotated[Seconds, msgspec.Meta(description="growing tables go again after so many seconds")] = 600.0
    scan_every_s: Annotated[Seconds, msgspec.Meta(description="the present run is looked through so often")] = 30.0
    stop_within_s: Annotated[
        float, msgspec.Meta(ge=0.0, le=60.0, description="time at a polite stop for what is not sent yet")
    ] = 5.0
    keep_percent_free: Annotated[
        float, msgspec.Meta(ge=0.0, le=99.0, description="stored photographs make room up to here; 0: never")
    ] = 10.0
    recheck_per_hour: Annotated[
        float, msgspec.Meta(ge=0.0, le=100_000.0, description="files read again at the target; 0: none")
    ] = 120.0


def runs_dir(rig: RigSection, config: UploaderSection) -> Path:
    """The spool."""
    return Path(config.runs_dir) if config.runs_dir else Path(rig.run_dir).absolute().parent


def check(rig: RigSection, config: UploaderSection) -> None:
    """Whether the target can be one; see :func:`make_target`."""
    if config.target:
        make_target(rig, config)


def make_target(rig: RigSection, config: UploaderSection) -> FolderTarget:
    """The target of a configuration.

    Raises:
        ConfigError: it lies where copies would be copied again, or be the originals themselves.
    """
    target = real_path(Path(config.target))
    spool = real_path(runs_dir(rig, config))
    if not Path(config.target).is_absolute():
        raise ConfigError(f"[uploader] target `{config.target}`: must be an absolute path")
    if target == spool:
        raise ConfigError(f"[uploader] target {target}: is the folder of the runs itself; choose another one")
    for folder in (target, *target.parents):
        if folder == real_path(Path(rig.run_dir)) or (folder.parent == spool and _is_run_folder(folder)):
            raise ConfigError(f"[uploader] target {target}: lies inside the run folder {folder}; choose another one")
    return FolderTarget(Path(config.target), config.marker)


def _is_run_folder(folder: Path) -> bool:
    try:
        return is_run_folder(folder)
    except SpoolUnreadable:  # a dead mount is no reason not to start: it is told when the target is asked
        return False
