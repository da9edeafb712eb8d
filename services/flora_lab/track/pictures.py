"""Pictures to look at before a track is believed: a folder of overlays, a contact sheet, a film."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final

import cv2
import numpy as np

from flora_common import files, outputs
from flora_common.errors import BadInput, StoreError
from flora_common.vision import draw
from flora_common.vision.picture import Picture
from flora_lab.option_values import must_not
from flora_lab.sources import Source
from flora_lab.track.drawing import DrawReadings, DrawTask, View, plant_view, whole
from flora_lab.track.pool import Pool
from flora_lab.track.readings import Reading
from flora_lab.track.tables import readings_text

SHEET_PICTURES: Final = 20
SHEET_AT_MOST: Final = 100
SHEET_COLUMNS: Final = 5
SHEET_TILE_PX: Final = 400
FILM_LONGEST_PX: Final = 800
FILM_PER_S: Final = 12
LEAST_WIDTH_PX: Final = 1280
"""Smaller photographs are enlarged before drawing: a line one pixel wide would hide a stem two pixels wide."""
SHEET_SUFFIXES: Final = (".png", ".jpg", ".jpeg")
FILM_CODES: Final = {".mp4": "mp4v", ".avi": "MJPG"}

OVERLAY, SHEET, FILM = "overlay", "sheet", "film"


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which pictures are asked for.

    Attributes:
        overlays: folder; must not be there.
        contact: file of the contact sheet alone.
        film: file.
        every: of every N-th frame only.
    """

    overlays: Path | None = None
    contact: Path | None = None
    film: Path | None = None
    every: int | None = None

    @property
    def any(self) -> bool:
        return any((self.overlays, self.contact, self.film))

    @property
    def paths(self) -> list[Path]:
        return [path for path in (self.overlays, self.contact, self.film) if path is not None]

    def check(self, track: Path, *, force: bool) -> None:
        """Before any work is done; ``track`` is the other output.

        Raises:
            BadInput: something is in the way, or a file name that says nothing known.
        """
        if not self.any:
            must_not("--every", self.every, "no --overlays, --contact or --film is asked for")
        if self.overlays is not None:
            outputs.must_be_new(self.overlays, "--overlays")
        places = [path.absolute() for path in (track, *self.paths)]
        if len(set(places)) < len(places):
            raise BadInput("-o, --overlays, --contact and --film must name different places")
        for path, option, suffixes, is_ours, what in (
            (self.contact, "--contact", SHEET_SUFFIXES, outputs.is_picture, "a picture"),
            (self.film, "--film", tuple(FILM_CODES), outputs.is_film, "a film"),
        ):
            if path is None:
                continue
            if path.suffix.lower() not in suffixes:
                raise BadInput(f"{option}: {path} must end with {' or '.join(suffixes)}")
            outputs.check_file(path, force=force, is_ours=is_ours, what=what, option=option)

    def check_apart(self, track: Path, source: Source) -> None:
        """Whether the input stays what it is; ``track`` is the other output.

        Raises:
            BadInput: a track, contact sheet or film that is one of the input's own files, or a contact sheet or
                overlays that would be taken for photographs the next time.
        """
        outputs.check_apart([track, *self.paths], source.files)
        own = {folder.resolve() for folder in source.picture_folders}
        for path, option, folder in (
            (self.overlays, "--overlays", self.overlays),
            (self.contact, "--contact", self.contact and self.contact.parent),
        ):
            if folder is not None and folder.resolve() in own:
                raise BadInput(
                    f"{path}: would lie among the photographs of the input; name another place with {option}"
                )


