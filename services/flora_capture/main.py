"""flora-capture: one photograph per tick, by a camera process that may hang and be killed."""

from __future__ import annotations

from collections.abc import Sequence

from flora_capture.service import CaptureSection, CaptureService
from flora_capture.source import check_source
from flora_capture.store import Store
from flora_common.app import App
from flora_common.config import RigSection
from flora_common.errors import ConfigError
from flora_common.lock import AlreadyHeld, hold_folder
from flora_common.runs import RunFolder
from flora_common.service import run_service


def check(_: RigSection, config: CaptureSection) -> None:
    """Whether there is something to take pictures of; see :func:`check_source`."""
    check_source(config.backend, config.source)


def hold_run(run: RunFolder) -> None:
    """Keep the run folder, until this process ends, from a second rig that was given the same one.

    Each has a state folder of its own, and so both would start; their photographs could not be told apart afterwards.

    Raises:
        ConfigError: a second rig is what this is.
    """
    try:
        hold_folder(run.path)
    except AlreadyHeld:
        raise ConfigError(
            f"[rig] run_dir {run.path}: the flora-capture of another rig writes there; give each rig a run folder"
        ) from None
    except OSError as problem:
        raise ConfigError(f"[rig] run_dir {run.path}: cannot be opened ({problem.strerror})") from problem


def build(app: App[CaptureSection]) -> None:
    camera = app.run.read_run_file().camera
    hold_run(app.run)
    store = Store(app.run)
    if store.mended:
        app.log.warning("table_mended", reason=store.mended)
    CaptureService(app, store, app.config.settings(camera, app.rig.clock.twin))


def main(argv: Sequence[str] | None = None) -> int:
    return run_service(
        "flora-capture",
        CaptureSection,
        build,
        argv=argv,
        check=check,
        description="One photograph per tick: taken, checked, stored, announced.",
    )
