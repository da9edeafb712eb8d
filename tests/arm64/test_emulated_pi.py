"""On the processor of a Raspberry Pi, emulated: the same plants, the same stems, and the whole rig.

``make test-arm64``; some ten minutes, five of them once for the tree.
"""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from emulated import Emulated, why_not

from debian_trees import NotHere

pytestmark = pytest.mark.slow

PLANTS = Path(__file__).parents[1] / "lab" / "plants_bits.py"
COMMANDS = Path(sys.executable).parent
SAME_CM = 0.005
"""OpenCV rounds otherwise on another processor; a pixel is 0.02 cm."""
CHOSEN_OTHERWISE_CM = 0.05
"""And where one of two ways is nearly as good as the other, rounding decides, now and then."""


@pytest.fixture(scope="session")
def pi(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    if reason := why_not():
        pytest.skip(reason)
    try:
        yield Emulated(tmp_path_factory.mktemp("pi") / "emulated")
    except NotHere as problem:
        pytest.skip(str(problem))


def here(command: str, *arguments: str | Path) -> str:
    return subprocess.run(
        [str(COMMANDS / command), *map(str, arguments)], capture_output=True, text=True, timeout=600, check=True
    ).stdout


def test_it_is_another_processor(pi: Emulated) -> None:
    program = "import platform, cv2, numpy; print(platform.machine(), 'NEON' in cv2.getBuildInformation())"
    assert pi.run("python", "-c", program).split() == ["aarch64", "True"]


def test_simulated_plants_are_the_same_to_the_bit(pi: Emulated) -> None:
    lanes, bits = pi.run("python", PLANTS).split()
    assert lanes == "16"
    assert bits == here("python", PLANTS).split()[1]


def test_stems_are_the_same(pi: Emulated, tmp_path: Path) -> None:
    made = ("--open-loop", "1", "--closed-loop", "0", "--hours", "3", "--seed", "5", "--photographs")
    here("flora-twin", "runs", "-o", tmp_path / "runs", *made, "-q")
    (frames,) = (tmp_path / "runs").rglob("frames.csv")
    found = []
    for name, track in (("here", here), ("there", pi.run)):
        output = tmp_path / f"{name}.csv"
        track("flora-lab", "track", frames.parent, "-o", output, "--jobs", "1", "-q")
        found.append(read(output))
    assert len(found[0]) > 30
    apart_cm = stems_apart_cm(*found)
    assert np.nanmax(apart_cm) < CHOSEN_OTHERWISE_CM
    assert np.nanmean(apart_cm < SAME_CM) > 0.98


def test_the_whole_rig_runs(pi: Emulated, tmp_path: Path) -> None:
    """All services from the rig's own wheels, the NeoPixel library down to its board, under the shipped network."""
    found = []
    for name, demo in (("here", here), ("there", pi.run)):
        folder = tmp_path / name
        told = demo("flora-twin", "demo", "--out", folder, "--hours", "2", "--seed", "3", "--no-dashboard", "-q")
        assert "0 missing, 0 torn" in told, told
        assert "obstacle   not touched" in told, told
        (track,) = (folder / "rig" / "runs").rglob("track.csv")
        # What is photographed while the rig is stopped depends on how fast that goes.
        found.append([row for row in read(track) if float(row["time_s"]) <= 2 * 3600.0])
    assert len(found[0]) == 25
    # A rig that begins a tick later photographs with other noise, so that only the plant is the same.
    assert np.nanmax(stems_apart_cm(*found)) < CHOSEN_OTHERWISE_CM


def read(track: Path) -> list[dict[str, str]]:
    with track.open(newline="") as file:
        return list(csv.DictReader(file))


def stems_apart_cm(ours: list[dict[str, str]], theirs: list[dict[str, str]]) -> np.ndarray:
    """How far points lie apart, along either axis; shape (rows, 20). The same lamps at the same times are demanded."""
    assert [(row["time_s"], row["light"]) for row in theirs] == [(row["time_s"], row["light"]) for row in ours]
    points = [f"{axis}{number}" for number in range(1, 11) for axis in "xy"]
    stems = [np.array([[float(row[name] or "nan") for name in points] for row in rows]) for rows in (ours, theirs)]
    assert np.isfinite(stems[0]).mean() > 0.9
    assert np.array_equal(np.isfinite(stems[0]), np.isfinite(stems[1]))
    return np.abs(stems[1] - stems[0])
