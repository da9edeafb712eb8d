"""What happens by chance, as a sum of parts whose sizes the reference runs tell.

Each part is a Gaussian process of one of the law's drives, or of the measurement, with a fixed shape in time; only its
size is estimated. Two parts of different times together make any time between. The covariance of a run's features is
then a sum of known matrices times unknown variances, so that its likelihood has a gradient at the price of an inverse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from flora_common.arrays import Array
from flora_common.shapes import STEM_POINTS
from flora_lab.diagnose.rhythm import Swing
from flora_lab.diagnose.scene import FEATURES, WINDOW_H, Answers, Scene
from flora_lab.simulator.drives import DAY_H, REFERENCE_CM
from flora_lab.simulator.measured import STEP_S


@dataclass(frozen=True, slots=True)
class Part:
    """One thing that happens by chance.

    Attributes:
        name: with the unit of its size.
        drive: ``bias``, ``gradient``, ``growth`` or ``gain`` of the law, or one of :data:`MEASURED`, or
            :data:`GAPS`: what is not known of gaps in the record.
        memory_h: its correlation time; 0 for what is new with each feature.
        typical: size that it is expected to have, its standard deviation.
        doubt: standard deviation of the logarithm of that.
        period_h: of a part that swings; 0 for none.
        first_h: of a part that is there at the start alone, and fades with this time constant; 0 for one that stays.
        least: size that it has however quiet the reference was: no stem is measured better than to 0.3 mm, from hour
            to hour or for half a day, and no law is, nor what is taken for linear about a plant.
    """

    name: str
    drive: str
    memory_h: float
    typical: float
    doubt: float = 1.0
    period_h: float = 0.0
    first_h: float = 0.0
    least: float = 0.0


GAPS: Final = "gaps"
PARTS: Final = (
    Part("wander_fast_per_cm_h", "bias", 1.5, 0.01),
    Part("wander_per_cm_h", "bias", 5.0, 0.015),
    Part("wander_slow_per_cm_h", "bias", 20.0, 0.008),
    Part("nutation_per_cm_h", "bias", 5.0, 0.02, 1.5, 1.64),
    Part("gradient_per_cm_h", "gradient", 4.0, 0.015),
    Part("gradient_slow_per_cm_h", "gradient", 16.0, 0.01),
    Part("growth_fast_share", "growth", 3.0, 0.06),
    Part("growth_slow_share", "growth", 12.0, 0.05),
    Part("growth_rhythm_share", "growth", 1e6, 0.04, 1.0, DAY_H),
    Part("gain_fast_share", "gain", 3.0, 0.04),
    Part("gain_slow_share", "gain", 16.0, 0.04),
    # What shone on a plant before its first picture is not known, nor how late it answers the first light.
    Part("gain_first_share", "gain", 1e6, 0.6, 0.5, first_h=0.5, least=0.5),
    Part("measure_cm", "measure", 0.0, 0.04, least=0.03),
    Part("wobble_cm", "measure", 2.0, 0.03),
    Part("wobble_slow_cm", "measure", 12.0, 0.03, least=0.03),
    Part("lean_cm", "lean", 2.0, 0.02),
    Part("lean_slow_cm", "lean", 12.0, 0.01),
    Part("bow_cm", "bow", 2.0, 0.02),
    # What is not known of gaps is known in size.
    Part("gaps", GAPS, 0.0, 1.0, 0.01, least=1.0),
)
MEASURED: Final = ("measure", "lean", "bow")
"""Errors of the measurement: of each point by itself, or of the stem as a whole, that leans or is bent too much."""
_ROWS: Final = WINDOW_H * 3600.0 / STEP_S
"""Photographs that an hour's mean is of, where one is taken every five minutes: so the size of their errors is told."""
_SWING_MARGIN: Final = 1.3
_SWING_LEFT: Final = 0.05


def sizes_expected() -> Array:
    """Shape (19,)."""
    return np.array([part.typical for part in PARTS])


