"""Pictures that are as they should be, and what became of their stems."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from flora_common.arrays import FloatArray
from flora_common.runs import LIGHTS, CameraSection
from truth_run import TruthRun


@dataclass(frozen=True, slots=True)
class Good:
    """A picture that is as it should be, and one of the same setup, in the same light, without the plant."""

    jpeg: bytes
    centreline_cm: FloatArray
    empty: bytes
    camera: CameraSection

    @property
    def line_px(self) -> FloatArray:
        """The stem in pixels, shape (n, 2)."""
        scale = self.camera.px_per_cm
        return np.asarray(self.centreline_cm * (scale, -scale) + self.camera.anchor_px)


def goods(run: TruthRun, count: int = 8) -> list[Good]:
    """Good pictures out of a run: the last ``count`` of its frames, so run it over days at wide steps.

    The backgrounds are taken to be in the order left, right, dark, both, as many of each.
    """
    frames = list(run.frames())[-count:]
    each = len(run.background) // 4
    return [Good(f.jpeg, f.centreline_cm, run.background[LIGHTS.index(f.light) * each], run.camera) for f in frames]


def decoded(data: bytes) -> np.ndarray | None:
    """What OpenCV makes of a file."""
    if not data:
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None


def stem_share(data: bytes, good: Good) -> float:
    """The share of the stem, 0 to 1, round which a file still decodes to what the good picture shows there.

    Brightness, contrast and colour may have changed; lost and moved blocks count as lost.
    """
    after, before = decoded(data), decoded(good.jpeg)
    if after is None or before is None or after.shape != before.shape:
        return 0.0
    reach = max(4, round(0.4 * good.camera.px_per_cm))
    step = np.arange(-reach, reach + 1, 2)
    line = np.rint(good.line_px[:: max(1, len(good.line_px) // 80)]).astype(int)
    rows = np.clip(line[:, 1, None, None] + step[:, None], 0, before.shape[0] - 1)
    columns = np.clip(line[:, 0, None, None] + step, 0, before.shape[1] - 1)
    patches = [p[rows, columns].mean(axis=3).reshape(len(line), -1) for p in (after, before)]
    patches = [p - p.mean(axis=1, keepdims=True) for p in patches]
    both, *own = (np.mean(a * b, axis=1) for a, b in (patches, patches[:1] * 2, patches[1:] * 2))
    telling = own[1] > 4.0
    alike = both[telling] / (np.sqrt(own[0] * own[1])[telling] + 1.0)
    return float((alike > 0.6).mean()) if telling.any() else 0.0
