"""Measured runs as the lab reads them: a run folder with ``track.csv``, or a track alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from flora_common import files
from flora_common.errors import BadInput
from flora_common.runs import LampsSection, RunFolder
from flora_common.tables import read_header
from flora_common.tracks import Track, read_track, unit_of_stems
from flora_lab.asides import aside

ANCHOR_TOLERANCE_CM: Final = 0.01
FARTHEST_CM: Final = 60.0
"""A bean grows to some 40 cm in the box; what is farther off is in a wrong unit."""
_OF_A_TIP: Final = {"x_cm", "x_mm", "x_px", "apex x (mm)"}


@dataclass(frozen=True, slots=True)
class RunTrack:
    """A run's track and where it came from.

    Attributes:
        name: of the run; text that can be written, whatever bytes the name of its file has.
        plant: which plant it was: ``plant`` of run.toml, or the run's name.
        file: the track, as it was given.
        sha256: of the file.
        track: what it holds.
        lamps: where the lamps hang, from run.toml; None where that is not told.
    """

    name: str
    plant: str
    file: Path
    sha256: str
    track: Track
    lamps: LampsSection | None = None

    def where(self, row: int) -> str:
        """How messages name a row, counted from 0."""
        return f"{self.file} row {row + 1} (time_s {self.track.time_s[row]:g})"

    def check_upright(self) -> None:
        """Whether stems grow up.

        Raises:
            BadInput: most of them hang, as if y were counted down, as rows of a picture are.
        """
        if float(np.median(self.track.points_cm[:, -1, 1])) < 0.0:
            raise BadInput(f"{self.file}: most tips lie below the anchor; y counts up in a track, change its sign")

    def check_points(self) -> None:
        """Whether the points can be a stem's.

        Raises:
            BadInput: an anchor that is not (0, 0), or one that is no stem's in the grow box.
        """
        points = self.track.points_cm
        off = np.abs(points[:, 0]).max(axis=1) > ANCHOR_TOLERANCE_CM
        if off.any():
            row = int(np.argmax(off))
            x, y = points[row, 0]
            raise BadInput(f"{self.where(row)}: point 1 is the anchor and must be (0, 0), not ({x:g}, {y:g})")
        far = np.hypot(*np.moveaxis(points, -1, 0)).max(axis=1) > FARTHEST_CM
        if far.any():
            raise BadInput(
                f"{self.where(int(np.argmax(far)))}: a point is more than {FARTHEST_CM:g} cm from the anchor, where no "
                "bean of the box comes; points are in cm, not in mm or px, unless their columns are called x1_mm"
            )


def load_run(path: Path) -> RunTrack:
    """A run folder with ``track.csv``, or a track alone.

    Raises:
        BadInput: missing, unreadable, not a track; the message names file and line.
    """
    if not path.exists():
        raise BadInput(f"{path}: no such run or track")
    if not path.is_dir():
        check_regular(path)
        name = path.resolve().parent.name if path.name == "track.csv" else path.stem
        name = files.shown(name)
        _check_whole_stems(path)
        return RunTrack(name, name, path, files.sha256_of_file(path), read_track(path))
    folder = RunFolder(path)
    if folder.track_csv.is_dir():
        raise BadInput(f"{folder.track_csv}: is a folder, where the run's track must be")
    if not folder.track_csv.is_file():
        inner = any(path.glob("*/track.csv"))
        hint = (
            f"; name the runs in it: {path}/*"
            if inner
            else f"; make it with `flora-lab track {path} -o {folder.track_csv}`"
        )
        raise BadInput(f"{path}: holds no track.csv{hint}")
    name = files.shown(folder.name)
    run_file = folder.read_run_file(unknown=aside) if folder.run_toml.exists() else None
    plant = run_file.plant.strip() if run_file else ""
    sha256 = files.sha256_of_file(folder.track_csv)
    lamps = run_file.lamps if run_file else None
    return RunTrack(name, plant or name, folder.track_csv, sha256, read_track(folder.track_csv), lamps)


def _check_whole_stems(path: Path) -> None:
    """Whether a table can be a track of stems.

    Raises:
        BadInput: it has the tip alone.
    """
    header = read_header(path)
    columns = {name.casefold() for name in header}
    if columns & _OF_A_TIP and "light" not in columns and unit_of_stems(header) is None:
        raise BadInput(
            f"{path}: a track of the tip alone; whole stems and lamps are needed here (time_s,light,x1,y1,…,x10,y10). "
            "`flora-lab rhythm` looks for swings in such a track"
        )


def check_regular(path: Path) -> None:
    """Whether a file can be read to its end, and as often as is needed.

    Raises:
        BadInput: a pipe or a device, which may never end.
    """
    if not path.is_file():
        raise BadInput(f"{path}: not a regular file; write what it gives into one, and name that")


def load_runs(paths: Sequence[Path]) -> list[RunTrack]:
    """All runs, in the order given.

    Raises:
        BadInput: as :func:`load_run`; or the same track twice, which would count it double.
    """
    runs: list[RunTrack] = []
    for path in paths:
        run = load_run(path)
        twin = next((other for other in runs if other.sha256 == run.sha256), None)
        if twin is not None:
            raise BadInput(f"{run.file}: is the same track as {twin.file}")
        runs.append(run)
    return runs
