"""Small drawn runs, quick to make and to read: one thin stem that sways before a grey board under two lamps."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SIZE = (320, 240)  # width, height
ANCHOR = (159.5, 220.0)
PX_PER_CM = 10.0
LENGTH_CM = 15.0
RUN_TOML = """\
interval_s = 300

[camera]
anchor_px = [159.5, 220]
px_per_cm = 10.0
width_px = 320
height_px = 240

[target]
x_cm = -4
y_cm = 16

[obstacle]
x_cm = 8
y_cm = 10
"""
_BOARD = cv2.GaussianBlur(np.random.default_rng(7).normal(0.0, 60.0, (SIZE[1], SIZE[0])), (0, 0), 6.0)


def stem_cm(bend: float, s: np.ndarray | float) -> np.ndarray:
    """Points (x, y) of an arc of a circle that turns by so many radians from foot to tip; ``s`` from 0 to 1."""
    angle = bend * np.asarray(s)
    along = np.where(angle == 0.0, np.asarray(s), np.sin(angle) / (bend or 1.0))
    return LENGTH_CM * np.stack([(1.0 - np.cos(angle)) / (bend or 1.0), along], axis=-1)


def picture(bend: float | None, light: str = "left", *, number: int = 0) -> np.ndarray:
    """The board, a lamp in view, and a stem that bends by so many radians; without a stem if None."""
    side = {"left": 0.0, "right": 1.0}.get(light)
    across = np.linspace(0.0, 1.0, SIZE[0])
    shine = np.ones(SIZE[0]) if side is None else 0.7 + 0.9 * (1.0 - np.abs(across - side))
    image = (70.0 + _BOARD)[:, :, None] * shine[None, :, None] * np.array([1.05, 1.0, 0.95])
    image += np.random.default_rng(number).normal(0.0, 4.0, image.shape)
    image = np.clip(image, 0, 255).astype(np.uint8)
    if side is not None:
        image[2:22, slice(2, 26) if light == "left" else slice(294, 318)] = 255
    if bend is not None:
        px = np.array(ANCHOR) + stem_cm(bend, np.linspace(0.0, 1.0, 40)) * [PX_PER_CM, -PX_PER_CM]
        line = np.rint(16 * px).astype(np.int32)
        cv2.polylines(image, [line], False, (60, 200, 90), 2, cv2.LINE_AA, 4)
    return image


def sway(i: int) -> float:
    """The bend in frame i: slow enough for a plant, far enough to leave every place but the foot."""
    return float(0.65 * np.sin(i / 7))


def make_run(
    folder: Path, frames: int = 12, *, background: bool = True, empty: int = 3, torn: tuple[int, ...] = ()
) -> Path:
    """A run folder: half of the frames under either lamp, one of them without a stem, some cut short."""
    (folder / "frames").mkdir(parents=True)
    (folder / "run.toml").write_text(RUN_TOML)
    if background:
        (folder / "background").mkdir()
        for light in ("left", "right"):
            cv2.imwrite(str(folder / "background" / f"{light}.jpg"), picture(None, light, number=1000))
    lines = ["file,time_s,light,temperature_c"]
    for i in range(frames):
        light = "left" if i < frames // 2 else "right"
        path = folder / "frames" / f"{i:04d}.jpg"
        cv2.imwrite(str(path), picture(None if i == empty else sway(i), light, number=i))
        if i in torn:
            path.write_bytes(path.read_bytes()[:-50])
        lines.append(f"frames/{path.name},{300 * i},{light},{20 + i}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    return folder
