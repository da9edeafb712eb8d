"""Some things that would push a plant, or its record, all the time: what is bet on beside wider chance.

They are few and plain, to be sooner than a diagnosis; which cause it is, is the diagnosis' to say. A little of each is
seen in healthy runs too: that much is expected, and the bets are on more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.linalg

from flora_common.arrays import Array
from flora_lab.diagnose import usual_errors
from flora_lab.diagnose.scene import FEATURES, Answers, Scene
from flora_lab.diagnose.usual_errors import UsualErrors
from flora_lab.effects.effect import RUN_H


@dataclass(frozen=True, slots=True)
class Push:
    """One of them.

    Attributes:
        size: that is bet on, its standard deviation.
        effects: of the catalogue, that tell how much of it healthy runs seem to show, one for each of its columns.
    """

    size: float
    effects: tuple[str, ...]


PUSHES: Final = (
    Push(0.05, ("draught",)),  # curvature per cm and hour, to one side
    Push(0.8, ("lamp_asymmetry",)),  # logarithm of how much more one lamp pulls than the other
    Push(0.4, ("diurnal_growth", "diurnal_growth")),  # of growth, by the time of day
    Push(4.0, ("camera_roll", "camera_drift")),  # degrees of the camera: all the time, and more with time
)
_POINTS: Final = 9.0
_DAY_H: Final = 24.0


def of_run(scene: Scene, answers: Answers, simulated: Array) -> list[Array]:
    """What each of them would do to the features of a run if its size were 1, as a root of its covariance, (m, k).

    Args:
        scene: the run.
        answers: how it answers a push at a time.
        simulated: its features, shape (m,).
    """
    to, at_h = answers.to, answers.at_h
    steps = np.minimum((at_h["gain"] / scene.step_h).astype(np.int64), len(scene.light) - 1)
    right_more = 0.5 * (scene.light[steps, 1] - scene.light[steps, 0])
    day = 2.0 * np.pi * at_h["growth"] / _DAY_H
    tilt = np.radians(_turned(simulated))
    return [
        to["bias"].sum(axis=1)[:, None],
        (to["gain"] @ right_more)[:, None],
        to["growth"] @ np.stack([np.cos(day), np.sin(day)], axis=1),
        np.stack([tilt, tilt * scene.time_h[scene.window] / RUN_H], axis=1),
    ]


def usual_sizes(errors: UsualErrors) -> list[Array]:
    """How much of each healthy runs seem to show, arrays of shape (k,): no law is right in everything."""
    known = usual_errors.causes()
    at = [[known.index(effect) for effect in push.effects] for push in PUSHES]
    return [errors.whole()[own] for own in at]


def _turned(simulated: Array) -> Array:
    """How features move per radian that the picture is turned: to the right by their height, and down by their x."""
    stems = simulated.reshape(-1, len(FEATURES))
    tip_x_cm, tip_y_cm = stems[:, 0], stems[:, 1]
    moved = [tip_y_cm * point / _POINTS if axis == 0 else -tip_x_cm for point, axis in FEATURES]
    return np.stack(moved, axis=1).ravel()


def won(root: Array, white: Array, push: Array, usual: float) -> Array:
    """Logarithm of how much more probable each feature is with a push than without, given those before, shape (m,).

    Args:
        root: of the covariance of the features without it, lower triangular, shape (m, m).
        white: innovations without it, shape (m,).
        push: see :func:`of_run`, of the size that is bet on.
        usual: mean square of innovations, at most.
    """
    own = scipy.linalg.solve_triangular(root, push, lower=True, check_finite=False)
    with_it = scipy.linalg.cholesky(usual * np.eye(len(white)) + own @ own.T, lower=True, check_finite=False)
    left = scipy.linalg.solve_triangular(with_it, white, lower=True, check_finite=False)
    return np.asarray(0.5 * (white**2 / usual - left**2) - np.log(np.diag(with_it)) + 0.5 * np.log(usual))
