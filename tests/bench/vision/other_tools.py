"""Stems as scikit-image and PlantCV find them. Runs in ``.venv-bench``, without anything of this project.

    .venv-bench/bin/python tests/bench/vision/other_tools.py FOLDER OUT.npz [--tools skimage,plantcv]

FOLDER holds ``run.json`` (``anchor_px``, ``px_per_cm``, ``frames``: names to read), ``background/*.jpg`` and
``frames/*.jpg``. OUT gets, per tool, ``TOOL_points`` (all centrelines one after the other, shape (n, 2), cm, anchor
first, y up), ``TOOL_counts`` (points per frame; 0 where no stem was found) and ``TOOL_ms`` (from the JPEG's bytes to
the centreline), and ``decode_ms`` (the bare decode, just before each).

Both tools see each photograph at its full size and by itself. Neither knows what this project knows of beans; both are
set up as a person would who has read the tool's own pages, has these photographs, and looked at a few dozen masks.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from plantcv import plantcv as pcv
from scipy.ndimage import gaussian_filter1d
from skimage import filters, graph, measure, morphology

ANCHOR_CM = 2.5
"""A plant begins within this distance of the anchor. Nearer would do, were its foot not in its own shadow at times."""
LEAST_CONTRAST = 12
"""Otsu's method finds a threshold in an empty picture, too: what differs by less (of 255) is taken for noise."""
STEM_SHARE = 0.5
"""Otsu's threshold falls between bright leaves and a darker stem: what reaches this share of it is plant, too."""
SMOOTH_PX = 5.0
"""A path of pixels is a staircase, longer than the line it follows by some percent; this smooths it."""
PRUNE_CM = 1.2
"""PlantCV counts the points of a contour, which runs along both sides: half of this length is pruned."""
SPECK_CM2 = 0.05
TURN_PX = 20
"""Directions are taken over this many pixels."""
GAP_PX = 6
"""segment_skeleton leaves gaps of up to this many pixels where it cuts."""


class Scene:
    """What both tools know of a run.

    Args:
        background: pictures without a plant, shape (height, width, 3), red-green-blue, in every lamp state.
        anchor_px: x to the right, y down.
        px_per_cm: scale.
    """

    def __init__(self, background: Sequence[np.ndarray], anchor_px: tuple[float, float], px_per_cm: float) -> None:
        self.background = background
        self.anchor_px, self.px_per_cm = anchor_px, px_per_cm
        self._small = [picture[::8, ::8].astype(np.int16) for picture in background]
        rows, columns = np.indices(background[0].shape[:2])
        self.near_anchor = np.hypot(columns - anchor_px[0], rows - anchor_px[1]) < ANCHOR_CM * px_per_cm

    def nearest_background(self, picture: np.ndarray) -> np.ndarray:
        """The background picture of the same lamp state: the one that differs least."""
        small = picture[::8, ::8].astype(np.int16)
        sizes = [np.abs(small - other).mean() for other in self._small]
        return self.background[int(np.argmin(sizes))]

    def comes_near_anchor(self, contour: np.ndarray) -> bool:
        """Whether a contour, shape (n, 1, 2), column and row, has a point near the anchor."""
        return bool(self.near_anchor[contour[:, 0, 1], contour[:, 0, 0]].any())

    def line_cm(self, path: np.ndarray) -> np.ndarray:
        """A path of pixels (row, column), from the plant's foot on, as a smooth line in cm, the anchor before it."""
        xy = np.asarray(path, dtype=np.float64)[:, ::-1]
        smooth = gaussian_filter1d(xy, SMOOTH_PX, axis=0, mode="nearest")
        smooth[[0, -1]] = xy[[0, -1]]
        line = (smooth - self.anchor_px) * (1.0, -1.0) / self.px_per_cm
        return np.vstack([np.zeros((1, 2)), line])


def skimage_stem(picture: np.ndarray, scene: Scene) -> np.ndarray | None:
    """Background subtraction, Otsu, opening, the component at the anchor, its skeleton, the longest shortest path.

    The difference to the nearest background is taken as the largest over the three channels. The opening (disk of 1 px)
    takes noise away and leaves a stem of 4 px. Of the components that reach the anchor's surroundings the largest is
    the plant. In its skeleton the centreline is the shortest path from the pixel nearest to the anchor to the one that
    is farthest along the skeleton (``skimage.graph.MCP_Geometric``: diagonal steps count as such).
    """
    difference = np.abs(picture.astype(np.int16) - scene.nearest_background(picture)).max(axis=2)
    high = max(LEAST_CONTRAST, filters.threshold_otsu(difference))
    low = max(LEAST_CONTRAST, STEM_SHARE * high)
    mask = morphology.opening(filters.apply_hysteresis_threshold(difference, low, high), morphology.disk(1))
    labels = measure.label(mask, connectivity=2)
    plant = largest_at_anchor(labels, scene)
    if plant is None:
        return None
    path = farthest_path(morphology.skeletonize(labels == plant), scene)
    return None if path is None else scene.line_cm(path)


