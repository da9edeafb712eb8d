"""How like real photographs are the twin's? A table of picture statistics: real, twin, ratio.

    .venv/bin/python tests/bench/bench_realism.py [--seeds 6] [--look FOLDER]

The real pictures are measurements made by others that are not in the repository; without them there is one line and no
table. All pictures are compared at the size of the bean's photographs, 720 pixels wide. ``--look`` writes crops of the
plants, enlarged three times, real and drawn beside one another, to look at; keep those to yourself.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from flora_common.arrays import BoolArray, FloatArray
from flora_twin.render import Exposure, Lighting, Studio
from flora_twin.strips import OFF, LampLight, strip_bytes
from flora_twin.world import World

Picture = npt.NDArray[np.uint8]

WIDTH_PX = 720
SURROUND_PX = (4.0, 10.0)
"""From here to there beside the stem's middle is its surround: about a centimetre in either picture."""
FOOT_PX = 26
"""Height of the stem's foot, where the pot's cloth is the surround and where the real bean is nearly all there is."""
LAMP = LampLight(0.35, 0.45, 1.0)
BEAN_ANCHOR_PX = (361, 333)
BEAN_CLOTH = (slice(60, 262), slice(180, 480))
TWIN_CLOTH = (slice(90, 330), slice(180, 540))
EXPOSURE = Exposure()


@dataclass
class Sample:
    """Photographs of one kind and what was measured on them; lists of one value for each picture or place."""

    stem_bgr: dict[str, list[FloatArray]] = field(default_factory=lambda: {"left": [], "right": []})
    contrast: list[float] = field(default_factory=list)
    foot_contrast: list[float] = field(default_factory=list)
    edge: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    cloth_log_br: dict[str, list[float]] = field(default_factory=lambda: {"near": [], "far": []})
    texture: dict[int, list[float]] = field(default_factory=lambda: {1: [], 2: [], 4: [], 8: [], 16: []})
    gradient: list[FloatArray] = field(default_factory=list)
    cloth_level: list[float] = field(default_factory=list)
    noise: list[float] = field(default_factory=list)
    flicker: list[float] = field(default_factory=list)
    saturated: list[float] = field(default_factory=list)
    hidden: list[float] = field(default_factory=list)
    tip_seen: list[float] = field(default_factory=list)
    crops: list[Picture] = field(default_factory=list)


def stem_places(sample: Sample, picture: Picture, line_px: FloatArray, lamp: str, foot_px: float) -> None:
    """Profiles across the stem at the points of a line (n, 2): contrast, brightness, width and edge."""
    tangent = np.gradient(line_px, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    across = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    step = np.arange(-12.0, 12.01, 0.125)
    at = (line_px[:, None, :] + step[None, :, None] * across[:, None, :]).astype(np.float32)
    seen = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profiles = seen.astype(np.float64)
    beside = (np.abs(step) >= SURROUND_PX[0]) & (np.abs(step) <= SURROUND_PX[1])
    for profile, y_px in zip(profiles, line_px[:, 1], strict=True):
        green = profile[:, 1]
        middle = np.abs(step) <= 0.5
        level = float(np.median(green[beside]))
        top = float(green[np.abs(step) <= 2.0].max())
        contrast = (float(green[middle].mean()) - level) / max(float(green[beside].std()), 0.5)
        sample.contrast.append(contrast)
        if y_px > foot_px - FOOT_PX:
            sample.foot_contrast.append(contrast)
        sample.stem_bgr[lamp].append(profile[middle].mean(axis=0))
        if top - level < 15.0:
            continue
        high = (green - level) / (top - level)
        peak = int(np.argmax(np.where(np.abs(step) <= 2.0, high, -1.0)))
        sides = []
        for run in (high[peak:], high[: peak + 1][::-1]):
            falls = [int(np.argmax(run < share)) for share in (0.9, 0.5, 0.1)]
            sides.append([float(v) * 0.125 if v else np.nan for v in falls])
        (a9, a5, a1), (b9, b5, b1) = sides
        width = a5 + b5
        if np.isfinite(width) and width < 8.0:
            sample.width.append(width)
            edge = np.array([a1 - a9, b1 - b9]) / width
            sample.edge += edge[np.isfinite(edge)].tolist()


def cloth(sample: Sample, picture: Picture, part: tuple[slice, slice]) -> None:
    """Texture and level of the cloth in a picture without a plant in that part."""
    green = picture[..., 1].astype(np.float32)
    for scale, found in sample.texture.items():
        band = cv2.GaussianBlur(green, (0, 0), scale) - cv2.GaussianBlur(green, (0, 0), 2 * scale)
        found.append(float(band[part].std()))
    smooth = cv2.GaussianBlur(green, (0, 0), 1.0)
    steep = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))[part] / 8.0
    sample.gradient.append(np.percentile(steep, [50, 90, 99, 99.9]))
    sample.cloth_level.append(float(green[part].mean()))
    sample.saturated.append(float((picture.max(axis=2) >= 250).mean()))


