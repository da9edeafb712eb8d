"""Run folders: what a plant, a box and three days of photographs are on disk.

A run is a folder with ``run.toml``, ``background/*.jpg``, ``frames/*.jpg``, ``frames.csv``, ``track.csv`` and
``bus/*.mcap``. ``track.csv`` alone is a valid input to the lab. Lengths in cm, picture positions in px of the full
picture, times in seconds since the run's start.

``light`` in both tables is the lamp that shone when the photograph was taken, hence over the interval before it.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from flora_common import files
from flora_common.errors import BadRunFolder, NotPermitted, StoreError
from flora_common.rig_name import RigName
from flora_common.shapes import FARTHEST_CM, STEM_POINTS, Obstacle, Target
from flora_common.suggest import clipped, did_you_mean
from flora_common.tables import finite_number, is_missing, later_time, read_csv
from flora_common.toml_strict import convert, read_toml, to_toml

Light = Literal["left", "right", "dark", "both"]
LIGHTS: Final[tuple[Light, ...]] = ("left", "right", "dark", "both")
LEVELS: Final[Mapping[Light, tuple[float, float]]] = {
    "left": (1.0, 0.0),
    "right": (0.0, 1.0),
    "dark": (0.0, 0.0),
    "both": (1.0, 1.0),
}
"""What a light means as (left, right) of one full lamp."""

Cm = Annotated[float, msgspec.Meta(ge=-FARTHEST_CM, le=FARTHEST_CM)]
PositiveCm = Annotated[float, msgspec.Meta(gt=0.0, le=FARTHEST_CM)]
Px = Annotated[float, msgspec.Meta(ge=-20_000.0, le=20_000.0)]

Points = Iterable[Iterable[float]]
"""Points (x, y) in cm: an array of shape (n, 2), or tuples."""

LEAST_PX_PER_CM: Final = 1.0
"""No stem is seen in a picture that stands for so much, tens of metres; whoever looks for one needs time and memory for
all of them."""

LONGEST_PATH: Final = 500
"""Signs of a photograph's path in ``frames.csv``; file systems know no names of more than 255."""

FRAMES_HEADER: Final = "file,time_s,light"
TRACK_HEADER: Final = "time_s,light," + ",".join(f"x{i},y{i}" for i in range(1, STEM_POINTS + 1))


class CameraSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[camera]``: how pictures map to centimetres."""

    anchor_px: tuple[Px, Px]
    px_per_cm: Annotated[float, msgspec.Meta(ge=LEAST_PX_PER_CM, le=1000.0)]
    width_px: Annotated[int, msgspec.Meta(ge=16, le=20_000)] = 1640
    height_px: Annotated[int, msgspec.Meta(ge=16, le=20_000)] = 1232


class TargetSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[target]``."""

    x_cm: Cm
    y_cm: Cm
    radius_cm: PositiveCm = 2.0


class ObstacleSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[obstacle]``: centre and extent."""

    x_cm: Cm
    y_cm: Cm
    width_cm: PositiveCm = 7.0
    height_cm: PositiveCm = 3.0


class LampsSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[lamps]``: where they hang, relative to the anchor; left is mirrored to right."""

    distance_cm: PositiveCm = 35.0
    height_cm: PositiveCm = 30.0


class RunFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``run.toml``."""

    camera: CameraSection
    rig: RigName = "box1"
    plant: Annotated[str, msgspec.Meta(max_length=200)] = ""
    start: datetime | None = None
    interval_s: Annotated[float, msgspec.Meta(gt=0.0, le=86_400.0)] = 300.0
    lamps: LampsSection = LampsSection()
    target: TargetSection | None = None
    obstacle: ObstacleSection | None = None

    def target_or_none(self) -> Target | None:
        return Target(self.target.x_cm, self.target.y_cm, self.target.radius_cm) if self.target else None

    def obstacle_or_none(self) -> Obstacle | None:
        o = self.obstacle
        return Obstacle(o.x_cm, o.y_cm, o.width_cm, o.height_cm) if o else None


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One line of ``frames.csv``.

    Attributes:
        file: the photograph, inside the run folder.
        time_s: since the run's start.
        light: the lamp; where the line does not tell it that of the line before, and of the first ones that of the
            first line that does. None where no line tells.
        covariates: the further numeric columns; without those that are empty in this line.
    """

    file: str
    time_s: float
    light: Light | None
    covariates: dict[str, float]


