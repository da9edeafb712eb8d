"""Photographs of real plants that others took. They are no part of this repository: what needs them does without.

``docs/how-to/track-real-photographs.md`` says where they are from.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pytest

DATA: Final = Path(os.environ.get("FLORA_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data"
"""In the folder that ``FLORA_SHARED`` names, or in ``shared`` beside the checkout."""


@dataclass(frozen=True, slots=True)
class RealPlant:
    """Where its pictures are, and what ``flora-lab track`` must be told of them."""

    path: Path
    px_per_cm: float
    place: tuple[str, ...]

    @property
    def options(self) -> tuple[str, ...]:
        """Of the command line, scale included."""
        return ("--px-per-cm", f"{self.px_per_cm:g}", *self.place)

    @property
    def needed(self) -> pytest.MarkDecorator:
        """Skips a test where the pictures are not there."""
        return pytest.mark.skipif(not self.path.exists(), reason=f"{self.path} is not there")


BEAN: Final = RealPlant(DATA / "flora-robotica-bean", 20.0, ("--anchor", "361,335"))
STALK: Final = RealPlant(
    DATA / "plant-tracer" / "circumnutation_20190712.mp4",
    24.0,
    ("--anchor", "121,130", "--interval-s", "120", "--widest-stem-cm", "0.2", "--hidden-base-cm", "1.2"),
)
FOLDED: Final = RealPlant(
    DATA / "plant-tracer" / "legacy_gravitropism_sample.mov",
    20.0,
    (
        "--anchor",
        "432,264",
        "--interval-s",
        "120",
        "--frames",
        "0:83",
        "--widest-stem-cm",
        "0.5",
        "--below-anchor-cm",
        "0.6",
        "--window",
        "436,100,625,300",
    ),
)


def independent_apex_px() -> np.ndarray:
    """The stalk's apex as its owners tracked it: shape (frames, 2), px of the film, y down."""
    with (STALK.path.parent / "circumnutation_20190712_trackpoints.csv").open() as file:
        rows = list(csv.DictReader(file))
    px = 0.208153 * 2  # mm per px of the film: it was made on a canvas of twice its size, y up
    return np.array([(float(r["Apex x (mm)"]) / px, 240 - float(r["Apex y (mm)"]) / px) for r in rows])
