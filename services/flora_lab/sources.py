"""Where pictures of a plant come from: a run folder, a folder of pictures, or a film."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

import cv2
import numpy as np

from flora_common import files
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
from flora_lab.asides import aside

FILM_SUFFIXES: Final = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm")


@dataclass(frozen=True, slots=True)
class PictureFile:
    """A photograph in a file of its own; may be decoded in any thread.

    Attributes:
        sha256: of the file when the photograph was taken; None where nobody has noted it.
        size_from: the file that tells the size; None where it is that of the first photograph.
    """

    path: Path
    size_px: tuple[int, int]
    sha256: str | None = None
    size_from: Path | None = None

    def load(self, reduction: Reduction) -> Picture:
        """Decode at 1/reduction of the size; raises BadPicture, also where the file is not what was taken."""
        try:
            return read_picture(self.path, expected_size=self.size_px, reduction=reduction, sha256=self.sha256)
        except BadPicture as problem:
            if self.size_from is None or self._has_the_size():
                raise
            raise BadPicture(f"{problem} by width_px and height_px in {self.size_from}") from problem

    def _has_the_size(self) -> bool:
        """Whether its size is the expected one, or cannot be known."""
        try:
            return picture_size(read_picture_bytes(self.path), where=str(self.path)) == self.size_px
        except BadPicture:
            return True


@dataclass(frozen=True, slots=True, eq=False)
class FilmPicture:
    """A frame of a film, which can only be decoded in order and is therefore carried along."""

    picture: Picture
    where: str
    size_px: tuple[int, int]

    def load(self, reduction: Reduction) -> Picture:
        """At 1/reduction of the size; raises BadPicture."""
        checked_array(self.picture, where=self.where)
        height, width = self.picture.shape[:2]
        if (width, height) != self.size_px:
            raise BadPicture(f"{self.where}: is {width}x{height} px, the first is {self.size_px[0]}x{self.size_px[1]}")
        return reduce_picture(self.picture, reduction)


@dataclass(frozen=True, slots=True)
class Frame:
    """One photograph, not yet decoded.

    Attributes:
        index: place in the whole sequence, from 0.
        name: for messages and file names.
        time_s: from ``frames.csv``; None where the source does not know.
        picture: decodes it, in any thread.
        covariates: from ``frames.csv``.
    """

    index: int
    name: str
    time_s: float | None
    picture: PictureFile | FilmPicture
    covariates: dict[str, float] = field(default_factory=dict)

    def load(self, reduction: Reduction) -> Picture:
        """Decode at 1/reduction of the size; raises BadPicture."""
        return self.picture.load(reduction)


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
    @property
    def lights(self) -> Sequence[Light] | None:
        """The lamp of every frame; None where the source does not know."""
        ...

    def frames(self) -> Iterator[Frame]: ...
    def files(self) -> Sequence[Path]:
        """Those that it is read from, pictures and tables."""
        ...

    @property
    def picture_folders(self) -> Sequence[Path]:
        """Those in which every picture is taken for one of the sequence, or of its setup."""
        ...

    def fingerprint(self) -> str:
        """Changes when the input does: over names, sizes and times of change of its files; pictures are not read."""
        ...


class RunSource:
    """The photographs of a run folder, with everything that ``run.toml`` and ``frames.csv`` say."""

    def __init__(self, path: Path) -> None:
        self.folder = RunFolder(path)
        self.run = self.folder.read_run_file(unknown=aside)
        if not self.folder.frames_csv.exists():
            raise BadInput(
                f"{self.folder.frames_csv}: is not there; write it (file,time_s,light, a line for each photograph), or "
                f"give {self.folder.frames} itself, with --anchor, --px-per-cm, --interval-s and --light-from"
            )
        self.rows = self.folder.read_frames()
        self._taken = self.folder.announced_hashes()
        self.name = str(path)
        self.size_px = (self.run.camera.width_px, self.run.camera.height_px)
        self.picture_folders = [self.folder.background, self.folder.frames]
        self.count = len(self.rows)
        lights = [row.light for row in self.rows if row.light is not None]
        self.lights: Sequence[Light] | None = lights or None
        if not self.rows:
            raise BadInput(f"{self.folder.frames_csv}: lists no frames; nothing to track")

    @property
    def obstacle(self) -> Obstacle | None:
        return self.run.obstacle_or_none()

    @property
    def target(self) -> Target | None:
        return self.run.target_or_none()

    def frames(self) -> Iterator[Frame]:
        return map(self.frame, range(self.count))

    def frame(self, index: int) -> Frame:
        """One of them, by its place from 0."""
        row = self.rows[index]
        return Frame(index, row.file, row.time_s, self._picture(self._find(row.file)), row.covariates)

    def background(self) -> list[PictureFile]:
        """Pictures of the setup without a plant, in name order."""
        return [self._picture(path) for path in self.folder.background_pictures()]

    def fingerprint(self) -> str:
        tables = self._tables()
        return _hash([*map(files.sha256_of_file, tables), *map(_state_of, self.files()[len(tables) :])])

    def files(self) -> Sequence[Path]:
        pictures = [self._find(row.file) for row in self.rows]
        return [*self._tables(), *self.folder.background_pictures(), *pictures]

    def _tables(self) -> list[Path]:
        log = self.folder.frames_log
        return [self.folder.run_toml, self.folder.frames_csv, *([log] if log.exists() else [])]

    def _picture(self, path: Path) -> PictureFile:
        taken = self._taken.get(path.relative_to(self.folder.path).as_posix())
        return PictureFile(path, self.size_px, taken, self.folder.run_toml)

    def _find(self, file: str) -> Path:
        """``file`` is relative to the run folder, or to its ``frames/``."""
        in_run, in_frames = self.folder.path / file, self.folder.frames / file
        is_told_whole = Path(file).parts[0] == self.folder.frames.name
        return in_run if in_run.exists() or (is_told_whole and not in_frames.exists()) else in_frames


class FolderSource:
    """The pictures in a folder, in the order of their names, numbers as numbers; all of the first one's size."""

    lights: Sequence[Light] | None = None

    def __init__(self, path: Path) -> None:
        # a Mac leaves `._IMG_1.JPG` beside each file that it copies to a stick
        shown = (p for p in path.iterdir() if not p.name.startswith("."))
        pictures = (p for p in shown if p.suffix.lower() in PICTURE_SUFFIXES and not p.is_dir())
        self._files = sorted(pictures, key=_in_order)
        self.picture_folders = [path]
        if not self._files:
            raise BadInput(f"{path}: holds neither run.toml nor pictures ({', '.join(PICTURE_SUFFIXES)})")
        self.name = str(path)
        self.count = len(self._files)
        self.size_px = self._first_size()
        if (path / "frames.csv").exists():
            aside(
                f"{path / 'frames.csv'} is not looked at, for there is no run.toml beside it; one with [camera] alone "
                "(anchor_px, px_per_cm, width_px, height_px) will do"
            )

    def frames(self) -> Iterator[Frame]:
        for i, file in enumerate(self._files):
            yield Frame(i, files.shown(file.name), None, PictureFile(file, self.size_px))

    def fingerprint(self) -> str:
        return _hash(map(_state_of, self._files))

    def files(self) -> Sequence[Path]:
        return self._files

    def _first_size(self) -> tuple[int, int]:
        first: BadPicture | None = None
        for file in self._files:
            try:
                return picture_size(read_picture_bytes(file), where=str(file))
            except BadPicture as problem:
                first = first or problem
        raise BadPicture(f"none of the {self.count} pictures can be used; the first: {first}")


