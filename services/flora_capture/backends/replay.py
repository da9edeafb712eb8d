"""The photographs of an old run, in their order, as if a camera took them now."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

from flora_capture.backends import FilmEnded
from flora_capture.source import pictures_of
from flora_capture.wire import CameraSettings, Request
from flora_common.counted import counted
from flora_common.errors import BadPicture, BadRunFolder, CameraGone
from flora_common.runs import RunFolder


class ReplayCamera:
    """Counts by the photographs that the present run has: a restart goes on where it was."""

    def __init__(self, settings: CameraSettings) -> None:
        run = RunFolder(Path(settings.source))
        try:
            self._files = pictures_of(run)
        except BadRunFolder as problem:
            raise CameraGone(f"nothing to replay: {problem}") from problem
        self._run = run
        self._metadata = _metadata(run)

    def shoot(self, request: Request) -> tuple[bytes, dict[str, Any]]:
        if request.index >= len(self._files):
            raise FilmEnded(f"{self._run.path}: the run has ended after {counted(len(self._files), 'picture')}")
        file = self._files[request.index]
        try:
            jpeg = file.read_bytes()
        except OSError as problem:
            raise BadPicture(f"{file}: cannot be read ({problem.strerror})") from problem
        return jpeg, self._metadata.get(str(file.relative_to(self._run.path)), {})

    def close(self) -> None:
        """Nothing is open."""


def _metadata(run: RunFolder) -> dict[str, dict[str, Any]]:
    """Metadata by file, from ``frames.jsonl`` where the run has one."""
    found: dict[str, dict[str, Any]] = {}
    if run.frames_log.is_file():
        for line in run.frames_log.read_text(encoding="utf-8", errors="replace").splitlines():
            with contextlib.suppress(ValueError, KeyError, TypeError):
                record = json.loads(line)
                found[str(record["file"])] = dict(record["metadata"])
    return found


def open_camera(settings: CameraSettings) -> ReplayCamera:
    return ReplayCamera(settings)
