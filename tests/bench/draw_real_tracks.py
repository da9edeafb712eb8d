"""Draw what the path method measures on the photographs of real plants that may lie beside this repository.

    .venv/bin/python tests/bench/draw_real_tracks.py docs/images/real-tracks.png --contact docs/images/real-bean.png

The photographs are other people's, so the picture has lines only: the bean's stem in every tenth photograph, the apex
of the swaying stalk beside its independent track, and the stalk that folds back, in every sixth. The contact sheet has
the bean's edges, as Canny (1986) finds them in every tenth photograph, below the stem that was found in it.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

ROOT: Final = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from flora_common.tracks import Track, read_track  # noqa: E402
from real_photographs import BEAN, FOLDED, STALK, independent_apex_px  # noqa: E402

ABOVE_PX, BELOW_PX, ASIDE_PX, LARGER = 90, 15, 55, 4
"""The part of the bean's photographs that is shown, about the anchor, and how much larger."""
EDGES: Final = 20, 50
"""Canny's thresholds."""
COLOURS: Final = {"left": "#c2185b", "right": "#1565c0"}


def main() -> int:
    parser = argparse.ArgumentParser(description="Draw the tracks of the photographs of real plants.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--contact", type=Path, metavar="FILE.png", help="the bean's contact sheet")
    options = parser.parse_args()
    missing = [str(plant.path) for plant in (BEAN, STALK, FOLDED) if not plant.path.exists()]
    if missing:
        print(f"draw_real_tracks: {missing[0]} is not there; set FLORA_SHARED", file=sys.stderr)
        return 2
    figure, (bean, stalk, folded) = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    with tempfile.TemporaryDirectory() as folder:
        tracks = []
        for plant in (BEAN, STALK, FOLDED):
            out = Path(folder) / f"{plant.path.stem}.csv"
            track = [
                sys.executable,
                "-m",
                "flora_lab.main",
                "track",
                str(plant.path),
                *plant.options,
                "--points",
                "arc",
            ]
            subprocess.run([*track, "-o", str(out), "--overlays", str(out.with_suffix(""))], check=True)
            tracks.append(read_track(out))
        with (Path(folder) / STALK.path.stem / "readings.csv").open() as file:
            readings = list(csv.DictReader(file))
        with (Path(folder) / BEAN.path.stem / "readings.csv").open() as file:
            outcomes = [row["outcome"] for row in csv.DictReader(file)]
    lines, lamps = tracks[0].points_cm * BEAN.px_per_cm, tracks[0].light
    for i in range(0, len(lines), 10):
        x, y = lines[i].T
        bean.plot(x, y, "-", color=COLOURS.get(lamps[i], "grey"), alpha=0.35 + 0.6 * i / len(lines))
        bean.plot(x[-1], y[-1], "o", color=COLOURS.get(lamps[i], "grey"), markersize=3)
    bean.set_title(
        "germinating bean, every tenth photograph\nred: left lamp; blue: right lamp; darker: later", fontsize=9
    )
    apex = independent_apex_px()
    ok = [i for i, row in enumerate(readings) if row["outcome"] == "ok"]
    stalk.plot(apex[:, 0], color="black", linewidth=1, label="independent track of the apex")
    stalk.plot(
        ok, [float(readings[i]["tip_x_px"]) for i in ok], ".", color="#2e7d32", markersize=4, label="tip, path, ok"
    )
    stalk.set_title("swaying stalk, x of its apex (px) by frame", fontsize=9)
    stalk.legend(fontsize=8)
    lines = tracks[2].points_cm * FOLDED.px_per_cm
    shown = list(range(10, len(lines), 6))
    for i in shown:
        folded.plot(*lines[i].T, "-", color=plt.get_cmap("viridis")(i / len(lines)))
    folded.set_title(
        "stalk that bends up and folds back\nevery sixth photograph from the tenth; yellow: late", fontsize=9
    )
    for axes in (bean, folded):
        axes.set_aspect("equal")
        axes.set_xlabel("px from the anchor")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=80)
    if options.contact is not None:
        options.contact.parent.mkdir(parents=True, exist_ok=True)
        bean_sheet(tracks[0], outcomes).savefig(options.contact, dpi=80)
    return 0


def bean_sheet(track: Track, outcomes: Sequence[str]) -> Figure:
    """The bean's stem over the edges in every tenth of its photographs.

    Args:
        track: of all photographs, in their order.
        outcomes: likewise.
    """
    photographs = sorted(BEAN.path.glob("*.[jp][pn]g"))
    if not len(photographs) == len(track.points_cm) == len(outcomes):
        raise SystemExit("draw_real_tracks: not every photograph of the bean has a stem")
    shown = range(0, len(photographs), 10)
    figure, axes = plt.subplots(2, -(-len(shown) // 2), figsize=(13, 5.6), layout="constrained")
    x, y = (int(v) for v in BEAN.place[BEAN.place.index("--anchor") + 1].split(","))
    for place in axes.flat:
        place.axis("off")
    for place, i in zip(axes.flat, shown, strict=False):
        picture = cv2.imread(str(photographs[i]), cv2.IMREAD_GRAYSCALE)
        part = picture[y - ABOVE_PX : y + BELOW_PX, x - ASIDE_PX : x + ASIDE_PX]
        large = cv2.resize(part, None, fx=LARGER, fy=LARGER, interpolation=cv2.INTER_CUBIC)
        edges = cv2.Canny(cv2.GaussianBlur(large, (0, 0), 0.5 * LARGER), *EDGES)
        place.imshow(255 - edges // 2, cmap="gray", vmin=0, vmax=255, extent=(-ASIDE_PX, ASIDE_PX, -BELOW_PX, ABOVE_PX))
        line = track.points_cm[i] * BEAN.px_per_cm
        colour = COLOURS.get(track.light[i], "grey")
        place.plot(*line.T, "-", color=colour, linewidth=1.5)
        place.plot(*line[-1], "o", color=colour, markersize=4)
        place.set_title(f"{i}: {outcomes[i]}", fontsize=9)
    figure.suptitle(
        "germinating bean: edges in every tenth photograph, and the stem (red: left lamp; blue: right lamp)", fontsize=9
    )
    return figure


if __name__ == "__main__":
    sys.exit(main())
