"""Some things that would push a plant, or its record, all the time: what is bet on beside wider chance.

They are few and plain, to be sooner than a diagnosis; which cause it is, is the diagnosis' to say.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import scipy.linalg

from flora_lab.diagnose.scene import FEATURES, Answers, Scene
from flora_lab.effects.effect import RUN_H

Array = npt.NDArray[Any]

STEADY_PER_CM_H: Final = 0.05
"""To one side, by day and night."""
ONE_LAMP_SHARE: Final = 0.4
"""By which one lamp pulls more, and the other less."""
DAILY_GROWTH_SHARE: Final = 0.4
TILT_DEG: Final = 4.0
"""Of the camera, from the start on, and growing as much over three days."""
COUNT: Final = 4
_POINTS: Final = 9.0
_DAY_H: Final = 24.0


def of_run(scene: Scene, answers: Answers, simulated: Array) -> list[Array]:
    """What each of them would do to the features of a run, as a root of its covariance, shape (m, k).

    Args:
        scene: the run.
        answers: how it answers a push at a time.
        simulated: its features, shape (m,).
    """
    to, at_h = answers.to, answers.at_h
    steps = np.minimum((at_h["gain"] / scene.step_h).astype(np.int64), len(scene.light) - 1)
    left_more = scene.light[steps, 0] - scene.light[steps, 1]
    day = 2.0 * np.pi * at_h["growth"] / _DAY_H
    tilt = np.radians(TILT_DEG) * _turned(simulated)
    return [
        STEADY_PER_CM_H * to["bias"].sum(axis=1)[:, None],
        ONE_LAMP_SHARE * (to["gain"] @ left_more)[:, None],
        DAILY_GROWTH_SHARE * to["growth"] @ np.stack([np.cos(day), np.sin(day)], axis=1),
        np.stack([tilt, tilt * scene.time_h[scene.window] / RUN_H], axis=1),
    ]


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
        push: see :func:`of_run`.
        usual: mean square of innovations, at most.
    """
    own = scipy.linalg.solve_triangular(root, push, lower=True, check_finite=False)
    with_it = scipy.linalg.cholesky(usual * np.eye(len(white)) + own @ own.T, lower=True, check_finite=False)
    left = scipy.linalg.solve_triangular(with_it, white, lower=True, check_finite=False)
    return np.asarray(0.5 * (white**2 / usual - left**2) - np.log(np.diag(with_it)) + 0.5 * np.log(usual))
