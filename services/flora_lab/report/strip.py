"""The picture strip: photographs at four times with stem, obstacle, target and lamps, as the paper's reality figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from flora_common.errors import BadPicture
from flora_common.runs import CameraSection, RunFolder
from flora_common.vision.draw import CmToPx, contact_sheet, overlay
from flora_common.vision.picture import Picture
from flora_lab.report.summary import RunSummary
from flora_lab.sources import RunSource

PAPER_HOURS = (20.0, 37.0, 54.0, 71.0)
"""Times of the paper's four panels."""

TILE_WIDTH_PX = 440
MARGIN_CM = 3.0
BAD_PICTURES_NAMED = 3
"""Of the photographs that cannot be shown so many are named, the others counted."""


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """A picture strip.

    Attributes:
        picture: the panels side by side.
        left_out: why each photograph that belongs into it could not be used; the nearest that can stands in for it.
    """

    picture: Picture
    left_out: tuple[str, ...]

    @property
    def remarks(self) -> list[str]:
        """What people are told of these photographs, a line each."""
        told = [f"left out of the strip: {reason}" for reason in self.left_out[:BAD_PICTURES_NAMED]]
        more = len(self.left_out) - BAD_PICTURES_NAMED
        return [*told, f"left out of the strip: {more} more bad pictures"] if more > 0 else told


def strip(folder: RunFolder, summary: RunSummary, hours: Sequence[float] = PAPER_HOURS) -> Strip:
    """The frames nearest to these hours side by side, cut to where the plant, obstacle and target are.

    Hours after the run's end are left out; a run shorter than the first shows its last frame. Where a photograph
    cannot be used the nearest one that can be is shown, once; the hour that is written into a panel is its own.

    Raises:
        BadPicture: no photograph of the run can be used.
    """
    times_h = np.array([frame.time_s for frame in summary.frames]) / 3600
    wanted = [hour for hour in hours if hour <= times_h[-1] + 0.1] or [float(times_h[-1])]
    photographs = _Photographs(RunSource(folder.path))
    nearest = [photographs.first_usable(np.argsort(np.abs(times_h - hour), kind="stable").tolist()) for hour in wanted]
    rows = list(dict.fromkeys(nearest))
    panels = [_panel(photographs.pictures[row], summary, row) for row in rows]
    return Strip(contact_sheet(panels, columns=len(panels)), tuple(photographs.unusable.values()))


class _Photographs:
    """Those of a run that were looked at, each read once.

    Attributes:
        pictures: that can be used, by the row of ``frames.csv``.
        unusable: why the others cannot be, by row.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self.pictures: dict[int, Picture] = {}
        self.unusable: dict[int, str] = {}

    def first_usable(self, rows: Sequence[int]) -> int:
        """The first of these rows whose photograph is whole and, where its hash was noted, the one that was taken."""
        for row in rows:
            if row not in self.pictures and row not in self.unusable:
                self._read(row)
            if row in self.pictures:
                return row
        raise BadPicture(f"none of the {len(rows)} photographs can be used; the first: {self.unusable[rows[0]]}")

    def _read(self, row: int) -> None:
        try:
            self.pictures[row] = self._source.frame(row).load(1)
        except BadPicture as problem:
            self.unusable[row] = str(problem)


def _panel(picture: Picture, summary: RunSummary, row: int) -> Picture:
    frame = summary.frames[row]
    reading = int(np.argmin(np.abs(summary.track.time_s - frame.time_s)))
    seen = abs(float(summary.track.time_s[reading]) - frame.time_s) < summary.run.interval_s / 2
    left, top, right, bottom = _window(summary, picture)
    camera = CameraSection(
        anchor_px=(summary.run.camera.anchor_px[0] - left, summary.run.camera.anchor_px[1] - top),
        px_per_cm=summary.run.camera.px_per_cm,
        width_px=right - left,
        height_px=bottom - top,
    )
    tile_height_px = round((bottom - top) * TILE_WIDTH_PX / (right - left))
    # Drawn after scaling, so that the lines are thin beside the stem whatever the camera's size.
    cut = cv2.resize(picture[top:bottom, left:right], (TILE_WIDTH_PX, tile_height_px), interpolation=cv2.INTER_AREA)
    return overlay(
        np.asarray(cut, dtype=np.uint8),
        camera,
        points_cm=summary.track.points_cm[reading] if seen else None,
        obstacle=summary.run.obstacle_or_none(),
        target=summary.run.target_or_none(),
        light=frame.light,
        caption=f"{frame.time_s / 3600:.0f} h",
    )


def _window(summary: RunSummary, picture: Picture) -> tuple[int, int, int, int]:
    """Pixel box (left, top, right, bottom) round all stems, obstacle and target."""
    points = [summary.track.points_cm.reshape(-1, 2)]
    obstacle, target = summary.run.obstacle_or_none(), summary.run.target_or_none()
    if obstacle is not None:
        points.append(np.array([(obstacle.left_cm, obstacle.bottom_cm), (obstacle.right_cm, obstacle.top_cm)]))
    if target is not None:
        points.append(np.array([target.x_cm, target.y_cm]) + target.radius_cm * np.array([(-1.0, -1.0), (1.0, 1.0)]))
    extent = np.vstack(points)
    low, high = extent.min(axis=0) - MARGIN_CM, extent.max(axis=0) + MARGIN_CM
    corners = CmToPx(summary.run.camera, picture.shape[1])([(low[0], high[1]), (high[0], low[1])])
    height, width = picture.shape[:2]
    left, top = np.clip(np.floor(corners[0]).astype(int), 0, (width - 16, height - 16))
    right, bottom = np.clip(np.ceil(corners[1]).astype(int), (left + 16, top + 16), (width, height))
    return int(left), int(top), int(right), int(bottom)


def encode_jpeg(picture: Picture, quality: int = 85) -> bytes:
    """JPEG bytes of a picture."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def encode_png(picture: Picture) -> bytes:
    """PNG bytes of a picture."""
    return cv2.imencode(".png", picture)[1].tobytes()