class FilmSource:
    """The frames of a film file, decoded in order by OpenCV."""

    lights: Sequence[Light] | None = None

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = str(path)
        self.picture_folders: list[Path] = []
        self.count = 0
        self.size_px = (0, 0)
        for picture in self._pictures():
            self.size_px = self.size_px if self.count else (picture.shape[1], picture.shape[0])
            self.count += 1
        if self.count == 0:
            raise BadInput(f"{path}: no frame of it can be decoded; not a film, or damaged")

    def frames(self) -> Iterator[Frame]:
        for i, picture in enumerate(self._pictures()):
            yield Frame(i, f"frame {i:05d}", None, FilmPicture(picture, f"{self.path} frame {i}", self.size_px))

    def fingerprint(self) -> str:
        return _hash([_state_of(self.path)])

    def files(self) -> Sequence[Path]:
        return [self.path]

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


def _in_order(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts ``IMG_9.JPG`` before ``IMG_10.JPG``."""
    parts = re.split(r"([0-9]+)", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], path.name


def _state_of(path: Path) -> str:
    try:
        status = path.stat()
    except OSError as problem:
        return f"{path.resolve()}: {problem.strerror}"
    return f"{path.resolve()} {status.st_size} {status.st_mtime_ns}"


def _hash(lines: Iterable[str]) -> str:
    digest = hashlib.sha256()
    for line in lines:
        digest.update(line.encode("utf-8", "surrogateescape") + b"\0")
    return digest.hexdigest()
