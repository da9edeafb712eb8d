"""``[stem]`` of the rig's TOML file."""

from __future__ import annotations

from typing import Annotated

import msgspec

from flora_common.runs import CameraSection
from flora_common.vision.paper import PaperSettings
from flora_common.vision.path.reduced import reduced
from flora_common.vision.path.settings import PathSettings
from flora_common.vision.picture import Reduction
from flora_stem.finder import Method


class StemSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[stem]``; ``[stem.path]`` and ``[stem.paper]`` are the numbers of the methods."""

    method: Method = "path"
    """``path`` is flora's own, ``paper`` the published one."""
    largest_share: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.25
    """Of the published method: where more of the picture differs from the empty setup, it is no plant."""
    path: PathSettings = PathSettings()
    paper: PaperSettings = PaperSettings()

    def reduction(self, camera: CameraSection) -> Reduction:
        """The method looks at pictures of a camera in 1/reduction of their size."""
        return self.paper.reduction if self.method == "paper" else reduced(camera, self.path).reduction
