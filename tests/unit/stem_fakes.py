"""A run folder with drawn pictures of a stem, and the parts of the stem service, started again at will."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import msgspec
import numpy as np

from announced_frames import announced
from flora_common.messages import Frame, Stem
from flora_common.runs import CameraSection, RunFile, RunFolder, run_file_text
from flora_common.tracks import read_track
from flora_common.vision.picture import Picture
from flora_stem.background import Background
from flora_stem.core import Answer, StemCore
from flora_stem.main import FrameReader, Track, resumed, run_identity
from flora_stem.record import RECORD_FILE, read_record, write_record
from flora_stem.section import StemSection

WIDTH, HEIGHT = 320, 240
CAMERA = CameraSection(anchor_px=(160.0, 220.0), px_per_cm=10.0, width_px=WIDTH, height_px=HEIGHT)
RUN_FILE = RunFile(camera=CAMERA, rig="test")


def empty() -> Picture:
    return np.full((HEIGHT, WIDTH, 3), 20, dtype=np.uint8)


def with_stem(x_cm: float, y_cm: float) -> Picture:
    picture = empty()
    tip = (round(160 + 10 * x_cm), round(220 - 10 * y_cm))
    cv2.line(picture, (160, 219), tip, (60, 200, 60), 8)
    return picture


def jpeg(picture: Picture) -> bytes:
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert ok
    return data.tobytes()


class Box:
    """A run folder and the parts of the service, started again at will."""

    METHOD: Literal["path", "paper"] = "paper"
    RUN_FILE = RUN_FILE

    def __init__(self, folder: Path) -> None:
        self.run = RunFolder(folder / "run")
        self.state = folder / "state"
        for path in (self.run.frames, self.run.background, self.state):
            path.mkdir(parents=True)
        self.run.run_toml.write_text(run_file_text(self.RUN_FILE))
        self.section = StemSection(method=self.METHOD)
        self.now_ms = 0.0
        self.start()

    def start(self) -> None:
        record = read_record(self.state / RECORD_FILE, run=run_identity(self.run, self.RUN_FILE))
        self.track = Track(self.run)
        self.core = StemCore(
            self.section.method,
            resumed(record, self.run, self.RUN_FILE, self.section),
            read=FrameReader(self.run, self.RUN_FILE, self.section),
            now_ms=lambda: self.now_ms,
        )
        self.background = Background(self.run, self.RUN_FILE.camera, self.section, self.state / "setup.npz")
        self.look()

    def look(self) -> None:
        if self.background.refresh():
            self.core.use(self.background.finder, self.background.reason)

    def calibrate(self) -> None:
        for name in ("left-1", "right-1", "dark-1"):
            (self.run.background / f"{name}.jpg").write_bytes(jpeg(empty()))
        self.look()

    def frame(self, tick: int, data: bytes, **changes: object) -> Frame:
        path = f"frames/{tick:06d}.jpg"
        (self.run.path / path).write_bytes(data)
        frame = announced(path, data, tick)
        return msgspec.structs.replace(frame, **{"width_px": WIDTH, "height_px": HEIGHT, **changes})

    def answer(self, frame: Frame) -> Stem:
        """As main.py does: track, then record, then the word."""
        answer = self.core.on_frame(frame)
        assert answer is not None
        self.keep(answer)
        return answer.stem

    def keep(self, answer: Answer) -> None:
        self.track.add(answer.row)
        write_record(self.state / RECORD_FILE, self.core.record)

    def times(self) -> list[float]:
        return [float(t) for t in read_track(self.run.track_csv).time_s] if self.run.track_csv.exists() else []