def covariances(scene: Scene, answers: Answers) -> Array:
    """What each part would give in a run if its size were 1, shape (19, m, m)."""
    m = scene.size
    found = np.empty((len(PARTS), m, m))
    row_h = scene.time_h[scene.window]
    for i, part in enumerate(PARTS):
        if part.drive in MEASURED:
            lag_h = np.abs(row_h[:, None] - row_h[None, :])
            if part.memory_h:
                found[i] = _alike(scene, part.drive) * np.exp(-lag_h / part.memory_h)
            else:  # each photograph's own: the fewer a mean is of, the more is left of it
                found[i] = _alike(scene, part.drive) * (lag_h == 0.0) * (_ROWS / scene.rows)
            continue
        if part.drive == GAPS:
            found[i] = answers.to_gaps @ answers.to_gaps.T
            continue
        at_h = answers.at_h[part.drive]
        shape = over_time(part, at_h, [again.step * scene.step_h for again in scene.restarts])
        if part.name.startswith("nutation"):
            size = (answers.length_cm / REFERENCE_CM) ** 2
            shape = shape * size[:, None] * size[None, :]
        answer = answers.to[part.drive]
        found[i] = answer @ shape @ answer.T
    return found


def of_wander(scene: Scene, answers: Answers, sizes: Array) -> Array:
    """What pushes to a side give by chance in a run's features, covariance of shape (m, m).

    Args:
        scene, answers: see :func:`covariances`.
        sizes: of all parts.
    """
    to_a_side = np.array([part.drive in ("bias", "gradient") for part in PARTS])
    return np.asarray(np.tensordot(to_a_side * sizes**2, covariances(scene, answers), axes=1))


def over_time(part: Part, at_h: Array, again_h: Sequence[float] = ()) -> Array:
    """How alike what a part does is at some times, shape (k, k); 1 is its size.

    Args:
        part: that acts on the plant.
        at_h: since the start of the run.
        again_h: when the run begins anew.
    """
    lag_h = np.abs(at_h[:, None] - at_h[None, :])
    alike = np.exp(-lag_h / part.memory_h)
    if part.period_h:
        alike = alike * np.cos(2.0 * np.pi * lag_h / part.period_h)
    if part.first_h:
        starts_h = np.array([at_h[0], *again_h])[:, None]
        left = np.where(at_h >= starts_h, np.exp(-(at_h - starts_h) / part.first_h), 0.0)
        alike = alike * (left.T @ left)
    return np.asarray(alike)


def of_swing(scene: Scene, answers: Answers, swing: Swing) -> Array:
    """What a swing of the tip gives in a run's hourly means, covariance of shape (m, m).

    The stem swings as it would if something bent it in that rhythm.
    """
    at_h = answers.at_h["bias"]
    lag_h = np.abs(at_h[:, None] - at_h[None, :])
    turning = np.cos(2.0 * np.pi * lag_h / swing.period_h) * np.exp(-lag_h / swing.coherence_h)
    answer = answers.to["bias"]
    given = answer @ turning @ answer.T
    # Its size is that of the tip, of which an hour's mean keeps this.
    kept = _SWING_MARGIN * swing.amplitude_cm * np.sinc(scene.per_window * scene.step_h / swing.period_h)
    sideways = np.diag(given)[scene.feature == 0]
    given *= 0.5 * kept**2 / max(float(sideways.mean()), 1e-12)
    return np.asarray(given + _SWING_LEFT * np.diag(np.diag(given)))


def _alike(scene: Scene, drive: str) -> Array:
    """How an error of 1 cm of the measurement shows in two features at a time, shape (m, m)."""
    points, axes = np.array(FEATURES).T
    height = points / (STEM_POINTS - 1.0)
    if drive == "measure":
        # Points lower on the stem are found as well as the tip, but their lower part hardly moves: as good, not worse.
        share, together = np.array([1.0, 1.0, 0.8, 0.6, 0.4]), np.eye(len(FEATURES))
    else:
        share = height if drive == "lean" else 4.0 * height * (1.0 - height)
        together = (axes[:, None] == axes[None, :]).astype(np.float64)
    of_features = together * share[:, None] * share[None, :]
    return np.asarray(of_features[scene.feature[:, None], scene.feature[None, :]])


def as_dict(sizes: Array) -> Mapping[str, float]:
    """Sizes of the parts by name."""
    return {part.name: float(size) for part, size in zip(PARTS, sizes[: len(PARTS)], strict=True)}
