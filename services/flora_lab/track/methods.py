"""The two ways to find a stem behind one face: look at pictures in any thread and order, follow them in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import msgspec

from flora_common.runs import CameraSection, Light
from flora_common.vision.lamp_states import EmptySetup
from flora_common.vision.paper import PaperSettings, PaperTracker
from flora_common.vision.path.memory import Memory
from flora_common.vision.path.nearby import LONGEST_S
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.path.sight import Sight
from flora_common.vision.path.tracker import Glance, PathTracker
from flora_common.vision.picture import Picture, Reduction
from flora_common.vision.reading import StemReading
from flora_common.vision.setup import SetupMatrices


class Look(Protocol):
    """The part of a method that needs no other pictures; may be called in several threads at once."""

    @property
    def reduction(self) -> Reduction:
        """It wants pictures at 1/reduction of their size."""
        ...

    def __call__(self, picture: Picture) -> Any:
        """What the picture shows; raises BadPicture."""
        ...


class Method(Protocol):
    """A method over a sequence.

    Attributes:
        look: its first part.
        memory: what it knows from the pictures before, as plain values; may be set, to go on from there.
    """

    look: Look
    memory: object

    def follow(self, sight: Any, light: Light, time_s: float) -> StemReading:
        """The stem in what ``look`` gave; pictures must come in order. Raises BadPicture."""
        ...


class PathLook:
    """What the path method finds in a picture without regard to others: at a quarter of its size, or in all of it."""

    def __init__(self, tracker: PathTracker, *, whole: bool) -> None:
        self._look: Callable[[Picture], Glance | Sight] = tracker.look if whole else tracker.glance
        self.reduction: Reduction = tracker.seen.reduction

    def __call__(self, picture: Picture) -> Glance | Sight:
        return self._look(picture)


class PathMethod:
    """The path method, as the rig has it: what a quarter of the size shows is found in any order, the stem in turn.

    Args:
        setup: the empty setup.
        camera: anchor and scale, px of the full picture.
        settings: numbers of the method.
        shortest_gap_s: between two pictures. Where that is so long that none is read near the stem of the one before,
            all of each picture is looked at in any order, which comes to the same.

    Raises:
        BadInput: setup and camera disagree, or no pixel is left in the window.
    """

    def __init__(
        self, setup: EmptySetup, camera: CameraSection, settings: PathSettings, *, shortest_gap_s: float
    ) -> None:
        self._tracker = PathTracker(setup, camera, settings)
        self.look: Look = PathLook(self._tracker, whole=shortest_gap_s > LONGEST_S)

    @property
    def memory(self) -> object:
        return None if self._tracker.memory is None else msgspec.to_builtins(self._tracker.memory)

    @memory.setter
    def memory(self, stored: object) -> None:
        self._tracker.memory = None if stored is None else msgspec.convert(stored, Memory)

    def follow(self, sight: Glance | Sight, light: Light, time_s: float) -> StemReading:
        if isinstance(sight, Sight):
            return self._tracker.follow(sight, time_s)
        return self._tracker.read_on(sight, time_s)


@dataclass(frozen=True, slots=True)
class PaperLook:
    """The published method needs the previous tip for all that comes after decoding, and that is quick."""

    reduction: Reduction

    def __call__(self, picture: Picture) -> Picture:
        return picture


class PaperMethod:
    """The published method.

    Args:
        setup: for all lamps, or one for each, at least one.

    Raises:
        BadInput: the window holds no pixel above the anchor.
    """

    def __init__(
        self, setup: Mapping[Light, SetupMatrices] | SetupMatrices, camera: CameraSection, settings: PaperSettings
    ) -> None:
        self.look: Look = PaperLook(settings.reduction)
        self._setup = setup
        first = setup if isinstance(setup, SetupMatrices) else next(iter(setup.values()))
        self._tracker = PaperTracker(first, camera, settings)

    @property
    def memory(self) -> object:
        return self._tracker.tip_px

    @memory.setter
    def memory(self, stored: object) -> None:
        self._tracker.tip_px = msgspec.convert(stored, tuple[float, float] | None)

    def follow(self, sight: Picture, light: Light, time_s: float) -> StemReading:
        self._tracker.set_setup(self._setup if isinstance(self._setup, SetupMatrices) else self._setup[light])
        return self._tracker.read(sight)
