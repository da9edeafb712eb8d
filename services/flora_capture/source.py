"""What can be known of ``[capture] source`` before a camera is opened: no OpenCV is loaded for it."""

from __future__ import annotations

import os
import re
from pathlib import Path

from flora_common.errors import BadRunFolder, ConfigError
from flora_common.runs import RunFolder
from flora_common.suggest import clipped


def device_number(source: str) -> int | None:
    """The V4L2 camera's number for ``2``, ``/dev/video2`` and a link to that.

    Links such as those in ``/dev/v4l/by-id`` name the same camera after each start, numbers do not.

    Returns:
        None for a film, and for a link of a camera that is not plugged in.
    """
    device = re.fullmatch(r"\d+", source, re.ASCII) or re.fullmatch(r"/dev/video(\d+)", os.path.realpath(source))
    return int(device[device.lastindex or 0]) if device else None


def is_device(source: str) -> bool:
    """Whether this names a V4L2 camera, plugged in or not."""
    return device_number(source) is not None or source.startswith("/dev/")


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
    """Refuse a source that no waiting will bring: a film or run folder that is not there or holds nothing, and what is
    no number of a Pi camera.

    A camera that is not plugged in is another matter: it may come.

    Raises:
        ConfigError: names the source.
    """
    try:
        if backend == "picamera2" and not re.fullmatch(r"\d*", source, re.ASCII):
            raise ConfigError(
                f"[capture] source {clipped(source)}: not the number of a Pi camera, 0 for the first one; "
                'a USB camera needs backend = "opencv"'
            )
        if backend == "replay":
            pictures_of(RunFolder(Path(source)))
        elif backend == "opencv" and not is_device(source):
            with Path(source).open("rb") as film:
                if not film.read(1):
                    raise ConfigError(f"[capture] source {source}: an empty file, not a film")
    except BadRunFolder as problem:
        raise ConfigError(f"[capture] source: nothing to replay: {problem}") from problem
    except OSError as problem:
        raise ConfigError(f"[capture] source {source}: the film cannot be read ({problem.strerror})") from problem
