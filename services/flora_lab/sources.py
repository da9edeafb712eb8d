"""Where pictures of a plant come from: a run folder, a folder of pictures, or a film."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

import cv2
import numpy as np

from flora_common.errors import BadInput, BadPicture
from flora_common.runs import Light, RunFolder
from flora_common.shapes import Obstacle, Target
from flora_common.vision.header import picture_size
from flora_common.vision.picture import (
    PICTURE_SUFFIXES,
    Picture,
    Reduction,
    checked_array,
    read_picture,
    read_picture_bytes,
    reduce_picture,
)

FILM_SUFFIXES: Final = (".mp4", ".mov", ".avi", ".mkv", ".m4v")


@dataclass(frozen=True, slots=True)
class Frame:
    """One photograph, not yet decoded.

    Attributes:
        index: place in the whole sequence, from 0.
        name: for messages and file names.
        time_s: from ``frames.csv``; None where the source does not know.
        light: likewise.
        load: decodes at 1/reduction of the size; raises BadPicture.
    """

    index: int
    name: str
    time_s: float | None
    light: Light | None
    load: Callable[[Reduction], Picture]
    covariates: dict[str, float] = field(default_factory=dict)


class Source(Protocol):
    """A sequence of photographs that can be gone through more than once."""

    @property
    def name(self) -> str: ...
    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the full pictures."""
        ...

    @property
    def count(self) -> int: ...
    def frames(self) -> Iterator[Frame]: ...


class RunSource:
    """The photographs of a run folder, with everything that ``run.toml`` and ``frames.csv`` say."""

    def __init__(self, path: Path) -> None:
        self.folder = RunFolder(path)
        self.run = self.folder.read_run_file()
        self.rows = self.folder.read_frames()
        self.name = str(path)
        self.size_px = (self.run.camera.width_px, self.run.camera.height_px)
        self.count = len(self.rows)
        if not self.rows:
            raise BadInput(f"{self.folder.frames_csv}: lists no frames; nothing to track")

    @property
    def obstacle(self) -> Obstacle | None:
        return self.run.obstacle_or_none()

    @property
    def target(self) -> Target | None:
        return self.run.target_or_none()

    def frames(self) -> Iterator[Frame]:
        for i, row in enumerate(self.rows):
            load = _file_loader(self._find(row.file), self.size_px)
            yield Frame(i, row.file, row.time_s, row.light, load, row.covariates)

    def _find(self, file: str) -> Path:
        """``file`` is relative to the run folder, or to its ``frames/``."""
        in_run = self.folder.path / file
        return in_run if in_run.exists() else self.folder.frames / file


class FolderSource:
    """The pictures in a folder, in the order of their names; all of the first one's size."""

    def __init__(self, path: Path) -> None:
        self.files = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
        if not self.files:
            raise BadInput(f"{path}: holds neither run.toml nor pictures ({', '.join(PICTURE_SUFFIXES)})")
        self.name = str(path)
        self.count = len(self.files)
        self.size_px = self._first_size()

    def frames(self) -> Iterator[Frame]:
        for i, file in enumerate(self.files):
            yield Frame(i, file.name, None, None, _file_loader(file, self.size_px))

    def _first_size(self) -> tuple[int, int]:
        first: BadPicture | None = None
        for file in self.files:
            try:
                return picture_size(read_picture_bytes(file), where=str(file))
            except BadPicture as problem:
                first = first or problem
        raise BadPicture(f"none of the {self.count} pictures can be used; the first: {first}")


class FilmSource:
    """The frames of a film file, decoded in order by OpenCV."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = str(path)
        self.count = 0
        self.size_px = (0, 0)
        for picture in self._pictures():
            self.size_px = self.size_px if self.count else (picture.shape[1], picture.shape[0])
            self.count += 1
        if self.count == 0:
            raise BadInput(f"{path}: no frame of it can be decoded; not a film, or damaged")

    def frames(self) -> Iterator[Frame]:
        for i, picture in enumerate(self._pictures()):
            yield Frame(i, f"frame {i:05d}", None, None, _array_loader(picture, f"{self.path} frame {i}", self.size_px))

    def _pictures(self) -> Iterator[Picture]:
        # OpenCV and its film reader write complaints of their own to stderr, beside the one line that we owe.
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        log = cv2.utils.logging
        level = log.setLogLevel(log.LOG_LEVEL_SILENT)
        try:
            film = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        finally:
            log.setLogLevel(level)
        try:
            while True:
                there, picture = film.read()
                if not there:
                    return
                yield np.asarray(picture, dtype=np.uint8)
        finally:
            film.release()


def open_source(path: Path) -> RunSource | FolderSource | FilmSource:
    """What kind of input ``path`` is, opened.

    Raises:
        BadInput: nothing there, or nothing that can be tracked.
    """
    if path.is_dir():
        return RunSource(path) if (path / "run.toml").exists() else FolderSource(path)
    if not path.exists():
        raise BadInput(f"{path}: no such run folder, folder of pictures or film")
    if path.suffix.lower() in FILM_SUFFIXES:
        return FilmSource(path)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        raise BadInput(f"{path}: a single picture; give the folder that holds the sequence")
    raise BadInput(f"{path}: neither a run folder, a folder of pictures, nor a film ({', '.join(FILM_SUFFIXES)})")


def _file_loader(file: Path, size_px: tuple[int, int]) -> Callable[[Reduction], Picture]:
    return lambda reduction: read_picture(file, expected_size=size_px, reduction=reduction)


def _array_loader(picture: Picture, where: str, size_px: tuple[int, int]) -> Callable[[Reduction], Picture]:
    def load(reduction: Reduction) -> Picture:
        checked_array(picture, where=where)
        if (picture.shape[1], picture.shape[0]) != size_px:
            raise BadPicture(
                f"{where}: is {picture.shape[1]}x{picture.shape[0]} px, the first is {size_px[0]}x{size_px[1]}"
            )
        return reduce_picture(picture, reduction)

    return load
