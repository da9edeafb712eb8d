"""The methods that find stems, behind one face: each knows the empty setup and what to remember between frames."""

from __future__ import annotations

from typing import Literal, Protocol

import msgspec
import numpy as np

from flora_common.runs import CameraSection
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.paper import PaperSettings, PaperTracker
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.tracker import PathTracker
from flora_common.vision.picture import Picture
from flora_common.vision.reading import StemReading, bad_picture
from flora_common.vision.setup import SetupMatrices
from flora_stem.record import StemRecord

Method = Literal["path", "paper"]


class Finder(Protocol):
    """A method with its empty setup."""

    def recall(self, record: StemRecord) -> None:
        """Go on from what a record holds."""
        ...

    def read(self, picture: Picture, time_s: float) -> StemReading:
        """The stem in a picture; raises BadPicture, and then remembers nothing of it."""
        ...

    def remembered(self, record: StemRecord) -> StemRecord:
        """The record with what this method remembers."""
        ...


class PaperFinder:
    """The published method.

    Args:
        setup: L and H.
        camera: anchor and scale.
        settings: numbers of the method.
        largest_share: of the picture that may differ from the setup.
    """

    def __init__(
        self, setup: SetupMatrices, camera: CameraSection, settings: PaperSettings, largest_share: float
    ) -> None:
        self._tracker = PaperTracker(setup, camera, settings)
        self._largest_share = largest_share

    def recall(self, record: StemRecord) -> None:
        self._tracker.tip_px = record.tip_px

    def read(self, picture: Picture, time_s: float) -> StemReading:
        reading = self._tracker.read(picture)
        share = reading.stem_pixels / self._tracker.setup.L.size
        if share > self._largest_share:
            return bad_picture(
                f"{share:.0%} of the picture differ from the empty setup; flash, exposure or camera have changed"
            )
        return reading

    def remembered(self, record: StemRecord) -> StemRecord:
        return msgspec.structs.replace(record, tip_px=self._tracker.tip_px)


class PathFinder:
    """The path method.

    Args:
        setup: the lamp states of the empty setup.
        camera: anchor and scale.
        settings: numbers of the method.
    """

    def __init__(self, setup: EmptySetup, camera: CameraSection, settings: PathSettings) -> None:
        self._tracker = PathTracker(setup, camera, settings)

    def recall(self, record: StemRecord) -> None:
        self._tracker.memory = record.path

    def read(self, picture: Picture, time_s: float) -> StemReading:
        return self._tracker.read(picture, time_s)

    def remembered(self, record: StemRecord) -> StemRecord:
        memory = self._tracker.memory
        tip = None
        if memory is not None:
            tip = tuple(np.round(self._tracker.seen.full_px(np.array(memory.line_px[-1])), 3).tolist())
        return msgspec.structs.replace(record, path=memory, tip_px=tip)