class RunFolder:
    """Paths, reading and writing of one run folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.run_toml = path / "run.toml"
        self.background = path / "background"
        self.frames = path / "frames"
        self.frames_csv = path / "frames.csv"
        self.frames_log = path / "frames.jsonl"
        self.track_csv = path / "track.csv"
        self.bus = path / "bus"

    @property
    def place(self) -> Path:
        """Where it is, where ``path`` is a link to it; no error of links that lead in a circle."""
        return Path(os.path.realpath(self.path))

    @property
    def name(self) -> str:
        """Its own name, where ``path`` is a link to it."""
        return self.place.name

    @property
    def names(self) -> frozenset[str]:
        """What it may be called: by its path, or by its own name."""
        return frozenset({self.path.name, self.name})

    def read_run_file(self, unknown: Callable[[str], None] | None = None) -> RunFile:
        """``run.toml``, checked.

        Args:
            unknown: see :func:`flora_common.toml_strict.convert`; others make runs, too.

        Raises:
            BadRunFolder: missing, not TOML, unknown keys, numbers out of range; or its disk or server does not say.
            NotPermitted: the caller may not look into it.
        """
        try:
            if not self.path.is_dir():
                what = "a file, not a run folder" if self.path.is_file() else "no such run folder"
                raise BadRunFolder(f"{self.path}: {what}")
            if not self.run_toml.is_file():
                raise BadRunFolder(f"{self.path}: not a run folder, it has no run.toml")
        except PermissionError as problem:
            told = f"{self.path}: may not be looked into by this user; for services: sudo chown -R flora {self.path}"
            raise NotPermitted(told) from problem
        except OSError as problem:  # pathlib takes few of them for no
            raise BadRunFolder(f"{self.path}: cannot be looked at ({problem.strerror}); check its disk") from problem
        table = read_toml(self.run_toml, BadRunFolder)
        return convert(table, RunFile, where=str(self.run_toml), error=BadRunFolder, unknown=unknown)

    def check_place(self, place: Path) -> None:
        """A run that is moved away is not begun anew in its place, where nobody would take what is written for a run's.

        Nor does anything go on in another run, where the path has become a link to one.

        Args:
            place: :attr:`place` at the start.

        Raises:
            StoreError: the run is no longer where it was, or its disk does not say.
        """
        if self.place != place:
            raise StoreError(f"{self.path} leads to another run than at the start; restart the services for that")
        try:
            is_there = self.run_toml.is_file()
        except OSError as problem:
            raise StoreError(f"{self.run_toml}: cannot be looked at ({problem.strerror}); check its disk") from problem
        if not is_there:
            raise StoreError(
                f"{self.run_toml} is not there: the run folder was moved or removed; put it back, or name another "
                "[rig] run_dir and restart the services"
            )

    def background_pictures(self) -> list[Path]:
        """Pictures of the setup without a plant, in name order."""
        return sorted(self.background.glob("*.jpg")) if self.background.is_dir() else []

    def announced_hashes(self) -> dict[str, str]:
        """SHA-256 by path of every photograph that ``frames.jsonl`` tells of; none where there is no such file.

        The last line of a path counts. Lines that are not whole are left out: a power cut may tear the last one.

        Raises:
            BadRunFolder: it is there and cannot be read.
        """
        try:
            return _announced_hashes(self.frames_log.read_bytes())
        except FileNotFoundError:
            return {}
        except OSError as problem:
            raise BadRunFolder(f"{self.frames_log}: cannot be read ({problem.strerror})") from problem

    def read_frames(self) -> list[FrameRow]:
        """``frames.csv``, checked: files inside the folder, finite and increasing times, known lights.

        File and time must be told in each line; a lamp or a covariate that is empty there was not noted.

        Raises:
            BadRunFolder: it cannot be read, or holds something else.
        """
        rows: list[FrameRow] = []
        times: list[float] = []
        for line, row in read_csv(self.frames_csv, FRAMES_HEADER.split(",")):
            where = f"{self.frames_csv} line {line}"
            file = row.pop("file")
            path = Path(file)
            if not file or len(file) > LONGEST_PATH or path.is_absolute() or ".." in path.parts:
                raise BadRunFolder(f"{where}: file `{clipped(file)}` must be a relative path inside the run folder")
            if "\0" in file:  # what a disk leaves that lost its power; no file can be called so
                raise BadRunFolder(
                    f"{where}: file {clipped(repr(file))} holds a NUL character; mend or remove the line"
                )
            time_s = later_time(row.pop("time_s"), times, where)
            times.append(time_s)
            told = row.pop("light")
            light = (rows[-1].light if rows else None) if is_missing(told) else known_light(told, where)
            covariates = {k: finite_number(v, k, where) for k, v in row.items() if not is_missing(v)}
            rows.append(FrameRow(file, time_s, light, covariates))
        first = next((row.light for row in rows if row.light is not None), None)
        return [row if row.light else replace(row, light=first) for row in rows]

    def append_frame(self, file: str, time_s: float, light: Light) -> None:
        """Add a line to ``frames.csv``, flushed to the disk."""
        files.append_line(self.frames_csv, f"{file},{time_s:.3f},{light}", header=FRAMES_HEADER)

    def append_track(
        self, time_s: float, light: Light, points_cm: Points, extras: Mapping[str, float] | None = None
    ) -> None:
        """Add a line to ``track.csv``, flushed to the disk.

        ``extras`` become further columns of a new table; of one that is there, those that it has.
        """
        given = dict(extras or {})
        there = self._track_columns()
        names = list(given) if there is None else there
        line = track_line(time_s, light, points_cm) + "".join(f",{given.get(name, 0.0):g}" for name in names)
        files.append_line(self.track_csv, line, header=",".join([TRACK_HEADER, *names]))

    def _track_columns(self) -> list[str] | None:
        """The further columns of ``track.csv``; None where there is no whole first line."""
        try:
            with self.track_csv.open(encoding="utf-8-sig") as file:
                first = file.readline()
        except (OSError, UnicodeDecodeError):
            return None
        if not first.endswith("\n") or not first.startswith(TRACK_HEADER):
            return None
        try:  # names may hold commas, in quotes
            return next(csv.reader([first.strip()], strict=True))[len(TRACK_HEADER.split(",")) :]
        except csv.Error:
            return None


class _FrameLine(msgspec.Struct):
    path: str = ""
    file: str = ""
    sha256: str = ""


_FRAME_LINE: Final = msgspec.json.Decoder(_FrameLine)
_SHA256: Final = re.compile(r"[0-9a-f]{64}")


def _announced_hashes(frames_log: bytes) -> dict[str, str]:
    hashes: dict[str, str] = {}
    for line in frames_log.splitlines():
        try:
            frame = _FRAME_LINE.decode(line)
        except (ValueError, RecursionError):
            continue
        path = frame.path or frame.file
        if path and _SHA256.fullmatch(frame.sha256):
            hashes[path] = frame.sha256
    return hashes


def track_line(time_s: float, light: Light, points_cm: Points) -> str:
    """One line of ``track.csv``: micrometres are enough digits."""
    return f"{time_s:.3f},{light}," + ",".join(f"{x:.4f},{y:.4f}" for x, y in points_cm)


def track_text(time_s: Iterable[float], light: Iterable[Light], points_cm: Iterable[Points]) -> str:
    """A whole ``track.csv`` without further columns."""
    rows = zip(time_s, light, points_cm, strict=True)
    return "\n".join([TRACK_HEADER, *(track_line(float(time), lamp, points) for time, lamp, points in rows)]) + "\n"


def run_file_text(run: RunFile) -> str:
    """``run.toml`` as text; reading it back gives an equal :class:`RunFile`."""
    return to_toml(run)


def known_light(text: str, where: str) -> Light:
    """A lamp state by name, in whatever case, or :class:`BadRunFolder` with the line."""
    told = text.strip().casefold()
    for light in LIGHTS:
        if told == light:
            return light
    raise BadRunFolder(f"{where}: light is `{text[:40]}`{did_you_mean(text, LIGHTS)}")
