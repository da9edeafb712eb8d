"""Draw what the path method measures on the photographs of real plants that may lie beside this repository.

    .venv/bin/python tests/bench/draw_real_tracks.py docs/images/real-tracks.png

The photographs are other people's, so the picture has lines only: the bean's stem in every tenth photograph, the apex
of the swaying stalk beside its independent track, and the stalk that folds back, in every sixth.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt

ROOT: Final = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from flora_common.tracks import read_track  # noqa: E402
from real_photographs import BEAN, FOLDED, STALK, independent_apex_px  # noqa: E402

COLOURS: Final = {"left": "#c2185b", "right": "#1565c0"}


def main() -> int:
    parser = argparse.ArgumentParser(description="Draw the tracks of the photographs of real plants.")
    parser.add_argument("out", type=Path)
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
    return 0


if __name__ == "__main__":
    sys.exit(main())