def largest_at_anchor(labels: np.ndarray, scene: Scene) -> int | None:
    """The label of the largest component that comes near the anchor."""
    there = np.unique(labels[scene.near_anchor])
    there = there[there > 0]
    if there.size == 0:
        return None
    sizes = np.bincount(labels.ravel())
    return int(there[np.argmax(sizes[there])])


def farthest_path(skeleton: np.ndarray, scene: Scene, gaps: np.ndarray | None = None) -> np.ndarray | None:
    """Along the skeleton from its pixel nearest to the anchor to the one that is farthest from there.

    Args:
        skeleton: shape (height, width), bool.
        gaps: pixels that a path may cross as well.

    Returns:
        Shape (n, 2), row and column.
    """
    rows, columns = np.nonzero(skeleton)
    if rows.size < 3:
        return None
    foot = int(np.argmin(np.hypot(columns - scene.anchor_px[0], rows - scene.anchor_px[1])))
    top, left = int(rows.min()), int(columns.min())
    box = (slice(top, int(rows.max()) + 1), slice(left, int(columns.max()) + 1))
    open_to_it = skeleton[box] if gaps is None else skeleton[box] | gaps[box]
    found = graph.MCP_Geometric(np.where(open_to_it, 1.0, -1.0))  # negative: not to be entered
    lengths, _ = found.find_costs([(rows[foot] - top, columns[foot] - left)])
    lengths = lengths[rows - top, columns - left]
    end = int(np.argmax(np.where(np.isfinite(lengths), lengths, -1.0)))
    path = np.array(found.traceback((rows[end] - top, columns[end] - left))) + np.array([top, left])
    return path if len(path) >= 3 else None


def plantcv_stem(picture: np.ndarray, scene: Scene) -> np.ndarray | None:
    """PlantCV's morphology steps: skeletonize, prune, segment_sort, and the path along the stem objects.

    The mask is made of its own building blocks: the difference to the nearest background picture, threshold.otsu,
    opening, closing (a hole in the mask becomes a loop in the skeleton), fill of specks, and roi.filter with a circle
    round the anchor. (background_subtraction was not taken: it marks the glow of the lamps.) Barbs are pruned, the rest
    is cut at its branching points (prune calls segment_skeleton). segment_sort calls each segment that ends freely a
    leaf, except for the lowest one. That makes a leaf of the shoot's last piece, which ends in the growing tip, and the
    stem objects alone stop at the topmost leaf; so the leaf object that goes on from their upper end with the smallest
    turn is taken with them. (segment_combine would put a straight line from each object to the next.)
    """
    mask = plantcv_mask(picture, scene)
    if mask is None:
        return None
    skeleton = pcv.morphology.skeletonize(mask=mask)
    pruned, _, segments = pcv.morphology.prune(skel_img=skeleton, size=round(PRUNE_CM * scene.px_per_cm))
    if not segments:
        return None
    # segment_sort takes the first object for the base, but a blade that hangs down or a shadow's edge may come before.
    segments.sort(key=lambda segment: -len(segment) if scene.comes_near_anchor(segment) else 0)
    leaves, stems = pcv.morphology.segment_sort(skel_img=pruned, objects=segments, mask=mask)
    # segment_skeleton leaves gaps where it cuts: there the path may run as well.
    joints = cv2.dilate(pcv.morphology.find_branch_pts(skel_img=pruned, mask=mask), np.ones((5, 5), np.uint8))
    gaps = (joints > 0) & (pruned > 0)
    chain = farthest_path(drawn(stems, pruned.shape), scene, gaps)
    if chain is None:
        return None
    shoot = continuation(chain, leaves)
    if shoot is not None:
        longer = farthest_path(drawn([*stems, leaves[shoot]], pruned.shape), scene, gaps)
        chain = chain if longer is None else longer
    return scene.line_cm(chain)


