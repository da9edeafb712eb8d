"""What can be known of ``[capture] source`` before a camera is opened: no OpenCV is loaded for it."""

from __future__ import annotations

import re
from pathlib import Path

from flora_common.errors import BadRunFolder, ConfigError
from flora_common.runs import RunFolder


def device_number(source: str) -> int | None:
    """The V4L2 camera's number for ``2`` and ``/dev/video2``; None for a film."""
    device = re.fullmatch(r"(?:/dev/video)?(\d+)", source)
    return int(device[1]) if device else None


def pictures_of(run: RunFolder) -> list[Path]:
    """The photographs of a run folder in the order of its ``frames.csv``.

    Raises:
        BadRunFolder: no such folder, a damaged table, or none of its photographs is there.
    """
    if not run.path.is_dir():
        raise BadRunFolder(f"{run.path}: no such run folder")
    pictures = [run.path / row.file for row in run.read_frames()]
    if not any(picture.is_file() for picture in pictures):
        what = "none of its photographs is there" if pictures else "it lists no photographs"
        raise BadRunFolder(f"{run.frames_csv}: {what}")
    return pictures


def check_source(backend: str, source: str) -> None:
    """Refuse a source that no waiting will bring: a film or run folder that is not there or holds nothing.

    A camera that is not plugged in is another matter: it may come.

    Raises:
        ConfigError: names the source.
    """
    try:
        if backend == "replay":
            pictures_of(RunFolder(Path(source)))
        elif backend == "opencv" and device_number(source) is None:
            with Path(source).open("rb") as film:
                if not film.read(1):
                    raise ConfigError(f"[capture] source {source}: an empty file, not a film")
    except BadRunFolder as problem:
        raise ConfigError(f"[capture] source: nothing to replay: {problem}") from problem
    except OSError as problem:
        raise ConfigError(f"[capture] source {source}: the film cannot be read ({problem.strerror})") from problem
