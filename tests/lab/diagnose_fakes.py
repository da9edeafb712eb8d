"""Runs for the pictures and words of a diagnosis: plants of the law itself, of known constants: no fit is needed."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from flora_common.arrays import Array
from flora_common.runs import LampsSection
from flora_lab.diagnose import chance
from flora_lab.diagnose.hypothesis import Hypothesis
from flora_lab.diagnose.joint import Base, Found
from flora_lab.diagnose.scene import Lanes, Scene
from flora_lab.effects.effect import Change
from flora_lab.simulator.measured import MeasuredRun
from flora_lab.simulator.terms import ExtendedLaw
from flora_lab.simulator.tropism_traits import NAMES, prior_mean, prior_spread

LAW = ExtendedLaw(LampsSection())
STEP_S = 300.0
BASE = Base(
    mean=prior_mean(),
    spread=0.5 * prior_spread(),
    doubt=1e-4 * np.eye(len(NAMES)),
    sizes=chance.sizes_expected(),
    first=np.array([np.log(6.5), 0.0]),
    first_sd=np.array([0.1, 0.1]),
    runs=9,
)


def nothing(_change: Change) -> None:
    """No effect."""


def scene_of(
    name: str,
    seed: int,
    *,
    hours: float = 36.0,
    phase_h: float = 6.0,
    effect: Callable[[Change], None] = nothing,
    noise_cm: float = 0.02,
    swing_cm: float = 0.0,
    hidden: slice = slice(0),
) -> tuple[Scene, Array]:
    """A run of one plant under lamps that change every few hours, and the plant's traits, shape (9,)."""
    rng = np.random.default_rng(seed)
    traits = BASE.mean + np.linalg.cholesky(BASE.spread) @ rng.standard_normal(len(NAMES))
    rows = round(hours * 3600.0 / STEP_S) + 1
    time_s = np.arange(rows) * STEP_S
    is_right = (time_s[:-1] // (3600.0 * phase_h)) % 2 == seed % 2
    light = np.stack([~is_right, is_right], axis=1).astype(np.float64)
    points = np.empty((rows, 10, 2))
    points[:] = np.stack([np.zeros(10), np.linspace(0.0, 6.5, 10)], axis=1)

    def scene() -> Scene:
        return Scene(MeasuredRun(name, name, "", points, light, time_s, STEP_S, {}, LampsSection()), LAW)

    change = Change()
    effect(change)
    grown = scene().points(Lanes((traits + change.traits)[None], np.zeros((1, 2)), [change]), every=1)[:, 0]
    points[1 : len(grown) + 1] = grown
    points[len(grown) + 1 :] = grown[-1]
    along = np.linspace(0.0, 1.0, 10)
    points[..., 0] += swing_cm * along**2 * np.sin(2.0 * np.pi * time_s[:, None] / (1.7 * 3600.0))
    points[hidden] = np.nan
    points[3:, 1:] += noise_cm * rng.standard_normal((rows - 3, 9, 2))
    return scene(), traits


def found_of(scenes: list[Scene], traits: list[Array], misfit_per_feature: float = 1.0) -> Found:
    """As a fit would end that found the plants' own constants."""
    misfit = 0.5 * misfit_per_feature * sum(scene.size for scene in scenes)
    return Found(Hypothesis(), np.zeros(0), np.stack(traits), np.zeros((len(scenes), 2)), misfit=misfit)


def colours_in(picture: bytes) -> set[tuple[int, ...]]:
    """The colours, red-green-blue, that more than 40 pixels of a PNG have."""
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    found, counts = np.unique(image.reshape(-1, 3), axis=0, return_counts=True)
    return {tuple(int(part) for part in colour) for colour, count in zip(found, counts, strict=True) if count > 40}