def plantcv_mask(picture: np.ndarray, scene: Scene) -> np.ndarray | None:
    """The plant at the anchor, 0 or 255, shape (height, width)."""
    difference = np.abs(picture.astype(np.int16) - scene.nearest_background(picture)).max(axis=2).astype(np.uint8)
    high = filters.threshold_otsu(difference)  # pcv.threshold.otsu gives the mask only
    low = max(LEAST_CONTRAST, STEM_SHARE * high)
    mask = pcv.threshold.binary(gray_img=difference, threshold=int(low), object_type="light")
    mask = pcv.opening(gray_img=mask, kernel=morphology.disk(1))
    mask = pcv.closing(gray_img=mask, kernel=morphology.disk(2))
    if not mask.any():
        return None
    mask = pcv.fill(bin_img=mask, size=round(SPECK_CM2 * scene.px_per_cm**2))
    if not mask[scene.near_anchor].any():
        return None
    x, y = (round(v) for v in scene.anchor_px)
    roi = pcv.roi.circle(img=picture, x=x, y=y, r=round(ANCHOR_CM * scene.px_per_cm))
    found: np.ndarray = pcv.roi.filter(mask=mask, roi=roi, roi_type="largest")
    return found if found.any() else None


def drawn(objects: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Objects, which are contours of thin lines, as a mask."""
    picture = np.zeros(shape[:2], dtype=np.uint8)
    cv2.drawContours(picture, objects, -1, 255, 1, lineType=8)
    return picture > 0


def continuation(chain: np.ndarray, leaves: Sequence[np.ndarray]) -> int | None:
    """Which of the leaf objects goes on from the end of a path with the smallest turn; None if none begins there.

    Args:
        chain: path of pixels, shape (n, 2), row and column.
        leaves: contours, shape (n, 1, 2), column and row.
    """
    end = chain[-1].astype(float)
    before = end - chain[max(0, len(chain) - TURN_PX)]
    best: tuple[float, int] | None = None
    for number, leaf in enumerate(leaves):
        pixels = leaf[:, 0, ::-1].astype(float)
        distance = np.hypot(*(pixels - end).T)
        if distance.min() > GAP_PX:
            continue
        near = pixels[distance < TURN_PX]
        after = near[np.argmax(np.hypot(*(near - end).T))] - end
        turn = abs(math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after)))
        if best is None or turn < best[0]:
            best = (turn, number)
    return None if best is None else best[1]


TOOLS: dict[str, Callable[[np.ndarray, Scene], np.ndarray | None]] = {
    "skimage": skimage_stem,
    "plantcv": plantcv_stem,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tools", default=",".join(TOOLS))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pcv.params.debug = None
    warnings.filterwarnings("ignore", category=FutureWarning, module="plantcv")  # of its own calls to scikit-image
    run = json.loads((options.folder / "run.json").read_text())
    background = [decoded(path.read_bytes()) for path in sorted((options.folder / "background").glob("*.jpg"))]
    scene = Scene(background, tuple(run["anchor_px"]), run["px_per_cm"])
    tools = options.tools.split(",")
    lines: dict[str, list[np.ndarray]] = {tool: [] for tool in tools}
    took_ms: dict[str, list[float]] = {tool: [] for tool in tools}
    decode_ms = []
    for number, name in enumerate(run["frames"], start=1):
        data = (options.folder / "frames" / name).read_bytes()
        began = time.perf_counter()
        decoded(data)
        decode_ms.append((time.perf_counter() - began) * 1e3)
        for tool in tools:
            began = time.perf_counter()
            line = TOOLS[tool](decoded(data), scene)
            took_ms[tool].append((time.perf_counter() - began) * 1e3)
            lines[tool].append(np.empty((0, 2)) if line is None else line)
        print(number, flush=True)  # the bench shows its progress by it
    out: dict[str, np.ndarray] = {"decode_ms": np.array(decode_ms)}
    for tool in tools:
        out[f"{tool}_points"] = np.concatenate(lines[tool])
        out[f"{tool}_counts"] = np.array([len(line) for line in lines[tool]])
        out[f"{tool}_ms"] = np.array(took_ms[tool])
    np.savez(options.out, **out)
    return 0


def decoded(data: bytes) -> np.ndarray:
    """A JPEG as shape (height, width, 3), red-green-blue."""
    picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError("a photograph of the bench cannot be decoded")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))


if __name__ == "__main__":
    sys.exit(main())
