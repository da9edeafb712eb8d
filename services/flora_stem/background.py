"""The empty setup, made whenever ``background/`` changes; where there is none, learnt from the plant's own frames."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

from flora_common import files
from flora_common.errors import BadInput, BadRunFolder, StoreError
from flora_common.messages import Frame
from flora_common.runs import CameraSection, Light, RunFolder
from flora_common.vision import lamp_states
from flora_common.vision.lamp_states import EmptySetup, LampState
from flora_common.vision.path.reduced import reduced
from flora_common.vision.picture import Picture, Reduction, read_picture
from flora_common.vision.setup import SetupMatrices, from_files, hash_of_files
from flora_stem.finder import Finder, Method, PaperFinder, PathFinder
from flora_stem.section import StemSection

CACHE_FILE: Final = "setup.npz"
NO_BACKGROUND: Final = "no background pictures; run flora-stem calibrate"
LEARN_AT: Final = (12, 24, 48)
"""Frames of one lamp state after which the empty setup is learnt from them: anew as they show more of it."""
LEARN_FROM: Final = 24
"""Of them, evenly spread; each needs 6 MB while it lasts."""


class Background:
    """Watches a run's background pictures.

    Args:
        run: the run folder.
        camera: size that each picture must have.
        section: the method and its numbers.
        cache: file in the state folder where the matrices of the published method are kept.

    Attributes:
        finder: the method with the empty setup; None where there is none.
        reason: why there is none; empty also where there is simply no picture.
        pictures: how many the setup was made from.
        made_by: ``background``, ``frames``, or empty.
    """

    def __init__(self, run: RunFolder, camera: CameraSection, section: StemSection, cache: Path) -> None:
        self._run, self._camera, self._section = run, camera, section
        self._method: Method = section.method
        self._reduction: Reduction = section.reduction(camera)
        self._cache = cache
        self._seen: list[tuple[str, int, int]] | None = None
        self._folder_trouble = ""
        self._picture_trouble = ""
        self._learns = True
        """There are no pictures that can be used, so that the frames must do."""
        self._learner = _Learner(run, camera, section)
        self.finder: Finder | None = None
        self.reason = ""
        self.pictures = 0
        self.made_by = ""
        self.from_cache = False

    @property
    def unreadable(self) -> str:
        """What of the pictures the disk does not give out, in one sentence; empty where it gives out all."""
        return self._folder_trouble or self._picture_trouble

    def refresh(self) -> bool:
        """Look at the folder; True where the empty setup, or its lack, is new.

        Pictures that the disk does not give out are as good as none. Where the folder is one day not to be read, what
        was made from it before still holds.
        """
        listed = self._listed()
        if self._folder_trouble and self._seen:
            return False
        paths, seen = [], []
        for path in listed:
            try:
                status = path.stat()
            except OSError:
                continue  # taken away just now; the next look is not far
            paths.append(path)
            seen.append((path.name, status.st_size, status.st_mtime_ns))
        if seen == self._seen:
            return self._learns and self._learnt()
        is_first = self._seen is None
        self._seen = seen
        self.finder, self.reason, self.pictures, self.made_by, self.from_cache = None, "", 0, "", False
        self._picture_trouble = ""
        if paths:
            self._use(paths)
        self._learns = not paths or bool(self._picture_trouble)
        if not self._learns:
            return True
        if is_first and self._method == "path":
            self._learner.look_back()
        else:
            self._learnt()
        return True

    def saw(self, frame: Frame) -> None:
        """A frame of the run came: one more to learn from where there are no background pictures."""
        if self._method == "path" and self._learns:
            self._learner.saw(frame)
            if self.finder is None:
                self.reason = self._learner.waiting_for

    def _listed(self) -> list[Path]:
        self._folder_trouble = ""
        try:
            return self._run.background_pictures()
        except OSError as problem:
            self._folder_trouble = f"{self._run.background}: cannot be read ({problem.strerror}); check its disk"
            return []

    def _use(self, paths: list[Path]) -> None:
        try:
            self.finder = self._made(paths)
            self.pictures, self.made_by = len(paths), "background"
        except BadInput as problem:
            if self._method == "path" and isinstance(problem.__cause__, OSError):  # no fault of the picture
                self._picture_trouble = f"{problem}; check its disk"
            else:
                self.reason = str(problem)

    def _learnt(self) -> bool:
        try:
            setup = self._learner.result()
        except BadInput as problem:
            self.reason = str(problem)
            return True
        if setup is None:
            return False
        self.finder = PathFinder(setup, self._camera, self._section.path)
        self.reason, self.pictures, self.made_by = "", setup.pictures, "frames"
        return True

    def _made(self, paths: list[Path]) -> Finder:
        if self._method == "paper":
            return PaperFinder(self._matrices(paths), self._camera, self._section.paper, self._section.largest_share)
        setup = lamp_states.from_background(self._read(path) for path in paths)
        return PathFinder(setup, self._camera, self._section.path)

    def _read(self, path: Path) -> Picture:
        size = (self._camera.width_px, self._camera.height_px)
        return read_picture(path, expected_size=size, reduction=self._reduction)

    def _matrices(self, paths: list[Path]) -> SetupMatrices:
        with contextlib.suppress(BadInput):
            kept = SetupMatrices.load(self._cache)
            if kept.sources_sha256 == hash_of_files(paths, reduction=self._reduction):
                self.from_cache = True
                return kept
        size = (self._camera.width_px, self._camera.height_px)
        made = from_files(paths, reduction=self._reduction, expected_size=size)
        # Where it cannot be kept only the next start is slower; a full disk is told by those who must write.
        with contextlib.suppress(StoreError, OSError):
            made.save(self._cache)
        return made


class _Learner:
    """Learns lamp states from the run's own frames, in a thread: it takes seconds, and the service must go on.

    A service that starts in the middle of a run learns from the frames that are there, as it had before.
    """

    def __init__(self, run: RunFolder, camera: CameraSection, section: StemSection) -> None:
        self._run, self._camera, self._section = run, camera, section
        self._frames: dict[Light, dict[str, None]] = defaultdict(dict)
        self._learnt_from: dict[Light, int] = {}
        self._states: dict[Light, LampState] = {}
        self._pool: ThreadPoolExecutor | None = None
        self._work: tuple[Light, Future[LampState]] | None = None
        self.waiting_for = ""

    def look_back(self) -> None:
        """Take the frames of before this start that are still on the disk."""
        with contextlib.suppress(BadRunFolder):  # no table yet, or flora-capture has to mend its end
            for row in self._run.read_frames():
                if row.light is not None and files.is_file(self._run.path / row.file):
                    self._frames[row.light][row.file] = None
        self._go_on()

    def saw(self, frame: Frame) -> None:
        self._frames[frame.light][frame.path] = None
        if not self._states:
            most = max(len(v) for v in self._frames.values())
            self.waiting_for = (
                f"{NO_BACKGROUND}; or wait: the empty setup is learnt from {LEARN_AT[0]} frames with one lamp, "
                f"{most} are there"
            )
        self._go_on()

    def _go_on(self) -> None:
        """Begin with a lamp whose frames have become enough to learn from, or to learn more."""
        if self._work is not None:
            return
        for light, seen in self._frames.items():
            enough = max((count for count in LEARN_AT if count <= len(seen)), default=0)
            if enough > self._learnt_from.get(light, 0):
                self._learnt_from[light] = enough
                if self._pool is None:
                    self._pool = ThreadPoolExecutor(1, "learn")
                self._work = (light, self._pool.submit(self._learn, list(seen)[:enough]))
                return

    def result(self) -> EmptySetup | None:
        """All states that are known, where one has become known since the last call."""
        if self._work is None or not self._work[1].done():
            return None
        light, work = self._work
        self._work = None
        self._go_on()
        self._states[light] = work.result()
        return EmptySetup(list(self._states.values()), "frames")

    def _learn(self, files: list[str]) -> LampState:
        size = (self._camera.width_px, self._camera.height_px)
        seen = reduced(self._camera, self._section.path)
        step = -(-len(files) // LEARN_FROM)
        pictures = []
        for file in files[::step]:
            with contextlib.suppress(BadInput):  # told when it was read for its stem
                pictures.append(read_picture(self._run.path / file, expected_size=size, reduction=seen.reduction))
        return lamp_states.from_frames(pictures, anchor_px=seen.camera.anchor_px, widest_px=seen.widest_px)