class Pictures:
    """Draws all that is wanted beside its final place, where :meth:`finish` puts it. A context manager.

    Without :meth:`finish` nothing is left behind; what a killed process left goes with the next drawing of the same.
    """

    def __init__(self, wanted: Wanted, readings: Sequence[Reading], drawing: DrawReadings) -> None:
        self._wanted, self._readings, self._drawing = wanted, readings, drawing
        self._parts: list[tuple[Path, Path]] = []
        self._folders = contextlib.ExitStack()
        self._film: _Film | None = None
        self._tiles: list[Picture] = []
        self._captions: list[str] = []
        self._shown = _shown_in(wanted, len(readings))

    @property
    def count(self) -> int:
        """How many photographs will be drawn."""
        return len(self._shown)

    def __enter__(self) -> Pictures:
        with contextlib.ExitStack() as folders:  # undone where an error or a signal comes in between
            for path in self._wanted.paths:
                beside = folders.enter_context(files.folder_beside(path))
                self._parts.append((beside / path.name, path))
            if self._wanted.overlays is not None:
                self._part_of(self._wanted.overlays).mkdir()
            self._folders = folders.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._film is not None:
            self._film.close()
        self._folders.close()

    def draw(self, source: Source, pool: Pool, *, on_picture: Callable[[], None] = lambda: None) -> None:
        """Draw everything.

        Raises:
            StoreError: a picture or film that could not be encoded or written.
        """
        views = self._views()
        order: list[tuple[Reading, list[str]]] = []
        by_index = {self._readings[place].index: place for place in self._shown}

        def tasks() -> Iterator[DrawTask]:
            for frame in source.frames():
                place = by_index.get(frame.index)
                if place is not None:
                    reading, kinds = self._readings[place], sorted(self._shown[place])
                    order.append((reading, kinds))
                    yield DrawTask(frame.picture, reading, tuple(views[kind] for kind in kinds))

        for number, drawings in enumerate(pool.map(self._drawing, tasks())):
            reading, kinds = order[number]
            for kind, picture in zip(kinds, drawings, strict=False):  # none of a bad picture
                self._keep(kind, reading, picture)
            on_picture()
        if self._film is not None:
            self._film.finish()

    def finish(self) -> None:
        """Put everything in its place."""
        if self._tiles:
            sheet = draw.contact_sheet(self._tiles, columns=SHEET_COLUMNS, captions=self._captions)
            if self._wanted.overlays is not None:
                _write(self._part_of(self._wanted.overlays) / "contact.png", sheet)
            if self._wanted.contact is not None:
                _write(self._part_of(self._wanted.contact), sheet)
        if self._wanted.overlays is not None:
            files.write_text(self._part_of(self._wanted.overlays) / "readings.csv", readings_text(self._readings))
        for part, final in self._parts:
            if not part.exists():
                raise BadInput(
                    f"{final}: none of the photographs chosen for it can be used; choose others with --every, "
                    "which goes on from what was read"
                )
        for part, final in self._parts:
            part.replace(final)
            files.fsync_folder(final.parent)

    def _views(self) -> dict[str, View]:
        camera = self._drawing.camera
        shown = [self._readings[place] for place in self._shown]
        return {
            OVERLAY: whole((camera.width_px, camera.height_px), least_width_px=LEAST_WIDTH_PX),
            SHEET: plant_view(shown, camera, longest_px=SHEET_TILE_PX, caption=False),
            FILM: plant_view(shown, camera, longest_px=FILM_LONGEST_PX, caption=True),
        }

    def _keep(self, kind: str, reading: Reading, picture: Picture) -> None:
        if kind == SHEET:
            self._tiles.append(picture)
            self._captions.append(f"{reading.index}: {reading.time_s / 3600:.1f} h {reading.stem.outcome}")
        elif kind == FILM:
            assert self._wanted.film is not None
            if self._film is None:
                self._film = _Film(self._part_of(self._wanted.film), self._wanted.film, picture)
            self._film.add(picture)
        else:
            assert self._wanted.overlays is not None
            name = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(reading.name).stem)
            _write(self._part_of(self._wanted.overlays) / f"{reading.index:05d}_{name}.jpg", picture)

    def _part_of(self, final: Path) -> Path:
        return next(part for part, path in self._parts if path == final)


class _Film:
    def __init__(self, part: Path, final: Path, first: Picture) -> None:
        self._part, self._final = part, final
        self._written = 0
        self._size = (first.shape[1], first.shape[0])
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # else it writes to stderr beside the one line we owe
        code = cv2.VideoWriter.fourcc(*FILM_CODES[final.suffix.lower()])
        log = cv2.utils.logging
        level = log.setLogLevel(log.LOG_LEVEL_SILENT)
        try:
            self._writer = cv2.VideoWriter(str(part), code, FILM_PER_S, self._size)
        finally:
            log.setLogLevel(level)
        if not self._writer.isOpened():
            raise StoreError(f"{final}: this OpenCV cannot write such a film; try --film with the ending .avi")

    def add(self, picture: Picture) -> None:
        self._writer.write(picture)
        self._written += 1

    def finish(self) -> None:
        """Close the file and look whether all is in it: the writer itself never says that the disk was full."""
        self._writer.release()
        film = cv2.VideoCapture(str(self._part))
        count = film.get(cv2.CAP_PROP_FRAME_COUNT) if film.isOpened() else 0
        film.release()
        if count != self._written:
            raise StoreError(
                f"{self._final}: only {count:.0f} of {self._written} frames were written; is the disk full?"
            )
        with self._part.open("rb") as file:
            os.fsync(file.fileno())

    def close(self) -> None:
        self._writer.release()


def _shown_in(wanted: Wanted, count: int) -> dict[int, set[str]]:
    """By place in the sequence, for what it is drawn."""
    shown: dict[int, set[str]] = {}

    def want(kind: str, places: Sequence[int]) -> None:
        for place in places:
            shown.setdefault(place, set()).add(kind)

    regular = range(0, count, wanted.every or 1)
    if wanted.overlays is not None:
        want(OVERLAY, regular)
    if wanted.film is not None:
        want(FILM, regular)
    if wanted.overlays is not None or wanted.contact is not None:
        want(SHEET, _evenly(range(count), SHEET_PICTURES) if wanted.every is None else _evenly(regular, SHEET_AT_MOST))
    return dict(sorted(shown.items()))


def _evenly(places: range, most: int) -> list[int]:
    if not places:
        return []
    return [places[round(float(k))] for k in np.linspace(0, len(places) - 1, min(most, len(places)))]


def _write(path: Path, picture: Picture) -> None:
    settings = [] if path.suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 90]
    done, data = cv2.imencode(path.suffix, picture, settings)
    if not done:
        raise StoreError(f"{path}: OpenCV could not encode the picture")
    files.write_bytes(path, data.tobytes())