def lamp_tint(sample: Sample, picture: Picture, lamp: str, rows: slice) -> None:
    """Blue over red of the cloth in the quarter next to the lamp and in the quarter opposite, as powers of two."""
    quarter = picture.shape[1] // 4
    left, right = (picture[rows, quarter // 2 : quarter], picture[rows, -quarter : -quarter // 2])
    near, far = (left, right) if lamp == "left" else (right, left)
    for name, part in (("near", near), ("far", far)):
        b, _, r = part.reshape(-1, 3).mean(axis=0)
        sample.cloth_log_br[name].append(float(np.log2((b + 1.0) / (r + 1.0))))


def consecutive(sample: Sample, pictures: list[Picture], part: tuple[slice, slice]) -> None:
    """Noise and flicker between pictures of one scene, one after the other."""
    levels = [picture[part][..., 1].astype(np.float64) for picture in pictures]
    for before, after in pairwise(levels):
        share = after.mean() / before.mean()
        sample.flicker.append(100.0 * abs(np.log(share)))
        difference = after - before * share
        # What moves as a whole over the cloth is not noise.
        sample.noise.append(float((difference - cv2.GaussianBlur(difference, (0, 0), 8.0)).std() / np.sqrt(2.0)))


def follow_up(picture: Picture, anchor_px: tuple[int, int], rows: int) -> FloatArray:
    """The bean's stem by the brightest pixel of every row above the anchor, as far as it goes without a jump."""
    green = cv2.GaussianBlur(picture, (0, 0), 0.7)[..., 1].astype(np.float64)
    x = float(anchor_px[0])
    points: list[tuple[float, float]] = []
    for y in range(anchor_px[1], anchor_px[1] - rows, -1):
        left = round(x) - 4
        part = green[y, left : left + 9]
        if part.max() - np.median(green[y, left - 8 : left + 17]) < 25.0:
            break
        best = int(part.argmax())
        if points and abs(left + best - x) > 2.5:
            break
        weights = np.clip(part[max(0, best - 2) : best + 3] - part.min(), 0.0, None)
        x = float(left + max(0, best - 2) + (weights * np.arange(len(weights))).sum() / weights.sum())
        points.append((x, float(y)))
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def real_bean(data: Path) -> Sample:
    """The 94 photographs of a germinating bean: the first of each half are left out, the camera settles there."""
    sample = Sample()
    folder = data / "flora-robotica-bean"
    pictures = {i: np.asarray(cv2.imread(str(folder / f"{i:04d}.jpg")), dtype=np.uint8) for i in range(94)}
    for lamp, chosen in (("left", range(8, 47)), ("right", range(55, 94))):
        for i in list(chosen)[::3]:
            cloth(sample, pictures[i], BEAN_CLOTH)
            lamp_tint(sample, pictures[i], lamp, slice(150, 300))
            line = follow_up(pictures[i], BEAN_ANCHOR_PX, 60)
            # Below the hook, where it is a stem.
            if len(line) > 14:
                stem_places(sample, pictures[i], line[: min(len(line) - 4, 26)], lamp, BEAN_ANCHOR_PX[1])
        consecutive(sample, [pictures[i] for i in chosen], BEAN_CLOTH)
        sample.crops.append(pictures[list(chosen)[-1]][200:345, 290:435])
    return sample


def film(path: Path, part: tuple[slice, slice], last: int) -> Sample:
    """A film of another plant on black cloth: only what does not need a stem."""
    sample = Sample()
    capture = cv2.VideoCapture(str(path))
    pictures: list[Picture] = []
    while len(pictures) < last:
        more, picture = capture.read()
        if not more:
            break
        pictures.append(np.asarray(picture, dtype=np.uint8))
    scale = pictures[0].shape[1] / WIDTH_PX
    rows, columns = (slice(round(s.start * scale), round(s.stop * scale)) for s in part)
    for picture in pictures[::10]:
        large = cv2.resize(picture, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_LINEAR)
        cloth(sample, np.asarray(large, dtype=np.uint8), part)
    consecutive(sample, pictures, (rows, columns))
    return sample


def drawn(seeds: range) -> Sample:
    """The twin's photographs of plants from one to three days, under either lamp, and of the empty box."""
    sample = Sample()
    for seed in seeds:
        world, studio = World(seed), Studio(seed)
        strips = {"left": strip_bytes(LAMP, OFF), "right": strip_bytes(OFF, LAMP)}
        lit = {"left": Lighting(LAMP, OFF), "right": Lighting(OFF, LAMP)}
        for i, hours in enumerate((18.0, 34.0, 50.0, 66.0)):
            lamp = ("left", "right")[i % 2]
            world.set_strips(strips[lamp])
            world.advance_to(hours * 3600.0)
            subject, truth = world.subject(), world.truth()
            assert truth is not None
            picture = as_small(studio.sensor.encode(studio.picture(lit[lamp], EXPOSURE, subject, (i, 0))))
            share = studio.visible(subject)
            steps = np.linalg.norm(np.diff(subject.centreline_cm, axis=0), axis=1)
            sample.hidden.append(100.0 * (1.0 - float((0.5 * (share[1:] + share[:-1]) * steps).sum() / steps.sum())))
            sample.tip_seen.append(float(share[-1] > 0.5))
            seen = share > 0.9
            ratio = WIDTH_PX / world.camera.width_px
            line = (truth.centreline_px + 0.5) * ratio - 0.5
            dense = np.linspace(0.0, len(line) - 1.0, 60)
            line = np.stack([np.interp(dense, np.arange(len(line)), line[:, k]) for k in range(2)], axis=1)
            use = seen[np.rint(dense).astype(int)]
            use[:4] = use[-8:] = False
            if use.sum() > 3:
                stem_places_where(sample, picture, line, use, lamp)
            tip = line[-1]
            top = int(np.clip(tip[1] - 45, 0, picture.shape[0] - 145))
            left = int(np.clip(tip[0] - 72, 0, WIDTH_PX - 145))
            sample.crops.append(picture[top : top + 145, left : left + 145])
        for lamp in ("left", "right"):
            bare = (studio.picture(lit[lamp], EXPOSURE, None, (9, k)) for k in range(6))
            empty = [as_small(studio.sensor.encode(picture)) for picture in bare]
            cloth(sample, empty[0], TWIN_CLOTH)
            lamp_tint(sample, empty[0], lamp, slice(240, 390))
            consecutive(sample, empty, TWIN_CLOTH)
    return sample


def stem_places_where(sample: Sample, picture: Picture, line: FloatArray, use: BoolArray, lamp: str) -> None:
    """The same as :func:`stem_places` for the runs of a line that are in view."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], use.astype(np.int8), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first > 3:
            stem_places(sample, picture, line[first:last], lamp, float(line[0, 1]))


def as_small(jpeg: bytes) -> Picture:
    """A photograph as a file, at the size of the real ones."""
    picture = np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
    height = round(picture.shape[0] * WIDTH_PX / picture.shape[1])
    return np.asarray(cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def measures(sample: Sample) -> dict[str, float]:
    """One number for each line of the table; not a number where the sample has nothing to say."""

    def middle(values: list[float], percent: float = 50.0) -> float:
        return float(np.percentile(values, percent)) if values else float("nan")

    out: dict[str, float] = {
        "stem over surround, in its sd: median": middle(sample.contrast),
        "... 5 % of places below": middle(sample.contrast, 5),
        "the same at the foot: median": middle(sample.foot_contrast),
    }
    for lamp in ("left", "right"):
        colour = np.median(sample.stem_bgr[lamp], axis=0) if sample.stem_bgr[lamp] else np.full(3, np.nan)
        out[f"stem green, {lamp} lamp"] = float(colour[1])
        out[f"stem log2 blue/red, {lamp} lamp"] = float(np.log2(colour[0] / colour[2]))
        levels = [float(v[1]) for v in sample.stem_bgr[lamp]]
        out[f"stem green, {lamp}: 5 to 95 %"] = middle(levels, 95) - middle(levels, 5)
    tint = [float(np.log2((v[0] + 1.0) / (v[2] + 1.0))) for side in sample.stem_bgr.values() for v in side]
    out["stem log2 blue/red, 5 % of places below"] = middle(tint, 5)
    out["stem log2 blue/red, 5 % above"] = middle(tint, 95)
    out["stem width, px"] = middle(sample.width)
    out["edge 10-90 %, stem widths"] = middle(sample.edge)
    out["cloth log2 blue/red, lamp's side"] = middle(sample.cloth_log_br["near"])
    out["cloth log2 blue/red, far side"] = middle(sample.cloth_log_br["far"])
    out["cloth green level"] = middle(sample.cloth_level)
    for scale, values in sample.texture.items():
        out[f"cloth texture at {scale} px, sd"] = middle(values)
    for i, percent in enumerate((50, 90, 99, 99.9)):
        out[f"cloth gradient, {percent} %"] = middle([float(v[i]) for v in sample.gradient])
    out["noise between frames, sd"] = middle(sample.noise)
    out["flicker between frames, %: median"] = middle(sample.flicker)
    out["flicker between frames, %: 95 % below"] = middle(sample.flicker, 95)
    out["saturated pixels, %"] = 100.0 * middle(sample.saturated)
    out["length of stem hidden, %: median"] = middle(sample.hidden)
    out["length of stem hidden, %: 95 % below"] = middle(sample.hidden, 95)
    out["pictures with the tip in view, %"] = 100.0 * float(np.mean(sample.tip_seen)) if sample.tip_seen else np.nan
    return out


def side_by_side(real: list[Picture], twin: list[Picture]) -> Picture:
    """Real crops in the first row, drawn ones below, all enlarged three times."""
    rows = []
    for crops in (real, *(twin[i : i + 4] for i in range(0, len(twin), 4))):
        large = [cv2.resize(crop, (435, 435), interpolation=cv2.INTER_CUBIC) for crop in crops[:4]]
        large += [np.zeros((435, 435, 3), np.uint8)] * (4 - len(large))
        rows.append(np.concatenate(large, axis=1))
    return np.asarray(np.concatenate(rows), dtype=np.uint8)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="drawn individuals, from seed 101")
    parser.add_argument("--look", type=Path, help="write crops, real and drawn, to FOLDER/crops.png")
    arguments = parser.parse_args()
    root = Path(__file__).resolve().parents[2]
    data = Path(os.environ.get("FLORA_SHARED", root.parent / "shared")) / "data"
    if not (data / "flora-robotica-bean").is_dir():
        sys.stdout.write(f"skipped: no real photographs in {data}\n")
        return 0
    real = real_bean(data)
    films = [
        film(data / "plant-tracer" / "circumnutation_20190712.mp4", (slice(20, 100), slice(30, 500)), 290),
        film(data / "plant-tracer" / "legacy_gravitropism_sample.mov", (slice(20, 150), slice(30, 360)), 80),
    ]
    twin = drawn(range(101, 101 + arguments.seeds))
    columns = [measures(sample) for sample in (real, *films, twin)]
    sys.stdout.write("| measure, at 720 px width | real bean | film 1 | film 2 | twin | twin / bean |\n")
    sys.stdout.write("|---|---|---|---|---|---|\n")
    for name in columns[0]:
        bean, first, second, drawn_value = (column[name] for column in columns)
        shown = ["" if not np.isfinite(v) else f"{v:.2f}" for v in (bean, first, second, drawn_value)]
        ratio = f"{drawn_value / bean:.2f}" if "log2" not in name else f"{drawn_value - bean:+.2f}"
        ratio = ratio if np.isfinite(bean) else ""
        sys.stdout.write(f"| {name} | {' | '.join(shown)} | {ratio} |\n")
    if arguments.look:
        arguments.look.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(arguments.look / "crops.png"), side_by_side(real.crops, twin.crops))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
