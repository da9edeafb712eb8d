"""A sheet of drawn photographs to look at: ``python tests/drawings/look.py -o sheet.png --seeds 1 2 3``."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from drawings.run import World, make_world
from truth_run import TruthFrame


def with_truth(frame: TruthFrame, world: World) -> np.ndarray:
    """The picture with its true stem drawn over it."""
    picture = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    section = world.section
    line = frame.centreline_cm * (section.px_per_cm, -section.px_per_cm) + section.anchor_px
    cv2.polylines(picture, [np.rint(line * 16).astype(np.int32)], False, (0, 0, 255), 1, cv2.LINE_AA, 4)
    cv2.circle(picture, [round(float(v)) for v in line[-1]], 5, (255, 255, 0), 1, cv2.LINE_AA)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6])
    parser.add_argument("--hours", type=float, nargs="+", default=[2.0, 20.0, 44.0, 71.0])
    parser.add_argument("--width", type=int, default=480, help="of one picture on the sheet, px")
    parser.add_argument("--crop", action="store_true", help="only the plant, at full size, --width px square")
    parser.add_argument("--plain", action="store_true", help="no true stems")
    given = parser.parse_args()
    rows, spent = [], []
    for seed in given.seeds:
        world = make_world(seed)
        row = []
        for column, hour in enumerate(given.hours):
            start = time.perf_counter()
            frame = world.frame(hour * 3600.0)
            spent.append(time.perf_counter() - start)
            if given.plain or column % 2 == 0:
                picture = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
            else:
                picture = with_truth(frame, world)
            if given.crop:
                row.append(_cut(picture, frame, world, given.width))
            else:
                row.append(cv2.resize(picture, (given.width, given.width * 3 // 4), interpolation=cv2.INTER_AREA))
        label = f"seed {seed}, {world.camera.scene.board}, {world.section.px_per_cm:.0f} px/cm"
        cv2.putText(row[0], label, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        rows.append(np.hstack(row))
    cv2.imwrite(str(given.output), np.vstack(rows))
    print(f"{given.output}: {len(spent)} pictures, {1000 * float(np.median(spent)):.0f} ms each (median)")


def _cut(picture: np.ndarray, frame: TruthFrame, world: World, side: int) -> np.ndarray:
    tip = frame.centreline_cm[-1] * (world.section.px_per_cm, -world.section.px_per_cm) + world.section.anchor_px
    x, y = (int(np.clip(c - side // 2, 0, n - side)) for c, n in zip(tip, picture.shape[1::-1], strict=True))
    return picture[y : y + side, x : x + side].copy()


if __name__ == "__main__":
    main()
