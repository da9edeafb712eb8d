"""The folder of pictures with the stem drawn over them that ``flora-lab track --overlays`` makes."""

from __future__ import annotations

import csv
import io
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final

import cv2
import numpy as np

from flora_common import files
from flora_common.errors import BadInput, BadPicture, StoreError
from flora_common.runs import CameraSection
from flora_common.shapes import Obstacle, Target
from flora_common.vision import draw
from flora_common.vision.paper import PaperSettings
from flora_common.vision.picture import Picture
from flora_lab.sources import Frame
from flora_lab.tracking import Reading

SHEET_PICTURES: Final = 20
SHEET_COLUMNS: Final = 5
SHEET_TILE_PX: Final = 320
SMALLEST_WIDTH_PX: Final = 960
"""Smaller pictures are enlarged before drawing: a line one pixel wide would hide a stem two pixels wide."""

READINGS_HEADER: Final = (
    "index",
    "file",
    "time_s",
    "light",
    "outcome",
    "quality",
    "tip_x_px",
    "tip_y_px",
    "tip_choice",
)


class OverlayFolder:
    """Collects overlays in a folder beside the final one, which takes its place when all is done.

    Use as a context manager; without :meth:`finish` nothing is left behind.

    Raises:
        BadInput: the folder is there and not empty.
    """

    def __init__(
        self,
        folder: Path,
        camera: CameraSection,
        settings: PaperSettings,
        *,
        frames: int,
        every: int,
        obstacle: Obstacle | None = None,
        target: Target | None = None,
    ) -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BadInput(f"{folder}: is there already and not an empty folder; name another for the overlays")
        self._folder, self._camera, self._settings = folder, camera, settings
        self._every, self._obstacle, self._target = every, obstacle, target
        self._seen = 0
        shown = min(frames, SHEET_PICTURES)
        self._on_sheet = {round(i) for i in np.linspace(0, frames - 1, shown)} if shown else set()
        self._tiles: list[Picture] = []
        self._captions: list[str] = []

    def __enter__(self) -> OverlayFolder:
        files.make_folder(self._folder.parent)
        self._part = Path(tempfile.mkdtemp(dir=self._folder.parent, prefix=f".{self._folder.name}.", suffix=".part"))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        shutil.rmtree(self._part, ignore_errors=True)

    def add(self, reading: Reading, frame: Frame) -> None:
        """Draw and keep a frame, if it is one of those wanted."""
        place = self._seen
        self._seen += 1
        wanted, on_sheet = place % self._every == 0, place in self._on_sheet
        if not (wanted or on_sheet):
            return
        try:
            picture = self._draw(reading, frame.load(1))
        except BadPicture:
            return  # reported where it was read
        if on_sheet:
            tile = self._crop(picture)
            height = max(1, round(tile.shape[0] * SHEET_TILE_PX / tile.shape[1]))
            self._tiles.append(np.asarray(cv2.resize(tile, (SHEET_TILE_PX, height), interpolation=cv2.INTER_AREA)))
            self._captions.append(f"{reading.index}: {reading.time_s / 3600:.1f} h {reading.stem.outcome}")
        if wanted:
            draw.draw_caption(picture, _caption(reading))
            name = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(reading.name).stem)
            self._write(f"{reading.index:05d}_{name}.jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 90])

    def finish(self, readings: Sequence[Reading]) -> None:
        """Write the contact sheet and the table of all readings, and put the folder in its place."""
        if self._tiles:
            sheet = draw.contact_sheet(self._tiles, columns=SHEET_COLUMNS, captions=self._captions)
            self._write("contact.png", sheet, [])
        files.write_text(self._part / "readings.csv", _readings_text(readings))
        self._part.chmod(0o755)
        self._part.replace(self._folder)
        files.fsync_folder(self._folder.parent)

    def _draw(self, reading: Reading, picture: Picture) -> Picture:
        larger = max(1, round(SMALLEST_WIDTH_PX / picture.shape[1]))
        if larger > 1:
            size = (picture.shape[1] * larger, picture.shape[0] * larger)
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        return draw.overlay(
            picture,
            self._camera,
            points_cm=reading.stem.points_cm,
            obstacle=self._obstacle,
            target=self._target,
            light=reading.light,
        )

    def _crop(self, picture: Picture) -> Picture:
        """What the contact sheet shows: the window and a fifth around it, where one was given."""
        if self._settings.window_px is None:
            return picture
        scale = picture.shape[1] / self._camera.width_px
        x0, y0, x1, y1 = (v * scale for v in self._settings.window_px)
        rim_x, rim_y = 0.2 * (x1 - x0), 0.2 * (y1 - y0)
        left, top = max(0, int(x0 - rim_x)), max(0, int(y0 - rim_y))
        right, bottom = min(picture.shape[1], int(x1 + rim_x)), min(picture.shape[0], int(y1 + rim_y))
        return picture[top:bottom, left:right]

    def _write(self, name: str, picture: Picture, settings: list[int]) -> None:
        done, data = cv2.imencode(Path(name).suffix, picture, settings)
        if not done:
            raise StoreError(f"{self._folder / name}: OpenCV could not encode the picture")
        files.write_bytes(self._part / name, data.tobytes())


def _caption(reading: Reading) -> str:
    quality = f", quality {reading.stem.quality:.1f}" if reading.stem.points_cm is not None else ""
    return f"{reading.name}  {reading.time_s / 3600:.2f} h  {reading.stem.outcome}{quality}"


def _readings_text(readings: Sequence[Reading]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(READINGS_HEADER)
    for r in readings:
        tip = r.stem.tip_px if r.stem.tip_px is not None else ("", "")
        table.writerow(
            [
                r.index,
                r.name,
                f"{r.time_s:.3f}",
                r.light,
                r.stem.outcome,
                f"{r.stem.quality:.2f}",
                *tip,
                r.stem.tip_choice or "",
            ]
        )
    return text.getvalue()
