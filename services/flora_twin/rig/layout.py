"""Where a virtual rig lives on the disk: one folder that holds everything, and nothing outside it but its sockets."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import tomli_w

from flora_common.errors import BadInput
from flora_common.files import make_folder, shown, write_text
from flora_common.lock import AlreadyHeld, hold
from flora_common.paper_experiment import REALITY_OBSTACLE, REALITY_TARGET
from flora_common.runs import ObstacleSection, RunFile, RunFolder, TargetSection, run_file_text
from flora_common.shapes import Obstacle, Target

RESULTS: Final = ("rig", "report.html", "strip.png", "strip.jpg", "outcome.json", "asked.controller.json")
"""All that a virtual rig's run may leave in its folder."""
MARKER: Final = ".flora-rig"
"""Marks a folder as one of ours, and says which command made it: only such a folder is ever emptied."""
LOCK_FILE: Final = "lock"
RIG_FOLDER: Final = "rig"
"""Of a folder of results: the rig that they are from."""
_MAKER_UNTOLD: Final = "a virtual rig"


@dataclass(frozen=True, slots=True)
class Layout:
    """Paths of one virtual rig."""

    root: Path
    sockets: Path
    run_name: str = "bean"

    @property
    def config(self) -> Path:
        return self.root / "flora.toml"

    @property
    def run(self) -> RunFolder:
        return RunFolder(self.root / "runs" / self.run_name)

    @property
    def state_dir(self) -> Path:
        return self.root / "state"

    @property
    def box_dir(self) -> Path:
        """The grow box's own memory and the truth about each photograph."""
        return self.root / "box"

    @property
    def nas(self) -> Path:
        return self.root / "nas"

    @property
    def logs(self) -> Path:
        return self.root / "logs"

    @property
    def box_address(self) -> str:
        return f"ipc://{self.sockets}/box"


@contextlib.contextmanager
def claimed(out: Path, made_by: str) -> Iterator[Path]:
    """Hold a folder of results for this process, and give the folder in it for the rig: nothing is removed yet.

    Args:
        out: new, of the same command, or without any of :data:`RESULTS`; whatever else is there is left as it is.
        made_by: the command.

    Raises:
        BadInput: it holds something else, cannot be written, another process is at work there, or no configuration
            can name it.
    """
    _check_name(out)
    _check_maker(out, made_by)
    root = out / RIG_FOLDER
    try:
        make_folder(root)
        if not (root / MARKER).exists():
            write_text(root / MARKER, f"made by {made_by}; this folder is emptied when the next rig is made here\n")
        lock = hold(root / LOCK_FILE)
    except AlreadyHeld as by:
        raise BadInput(
            f"{out}: another flora-twin (pid {by.pid}) is at work there; choose another folder, or wait for its end"
        ) from None
    except OSError as problem:
        raise BadInput(f"{out}: cannot be written ({problem.strerror})") from problem
    try:
        yield root
    finally:
        os.close(lock)


def _check_name(out: Path) -> None:
    path = str(out.resolve())
    if path != shown(path):
        raise BadInput(f"{path}: is not UTF-8 text, which a rig's configuration is; choose another folder")


def _check_maker(out: Path, made_by: str) -> None:
    if not out.is_dir():
        if out.exists() or out.is_symlink():
            raise BadInput(f"{out}: is there already and no folder; choose another one")
        return
    if not any((out / name).exists() for name in RESULTS):
        return  # what else is there is not touched
    try:
        said = (out / RIG_FOLDER / MARKER).read_text(encoding="utf-8", errors="replace")
    except OSError:
        raise BadInput(f"{out}: holds other files; choose an empty or a new folder") from None
    maker = said.partition(";")[0].removeprefix("made by ")
    if maker not in (made_by, _MAKER_UNTOLD):
        raise BadInput(f"{out}: was made by `{maker[:60]}` and is not replaced; choose an empty or a new folder")


def make_layout(root: Path, run_file: RunFile, *, sections: dict[str, dict[str, Any]] | None = None) -> Layout:
    """An empty virtual rig under ``root``, ready to start.

    Args:
        root: its folder; an older virtual rig in it is replaced.
        run_file: ``run.toml`` of the run.
        sections: keys that differ from the virtual rig's defaults, by section.

    Raises:
        BadInput: ``root`` holds something that is not a virtual rig.
    """
    if root.exists() and any(root.iterdir()):
        if not (root / MARKER).is_file():
            raise BadInput(f"{root}: holds other files; choose an empty or a new folder")
        _empty(root)
    else:
        make_folder(root)
        write_text(root / MARKER, f"{_MAKER_UNTOLD}; this folder is emptied when the next one is made here\n")
    # Socket paths are limited to 107 bytes, wherever the rig's folder lies.
    layout = Layout(root.resolve(), Path(tempfile.mkdtemp(prefix="flora-")))
    for folder in (layout.run.path, layout.state_dir, layout.box_dir, layout.nas, layout.logs):
        make_folder(folder)
    write_text(layout.run.run_toml, run_file_text(run_file))
    write_text(layout.nas / ".flora-nas", "the virtual rig's NAS\n")
    tables = _default_sections(layout, run_file)
    for name, keys in (sections or {}).items():
        tables.setdefault(name, {}).update(keys)
    write_text(layout.config, tomli_w.dumps(tables))
    return layout


def _empty(root: Path) -> None:
    """Remove an older rig; whose the folder is, and the lock, stay: who removed a lock would let two hold one each."""
    for entry in root.iterdir():
        if entry.name in (MARKER, LOCK_FILE):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _default_sections(layout: Layout, run_file: RunFile) -> dict[str, dict[str, Any]]:
    box = layout.box_address
    return {
        "rig": {
            "name": run_file.rig,
            "run_dir": str(layout.run.path),
            "state_dir": str(layout.state_dir),
            "bus_publish": f"ipc://{layout.sockets}/bus-publish",
            "bus_subscribe": f"ipc://{layout.sockets}/bus-subscribe",
            "health_every_s": 2.0,
            "clock": {"kind": "twin", "twin": box},
        },
        "flash": {"backend": "virtual", "twin": box, "wait_for_background": True},
        "capture": {"backend": "virtual", "twin": box},
        "led": {"backend": "virtual", "twin": box},
        "controller": {"use": "waypoint"},
        "uploader": {"target": str(layout.nas)},
    }


def remove_sockets(layout: Layout) -> None:
    """Leave nothing outside the rig's folder."""
    shutil.rmtree(layout.sockets, ignore_errors=True)


def with_task(run_file: RunFile, target: Target = REALITY_TARGET, obstacle: Obstacle = REALITY_OBSTACLE) -> RunFile:
    """The run's task: target and obstacle, those of the paper's reality experiment where none are given."""
    return msgspec.structs.replace(
        run_file,
        target=TargetSection(target.x_cm, target.y_cm, target.radius_cm),
        obstacle=ObstacleSection(obstacle.x_cm, obstacle.y_cm, obstacle.width_cm, obstacle.height_cm),
    )
