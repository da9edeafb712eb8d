"""A folder that its user may not look into, as `sudo install -d -m 700` leaves it: told in a line by who needs it."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flora_common import config
from flora_common.app import App
from flora_common.config import RigSection, load_config
from flora_common.errors import ConfigError, NotPermitted
from flora_common.runs import RunFolder
from flora_controller.core import ControllerSection
from flora_controller.main import build, check
from flora_dashboard.history import History
from flora_recorder.main import place_check


@pytest.fixture
def closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder in a folder that only its owner may enter; for the tests' user may be root."""
    outer = tmp_path / "runs"
    (outer / "bean").mkdir(parents=True)
    really = os.stat

    def refusing(path: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if isinstance(path, str | Path) and outer in Path(path).parents:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return really(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", refusing)
    return outer / "bean"


def test_whoever_needs_it_is_told_in_a_line_and_others_are_not_held_up(closed: Path) -> None:
    run, section = RunFolder(closed), ControllerSection()
    app: Any = SimpleNamespace(run=run)
    with pytest.raises(NotPermitted, match="bean: may not be looked into by this user; for services: sudo chown"):
        run.read_run_file()
    with pytest.raises(NotPermitted):
        build(app)
    assert App._tick_s(app) == 300.0
    check(RigSection(run_dir=str(closed)), section)
    place_check(run)()
    history = History(None)
    history.read(run)
    assert history.end == 0


def test_a_configuration_in_such_a_folder_is_not_taken_for_none(closed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "DEFAULT_CONFIG", closed / "flora.toml")

    def refuse(_: Path) -> bytes:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(ConfigError, match=r"flora\.toml: cannot be read \(Permission denied\)"):
        load_config(None, "controller", ControllerSection)
