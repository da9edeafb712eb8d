"""The setup matrices L and H, made from ``background/`` whenever that changes, and kept for the next start."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

from flora_common.errors import BadInput, StoreError
from flora_common.runs import CameraSection, RunFolder
from flora_common.vision.picture import Reduction
from flora_common.vision.setup import SetupMatrices, from_files, hash_of_files

CACHE_FILE: Final = "setup.npz"


class Background:
    """Watches a run's background pictures.

    Args:
        run: the run folder.
        camera: size that each picture must have.
        reduction: pictures are decoded at this fraction of their size.
        cache: file in the state folder where the matrices are kept.

    Attributes:
        setup: the matrices; None where there are none.
        reason: why there are none; empty also where there is simply no picture.
    """

    def __init__(self, run: RunFolder, camera: CameraSection, reduction: Reduction, cache: Path) -> None:
        self._run = run
        self._size_px = (camera.width_px, camera.height_px)
        self._reduction: Reduction = reduction
        self._cache = cache
        self._seen: list[tuple[str, int, int]] | None = None
        self.setup: SetupMatrices | None = None
        self.reason = ""
        self.from_cache = False

    def refresh(self) -> bool:
        """Look at the folder; True where it has changed and the matrices, or their lack, are new."""
        paths, seen = [], []
        for path in self._run.background_pictures():
            try:
                status = path.stat()
            except OSError:
                continue  # taken away just now; the next look is not far
            paths.append(path)
            seen.append((path.name, status.st_size, status.st_mtime_ns))
        if seen == self._seen:
            return False
        self._seen = seen
        self.setup, self.reason, self.from_cache = None, "", False
        if paths:
            try:
                self.setup = self._made(paths)
            except BadInput as problem:
                self.reason = str(problem)
        return True

    def _made(self, paths: list[Path]) -> SetupMatrices:
        kept = self._kept()
        if kept is not None and kept.sources_sha256 == hash_of_files(paths, reduction=self._reduction):
            self.from_cache = True
            return kept
        made = from_files(paths, reduction=self._reduction, expected_size=self._size_px)
        # Where it cannot be kept only the next start is slower; a full disk is told by those who must write.
        with contextlib.suppress(StoreError, OSError):
            made.save(self._cache)
        return made

    def _kept(self) -> SetupMatrices | None:
        try:
            return SetupMatrices.load(self._cache)
        except BadInput:
            return None
