"""The stem finders of this project, as the bench drives them: JPEG in, stem out, one photograph after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from bench.vision.figures import Found
from flora_common.errors import BadPicture
from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import from_background
from flora_common.vision.paper import PaperSettings, PaperTracker
from flora_common.vision.path.reduced import reduced
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import decode_picture
from flora_common.vision.setup import from_pictures
from flora_lab.track.options import paper_reduction

Reader = Callable[[bytes, float], Found]
"""Reads the photographs of one run in their order, each with its time in s; what it remembers is its own affair."""

Method = Callable[[CameraSection, Sequence[bytes]], Reader]
"""Makes a reader for a run from its camera and its background pictures (JPEG)."""


def paper(camera: CameraSection, background: Sequence[bytes]) -> Reader:
    """The published method at its sampling, 410 px of width; its stem is the line through its ten points."""
    size, reduction = (camera.width_px, camera.height_px), paper_reduction(camera.width_px)
    empty = [decode_picture(jpeg, where="background", expected_size=size, reduction=reduction) for jpeg in background]
    tracker = PaperTracker(from_pictures(empty), camera, PaperSettings(reduction=reduction))

    def read(jpeg: bytes, time_s: float) -> Found:
        try:
            picture = decode_picture(jpeg, where="frame", expected_size=size, reduction=reduction)
        except BadPicture:
            return Found("bad_picture", None)
        reading = tracker.read(picture)
        return Found(reading.outcome, reading.points_cm)

    return read


def path(camera: CameraSection, background: Sequence[bytes]) -> Reader:
    """The method of this project as the rig runs it: its own centreline, not the ten points taken from it."""
    size = (camera.width_px, camera.height_px)
    reduction = reduced(camera, PathSettings()).reduction
    empty = [decode_picture(jpeg, where="background", expected_size=size, reduction=reduction) for jpeg in background]
    tracker = PathTracker(from_background(empty), camera)

    def read(jpeg: bytes, time_s: float) -> Found:
        try:
            reading = tracker.read(decode_picture(jpeg, where="frame", expected_size=size, reduction=reduction), time_s)
        except BadPicture:
            return Found("bad_picture", None)
        if reading.line_px is None:
            return Found(reading.outcome, None)
        off = np.asarray(reading.line_px, dtype=np.float64) - np.array(camera.anchor_px)
        error_mm = None if reading.uncertainty_mm is None else float(reading.uncertainty_mm[-1])
        return Found(reading.outcome, off * np.array([1.0, -1.0]) / camera.px_per_cm, error_mm)

    return read


METHODS: Final[dict[str, Method]] = {"paper": paper, "path": path}
